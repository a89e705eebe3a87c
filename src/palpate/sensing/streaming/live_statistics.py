"""Statistics of a live loop: true rate and latencies of late, and what was lost on the way."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.core import NS_PER_S, Float

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
