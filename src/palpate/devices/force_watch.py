"""Bounds of a force that presses something, a skin or a finger: its size, its rate, and how old it may be."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from palpate.core import NS_PER_S, RangeError
from palpate.devices.motion_limits import Reason, Tripped


@runtime_checkable
class ForceBounds(Protocol):
    """What a `ForceWatch` keeps to; `Limits` of a stage are such, and so are `ForceLimits`."""

    @property
    def force_n(self) -> float:
        """Greatest force [N]."""

    @property
    def force_rate_n_s(self) -> float:
        """Greatest change, over `rate_window_s` [N/s]."""

    @property
    def rate_window_s(self) -> float:
        """Long enough that noise is no rate [s]."""

    @property
    def age_s(self) -> float:
        """Oldest sample on which anything goes on [s]."""


@dataclass(frozen=True, slots=True)
class ForceLimits:
    """Bounds of the force on a finger; see `ForceBounds`."""

    force_n: float = 10.0
    force_rate_n_s: float = 1000.0
    rate_window_s: float = 0.02
    age_s: float = 0.01

    def __post_init__(self) -> None:
        for name in ("force_n", "force_rate_n_s", "rate_window_s", "age_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise RangeError(f"the limit {name} is {value}; it must be positive")


class ForceWatch:
    """Trips on a force beyond its bounds."""

    def __init__(self, bounds: ForceBounds) -> None:
        self._bounds = bounds
        self._recent: deque[tuple[int, float]] = deque()

    def check_size(self, size_n: float) -> None:
        """Trip on too much force, in whatever direction."""
        if not size_n <= self._bounds.force_n:
            raise Tripped(Reason.FORCE_LIMIT, f"{size_n:.2f} N; {self._bounds.force_n:g} N are allowed")

    def check_rate(self, time_ns: int, normal_n: float) -> None:
        """Trip on too fast a change, from the oldest force inside the window to this one."""
        window_ns = self._bounds.rate_window_s * NS_PER_S
        while self._recent and time_ns - self._recent[0][0] > window_ns:
            self._recent.popleft()
        self._recent.append((time_ns, normal_n))
        rate = abs(normal_n - self._recent[0][1]) / self._bounds.rate_window_s
        if rate > self._bounds.force_rate_n_s:
            raise Tripped(
                Reason.FORCE_RATE,
                f"the force changed at {rate:.0f} N/s; {self._bounds.force_rate_n_s:g} N/s are allowed",
            )

    def check_age(self, age_s: float) -> None:
        """Trip on a sample that is too old."""
        if age_s > self._bounds.age_s:
            raise Tripped(
                Reason.FORCE_STALE,
                f"the newest force is {age_s * 1e3:.0f} ms old; nothing moves on more than "
                f"{self._bounds.age_s * 1e3:g} ms",
                {"age_s": age_s, "allowed_s": self._bounds.age_s},
            )
