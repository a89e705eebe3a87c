"""Statistics of a live loop: true rate and latencies of late, and what was lost on the way.

Drift of a live sensor from its calibration, and what to do about it.

Nobody says when a sensor in use is untouched. But a touch only takes its image farther from the untouched
one, so the least distance of the last minute bounds the drift from above, and is the drift itself where the
sensor was let go of once in that minute.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.core import NS_PER_S, Drift, Float, Image, ImageError, Readings
from palpate.core.shared_history import SharedHistory
from palpate.estimators.guard import EXCHANGED, MIRRORED
from palpate.sensing.streaming.live_readers import FrameReader

Percentiles = tuple[float | None, float | None, float | None]
KEPT = 1000  # latencies of which percentiles are told: half a minute at 30 frames a second
MIN_SPAN_S = 0.2  # of arrivals that tell a rate
RATE_S = 5.0  # over which a rate is told
SILENT_S = 1.0  # without a frame, and two periods, after which the silence counts in the rate
KEPT_ARRIVALS = 2048  # five seconds at 400 frames a second


@dataclass(frozen=True, slots=True)
class LiveStatistics:
    """Counts and times of a live loop so far.

    Attributes:
        rate_hz: Frames a second over the last five seconds; None below two frames.
        p50_ms, p95_ms, p99_ms: Time from arrival to reading of the last thousand frames; None without any.
        dropped: Frames replaced by a newer one before they were read.
        lost: Frames lost by the source.
    """

    rate_hz: float | None
    p50_ms: float | None
    p95_ms: float | None
    p99_ms: float | None
    frames: int
    dropped: int
    lost: int
    broken: int

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, rounded."""
        rounded = {name: getattr(self, name) for name in ("rate_hz", "p50_ms", "p95_ms", "p99_ms")}
        counts = {name: getattr(self, name) for name in ("frames", "dropped", "lost", "broken")}
        return {name: None if v is None else round(v, 2) for name, v in rounded.items()} | counts


