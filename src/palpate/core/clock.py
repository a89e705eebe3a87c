"""Time enters through a clock, so that every test can hold it in its hand."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from palpate.core.errors import InputError

NS_PER_S = 1_000_000_000


@runtime_checkable
class Clock(Protocol):
    """A clock that never runs backwards."""

    def now_ns(self) -> int:
        """Monotonic time [ns]; only differences mean anything."""

    def sleep(self, seconds: float) -> None:
        """Wait [s]."""


class MonotonicClock:
    """The machine's monotonic clock."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


@dataclass
class ManualClock:
    """A clock that moves only when told to, for tests and for simulated time.

    Example:
        >>> clock = ManualClock()
        >>> clock.sleep(0.5)
        >>> clock.now_ns()
        500000000
    """

    ns: int = 0

    def now_ns(self) -> int:
        return self.ns

    def sleep(self, seconds: float) -> None:
        if seconds < 0:
            raise InputError(f"cannot sleep {seconds} s: a clock never runs backwards; give 0 s or more")
        self.ns += round(seconds * NS_PER_S)
