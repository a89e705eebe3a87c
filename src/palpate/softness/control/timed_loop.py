"""Fixed-rate loop on the monotonic clock that measures the duration and lateness of every period."""

from __future__ import annotations

import gc
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, RangeError, ndarray

PERIOD_S = 1e-3
LATE_S = 1.5e-3  # from one beginning to the next, from which a period is counted as late
SPIN_S = 150e-6  # before a beginning, in which it waits awake: sleep comes back late by about that
MAX_S = 86_400.0
SWITCH_S = 1e-4  # between threads, so that whoever talks to others does not hold the loop up


@dataclass(frozen=True, slots=True, eq=False)
class LoopTiming:
    """Periods and work durations of a loop [s]."""

    periods_s: Float[ndarray, " n"]
    work_s: Float[ndarray, " m"]

    @property
    def late_share(self) -> float:
        """Share of periods longer than `LATE_S`."""
        return float(np.mean(self.periods_s > LATE_S))

    @property
    def longest_s(self) -> float:
        """Longest period [s]."""
        return float(self.periods_s.max())


def run_timed(tick: Callable[[], object], seconds: float) -> LoopTiming:
    """Call something once in a period, on the machine's clock, and keep all its times; see `run_paced`."""
    begun, took = [], []

    def heard(began_s: float, work_s: float) -> None:
        begun.append(began_s)
        took.append(work_s)

    run_paced(tick, seconds, heard)
    return LoopTiming(np.diff(np.array(begun)), np.array(took))


def run_paced(
    tick: Callable[[], object], seconds: float, heard: Callable[[float, float], object],
    goes_on: Callable[[], bool] = lambda: True,
) -> None:  # fmt: skip
    """Call `tick` once per period while `goes_on()`; missed periods are skipped, the next is half a period
    away.

    Args:
        heard: receives the start and duration of each call [s].
    """
    if not 0 < seconds <= MAX_S:
        raise RangeError(
            f"a loop of {seconds:g} s; more than 0 s and a day at most are allowed", code="duration"
        )
    with _undisturbed():
        next_s = time.perf_counter()
        end_s = next_s + seconds
        while next_s < end_s and goes_on():
            now = _wait_until(next_s)
            tick()
            ended = time.perf_counter()
            heard(now, ended - now)
            soonest = max(ended, now + PERIOD_S / 2)  # two at once would ask a device twice
            next_s += PERIOD_S * max(1, math.ceil((soonest - next_s) / PERIOD_S))


class Pace:
    """Counts periods, and those longer than `LATE_S`."""

    def __init__(self) -> None:
        self.periods = self.late = 0
        self.longest_s = 0.0
        self.latest_s = time.perf_counter()
        self._first = True

    def heard(self, began_s: float, work_s: float) -> None:
        if not self._first:
            period = began_s - self.latest_s
            self.periods += 1
            self.late += period > LATE_S
            self.longest_s = max(self.longest_s, period)
        self._first, self.latest_s = False, began_s

    @property
    def late_share(self) -> float:
        """Share of periods longer than `LATE_S`; 0 before the first."""
        return self.late / self.periods if self.periods else 0.0


def _wait_until(at_s: float) -> float:
    """Sleep, then wait awake; the time at which it came [s]."""
    while (left_s := at_s - time.perf_counter()) > 0:
        if left_s > SPIN_S:
            time.sleep(left_s - SPIN_S)
    return time.perf_counter()


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Neither collect garbage nor leave the processor to other threads for long."""
    collected, switched = gc.isenabled(), sys.getswitchinterval()
    gc.collect()
    gc.disable()
    sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(switched)
        if collected:
            gc.enable()
