"""Status of devices for display: health, the force's last seconds, the newest picture, a log."""

from __future__ import annotations

import base64
import threading
from collections import deque
from datetime import UTC, datetime
from typing import Any, Literal

import cv2
import numpy as np

from palpate.core import NS_PER_S, Image, Position
from palpate.devices.device_proxies import KEPT_S, RATE_S, CameraProxy, ForceProxy, StageProxy
from palpate.devices.force_bias import Force, Mounting

BIN_S = 0.1  # of the plotted force; of each bin its least and its greatest are told, so that no peak is lost
OLD_S = 3.0  # from when a device that says nothing is said to be silent
MAX_PX = 960  # width of the picture that is told
QUALITY = 90  # of its JPEG


def stage_health(stage: StageProxy, position_mm: Position | None) -> dict[str, str]:
    """Health of the stage, where it is, and what was lost on its wire."""
    if stage.error:
        return _health("stage", "failed", stage.error)
    if stage.held:
        return _health("stage", "held", "held by the emergency stop")
    if position_mm is None:
        return _health("stage", "waiting", "not asked yet")
    x, y, z = (round(d, 2) + 0.0 for d in position_mm)  # no minus before a zero
    place = f"x {x:.2f}, y {y:.2f}, z {z:.2f} mm"
    return _health("stage", "ok", f"{place}; {stage.health}" if stage.health else place)


def force_health(force: ForceProxy, now_ns: int) -> dict[str, str]:
    """Health of the force sensor: its rate as it comes, and what it says is wrong."""
    if force.error:
        return _health("force sensor", "failed", force.error)
    recent = force.recent()
    if not recent:
        return _health("force sensor", "waiting", "no sample yet")
    age_s = (now_ns - recent[-1].time_ns) / NS_PER_S
    if recent[-1].fault:
        return _health("force sensor", "failed", recent[-1].fault)
    if age_s > OLD_S:
        return _health("force sensor", "silent", f"the newest sample is {age_s:.1f} s old")
    window = [one for one in recent if now_ns - one.time_ns <= RATE_S * NS_PER_S]
    over_s = min(RATE_S, max((now_ns - recent[0].time_ns) / NS_PER_S, BIN_S))
    return _health("force sensor", "ok", f"{len(window) / over_s:.0f} of {force.rate_hz:g} samples a second")


def camera_health(camera: CameraProxy, now_ns: int, recording: bool) -> dict[str, str]:
    """Health of the camera: it is asked for frames when they are wanted, so an old one is no fault."""
    if camera.error:
        return _health("camera", "failed", camera.error)
    if camera.newest is None:
        return _health("camera", "waiting", "no frame yet")
    width, height = camera.size_px
    age_s = max((now_ns - camera.newest[0]) / NS_PER_S, 0.0)
    size = f"{width} × {height} px, {camera.rate_hz:g} a second"
    if age_s > OLD_S:
        state = "ok" if recording else "silent"
        return _health("camera", state, f"{size}; the last {age_s:.0f} s ago")
    return _health("camera", "ok", f"{size}; {camera.recent_count(now_ns) / RATE_S:.1f} taken")


def _health(name: str, state: str, detail: str) -> dict[str, str]:
    return {"name": name, "state": state, "detail": detail}


def force_series(force: ForceProxy, mounting: Mounting, bias: Force, now_ns: int) -> dict[str, list[float]]:
    """The last seconds along each of the skin's axes, at most two points a bin, by their age [s] and [N]."""
    good = [one for one in force.recent() if not one.fault]
    empty: dict[str, list[float]] = {name: [] for name in ("age_s", "x", "y", "z")}
    if not good:
        return empty
    times = np.array([one.time_ns for one in good])
    values = np.array([mounting.to_skin(one.force_n) for one in good]) - np.array(bias)
    recent = np.isfinite(values).all(axis=1) & (now_ns - times <= KEPT_S * NS_PER_S)
    times, values = times[recent], values[recent]
    if not len(times):
        return empty
    bins, starts = np.unique(times // round(BIN_S * NS_PER_S), return_index=True)
    least, greatest = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    pairs = np.stack([least, greatest], axis=1).reshape(-1, 3).round(4)
    middle_ns = np.repeat((bins + 0.5) * BIN_S * NS_PER_S, 2)
    ages = {"age_s": np.maximum((now_ns - middle_ns) / NS_PER_S, 0.0).round(3).tolist()}
    return ages | {axis: pairs[:, i].tolist() for i, axis in enumerate("xyz")}


def jpeg_of(image: Image) -> dict[str, Any]:
    """A JPEG in base64, not wider than `MAX_PX`, with the image's own size [px]."""
    height, width = image.shape[:2]
    rows = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    if width > MAX_PX:
        size = (MAX_PX, max(1, round(height * MAX_PX / width)))
        rows = cv2.resize(rows, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", rows, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return {"jpeg": base64.b64encode(data.tobytes()).decode(), "size_px": [width, height]}


KEPT = 500
Kind = Literal["rig", "operator", "place", "fault"]


class Log:
    """Log of the last few hundred events."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lines: deque[dict[str, str]] = deque(maxlen=KEPT)
        self.count = 0

    def add(self, kind: Kind, text: str) -> None:
        """Log an event of now."""
        at = datetime.now(UTC).isoformat(timespec="milliseconds")
        with self._lock:
            self._lines.append({"utc": at, "kind": kind, "text": text[:500]})
            self.count += 1

    def tail(self, lines: int) -> list[dict[str, str]]:
        """The newest lines, oldest first."""
        with self._lock:
            return list(self._lines)[-lines:]