class StatisticsKeeper:
    """Keeps the last arrivals and latencies, and no more of them however long it runs."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._arrivals_ns: deque[int] = deque(maxlen=KEPT_ARRIVALS)
        self._latencies_ns: deque[int] = deque(maxlen=KEPT)
        self._frames = self._dropped = self._lost = self._broken = 0
        self._rate: float | None = None
        self._percentiles: Percentiles = (None, None, None)
        self._told_s = float("-inf")

    def arrived(self, arrived_ns: int, lost: int, dropped: int) -> None:
        """Count a frame that came, what was lost before it, and whether it replaced one that waited."""
        with self._lock:
            self._arrivals_ns.append(arrived_ns)
            self._lost += lost
            self._dropped += dropped

    def read(self, arrived_ns: int, done_ns: int, *, broken: bool) -> None:
        """Count a frame that was read."""
        with self._lock:
            self._frames += 1
            self._broken += broken
            self._latencies_ns.append(done_ns - arrived_ns)

    def now(self, age_s: float = 0.0) -> LiveStatistics:
        """All of it now; rate and percentiles may be so old, as they are not taken at every frame [s]."""
        with self._lock:
            counts = self._frames, self._dropped, self._lost, self._broken
            if time.monotonic() - self._told_s > age_s:
                self._told_s = time.monotonic()
                self._rate = _rate_hz(list(self._arrivals_ns), time.monotonic_ns())
                self._percentiles = _percentiles_ms(np.array(self._latencies_ns, np.float64))
            return LiveStatistics(self._rate, *self._percentiles, *counts)


def _percentiles_ms(latencies_ns: Float[np.ndarray, " n"]) -> Percentiles:
    if not len(latencies_ns):
        return (None, None, None)
    p50, p95, p99 = np.percentile(latencies_ns, (50, 95, 99)) / 1e6
    return float(p50), float(p95), float(p99)


def _rate_hz(arrivals_ns: list[int], now_ns: int) -> float | None:
    recent = [at for at in arrivals_ns if now_ns - at <= RATE_S * NS_PER_S]
    if len(recent) < 2 or recent[-1] - recent[0] < MIN_SPAN_S * NS_PER_S:
        return None  # a driver's first frames come together
    rate_hz = (len(recent) - 1) * NS_PER_S / (recent[-1] - recent[0])
    silent_s = (now_ns - recent[-1]) / NS_PER_S
    if silent_s > max(SILENT_S, 2 / rate_hz):
        return len(recent) * NS_PER_S / (now_ns - recent[0])
    return rate_hz


LOOK_S = 0.25  # between two looks at drift, and at why frames are refused
WINDOW_S = 60.0
MIN_LOOKS = 20  # five seconds, before which nothing is advised
MIN_EXCHANGED = 3  # looks with red and blue exchanged, from which that is advised
REFUSED = 0.5  # share of looks at which the guard refused the frame, from which something is advised

RE_ZERO = "re-zero"
REFOCUS = "refocus"
ADAPT = "adapt"
EXCHANGE = "exchange"
FLIP = "flip"
WORDS = {
    RE_ZERO: "re-zero: take everything off the skin, and take its untouched image anew",
    REFOCUS: "refocus: the image looks like one of a lens out of focus; turn it back, or lock the focus",
    ADAPT: "adapt: the sensor has changed since its calibration; record some fifty presses with labels and "
    "run `palpate adapt`, or calibrate again",
    FLIP: "flip: the picture seems mirrored or turned by half a turn; have the camera or what reads it "
    "give it as it was calibrated on",
    EXCHANGE: "exchange: red and blue seem exchanged; have the camera or what reads it give red, green, blue",
}
OUT_OF_FOCUS = "focus"  # the guard's name of that kind of change


@dataclass(frozen=True, slots=True)
class Look:
    """One look: distance from the untouched sensor, and what a refused frame looked like."""

    at_s: float
    drift: Drift | None
    refused: bool
    kind: str


class DriftWatch:
    """Follows the drift of one live sensor."""

    def __init__(self, reader: FrameReader) -> None:
        self._reader = reader
        self._looks = SharedHistory[Look](round(WINDOW_S / LOOK_S) + 1)
        self._next_s = 0.0
        self._re_zeroed = False

    def frame(self, image: Image, readings: Readings) -> None:
        """Take in a frame and its readings; it is looked at a few times a second."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return
        self._next_s = now_s + LOOK_S
        try:
            drift = self._reader.drift_of(image)
            # A value beyond the range is not valid either, and says nothing of the camera.
            kind = "" if readings.valid else self._reader.kind_of(image)
        except ImageError:  # of another size: the readings say so
            return
        self._looks.append(Look(now_s, drift, bool(kind), kind))

    def zeroed(self) -> None:
        """The untouched image was taken anew: what was seen before says nothing of now."""
        self._looks.clear()
        self._re_zeroed = True

    @property
    def drift(self) -> Drift | None:
        """The least of the last minute; None where the calibration knows no untouched sensor."""
        recent = [look.drift for look in self._recent() if look.drift is not None]
        return min(recent, key=lambda drift: drift.statistic, default=None)

    @property
    def action(self) -> str:
        """What should be done, a key of `WORDS`; "" where nothing has to be."""
        recent = self._recent()
        # Seen where there is colour alone, as of a touch; but not once where the order is right.
        if sum(look.kind == EXCHANGED for look in recent) >= MIN_EXCHANGED:
            return EXCHANGE
        if len(recent) < MIN_LOOKS:
            return ""
        refused = [look for look in recent if look.refused]
        much = len(refused) > REFUSED * len(recent)
        kinds = Counter(look.kind for look in refused if look.kind)
        if much and kinds and kinds.most_common(1)[0][0] == OUT_OF_FOCUS:
            return REFOCUS
        if much and kinds and kinds.most_common(1)[0][0] in MIRRORED:
            return FLIP
        drift = self.drift
        if (drift is not None and drift.drifted) or (much and kinds):
            return RE_ZERO if self._reader.differential and not self._re_zeroed else ADAPT
        return ""

    @property
    def advice(self) -> str:
        """The same in words."""
        return WORDS.get(self.action, "")

    def to_dict(self) -> dict[str, Any] | None:
        """Drift as plain values; None where it is not known."""
        drift = self.drift
        return None if drift is None else {**drift.to_dict(), "action": self.action}

    def _recent(self) -> list[Look]:
        now_s = time.monotonic()
        return [look for look in self._looks.items() if now_s - look.at_s <= WINDOW_S]
