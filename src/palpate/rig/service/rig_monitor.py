"""A rig's devices, tapped; looked at a few times a second while nobody records with them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from palpate.core.device_protocols import Position
from palpate.core.errors import PalpateError
from palpate.devices import status as device_status
from palpate.devices.force_bias import Force
from palpate.devices.proxies import CameraProxy, ForceProxy, StageProxy
from palpate.rig.progress import Status
from palpate.rig.service.opening import ServedRig

LOOK_S = 0.1  # between two looks
PICTURE_EVERY = 3  # looks
GRAB_S = 1.0
NO_BIAS: Force = (0.0, 0.0, 0.0)


class RigMonitor:
    """Whose they are at any time, and what was seen of them.

    Args:
        opened: the rig; closed by `close`.
        paused: whether whoever has the devices wants no frames just now.
    """

    def __init__(self, opened: ServedRig, paused: Callable[[], bool]) -> None:
        rig = opened.rig
        self.stage = StageProxy(rig.stage, rig.clock)
        self.force = ForceProxy(rig.force, rig.clock)
        self.camera = CameraProxy(rig.camera)
        self.rig = replace(rig, stage=self.stage, force=self.force, camera=self.camera)
        self._opened = opened
        self._paused = paused
        self._turn = threading.Lock()
        self._closing = threading.Event()
        self._at_mm: Position | None = None
        self._bias: Force | None = None
        self._watcher = threading.Thread(target=self._rest, name="palpate-rig-rest", daemon=True)
        self._watcher.start()

    @contextmanager
    def taken(self) -> Iterator[None]:
        """To be used by the caller alone."""
        with self._turn:
            yield

    def close(self) -> None:
        """Let go of them."""
        self._closing.set()
        self._watcher.join(2 * GRAB_S)
        self.rig.close()

    def told(self, status: Status) -> None:
        """Take in what the engine says of force and position."""
        if status.position_mm is not None:
            self._at_mm = status.position_mm
        if status.force_n is not None and self.force.asked is not None:
            # The engine has just asked for this sample and taken its bias off: so that is the bias.
            turned = self.rig.mounting.turned(self.force.asked.force_n)
            x, y, z = (raw - own for raw, own in zip(turned, status.force_n, strict=True))
            self._bias = (x, y, z)

    def status(self, recording: bool) -> dict[str, Any]:
        """What is told of them; plain values."""
        now_ns, bias = self.rig.clock.now_ns(), self._bias or NO_BIAS
        return {
            "force_n": self._force_now(bias),
            "tared": self._bias is not None,
            "position_mm": None if self._at_mm is None else [round(d, 4) for d in self._at_mm],
            "limits": {"force_n": self.rig.limits.force_n},
            "series": device_status.force_series(self.force, self.rig.mounting, bias, now_ns),
            "devices": [
                device_status.stage_health(self.stage, self._at_mm),
                device_status.force_health(self.force, now_ns),
                device_status.camera_health(self.camera, now_ns, recording),
            ],
            "regions": [{"name": name, "box_px": list(box)} for name, box in self._opened.rig.regions],
            "now_ns": now_ns,
        }

    def picture(self, after: int) -> dict[str, Any] | None:
        """The newest frame, numbered; None where there is none newer than `after`."""
        count, newest = self.camera.count, self.camera.newest
        if newest is None or count <= after:
            return None
        time_ns, frame = newest
        return {"number": count, "time_ns": time_ns, **device_status.picture_of(frame.image)}

    def _force_now(self, bias: Force) -> list[float] | None:
        recent = self.force.recent()
        if not recent or recent[-1].fault:
            return None
        turned = np.subtract(self.rig.mounting.turned(recent[-1].force_n), bias)
        return [round(float(f), 4) for f in turned] if np.isfinite(turned).all() else None

    def _rest(self) -> None:
        looks = 0
        while not self._closing.is_set():
            if self._turn.acquire(blocking=False):
                try:
                    self._look(looks)
                finally:
                    self._turn.release()
            elif self._opened.real_time and self._paused():
                self._grab()  # the camera's tap lets one in at a time
            looks += 1
            self._closing.wait(LOOK_S)

    def _look(self, looks: int) -> None:
        if not self._opened.real_time:
            self.rig.clock.sleep(LOOK_S)
        _tried(self.force.drain)
        _tried(self._where)
        if looks % PICTURE_EVERY == 0:
            self._grab()

    def _grab(self) -> None:
        _tried(lambda: self.camera.grab(GRAB_S))

    def _where(self) -> None:
        self._at_mm = device_status.relative_mm(self.stage.position_m(), self.rig.origin_m)


def _tried(look: Callable[[], object]) -> None:
    """A device that fails while the rig rests is told of by its tap, and asked again."""
    try:
        look()
    except PalpateError:
        return
