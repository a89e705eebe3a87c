"""Devices of one's own for a bench's file: a virtual display and arm that share their physics, and faults."""

import time

from palpate.core import Clock, DisplaySample
from palpate.softness.control import FlowServo
from palpate.softness.display_parts import FingerPresses
from palpate.softness.virtual import RenderingBench
from palpate.softness.virtual.rendering_bench import VirtualDisplay

WATCHDOG_S = 0.025
_benches: dict[int, RenderingBench] = {}


def bench_of(clock: Clock) -> RenderingBench:
    """The one bench of a clock."""
    return _benches.setdefault(
        id(clock), RenderingBench(clock, FingerPresses(4e-3, 1.0), watchdog_s=WATCHDOG_S)
    )


def display(clock: Clock) -> VirtualDisplay:
    """A display that works."""
    return bench_of(clock).display


def arm(clock: Clock):
    """An arm that works."""
    return bench_of(clock).arm


class FailingDisplay(VirtualDisplay):
    """A display that tells of a fault, or hangs, some readings after it was opened."""

    def __init__(self, clock: Clock, *, fault: str = "", hangs_s: float = 0.0, after: int = 300) -> None:
        bench = bench_of(clock)
        super().__init__(bench, FlowServo(bench.parts.shape), WATCHDOG_S)
        bench.display = self
        self._left, self._fault, self._hangs_s = after, fault, hangs_s

    def latest(self) -> DisplaySample:
        """Its state, until it fails."""
        sample = super().latest()
        self._left -= 1
        if self._left == 0:
            time.sleep(self._hangs_s)
        if self._left <= 0 and self._fault:
            return DisplaySample(sample.time_ns, sample.pushed_m, sample.pressure_pa, self._fault)
        return sample
