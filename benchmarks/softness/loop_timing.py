"""Periods of the rendering loop, interleaved with those of a bare timer in the same run.

    python benchmarks/softness/loop_timing.py [seconds]

Half of the seconds go to a loop that renders a linear object on the virtual bench in real time, half to a
loop that does nothing, ten seconds each in turn. What is said of lateness is the machine's of that hour.
"""

from __future__ import annotations

import sys

import numpy as np

from palpate.core import MonotonicClock
from palpate.softness import Characteristic, Mode, SoftObject
from palpate.softness.control import BenchLimits, ReferenceTable, RenderingLoop
from palpate.softness.control.timed_loop import LATE_S, LoopTiming, run_timed
from palpate.softness.display_parts import FingerPresses
from palpate.softness.rendering_simulation import law_of
from palpate.softness.virtual import RenderingBench

SLICE_S = 10.0
LINE = SoftObject(
    "line", Characteristic("area", 1e-6 * np.array([0.0, 20, 130]), np.array([0.0, 0.6, 3.9])),
    Characteristic("displacement", np.array([0.0, 6e-3]), np.array([0.0, 3.9])), "a benchmark",
)  # fmt: skip


def rendering() -> RenderingLoop:
    """A loop on a virtual bench in real time, without a bound of lateness, so that all is counted."""
    clock = MonotonicClock()
    bench = RenderingBench(clock, FingerPresses(7e-3, 1.0), watchdog_s=10.0)
    table = ReferenceTable(law_of(LINE, Mode.BOTH, bench.parts))
    loop = RenderingLoop(bench.display, bench.arm, table, clock, BenchLimits(late_s=5.0))
    loop.tick()  # compiles
    return loop


def tell(name: str, parts: list[LoopTiming]) -> None:
    periods = np.concatenate([one.periods_s for one in parts])
    work = np.concatenate([one.work_s for one in parts])
    print(
        f"{name:10s} {len(periods):7d}: {np.mean(periods > LATE_S):.4%} over {LATE_S * 1e3:g} ms, p99 "
        f"{np.quantile(periods, 0.99) * 1e3:.3f} ms, longest {periods.max() * 1e3:.2f} ms; work p50 "
        f"{np.median(work) * 1e6:.0f} us, p99 {np.quantile(work, 0.99) * 1e6:.0f} us"
    )


def main(seconds: float) -> None:
    """Measure and print."""
    loops: dict[str, list[LoopTiming]] = {"rendering": [], "bare": []}
    for _ in range(max(1, round(seconds / (2 * SLICE_S)))):
        loops["rendering"].append(run_timed(rendering().tick, SLICE_S))
        loops["bare"].append(run_timed(lambda: None, SLICE_S))
    for name, parts in loops.items():
        tell(name, parts)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0)
