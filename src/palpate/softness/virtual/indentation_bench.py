"""The virtual bench with a stiff flat probe and the display clamped in place of the arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palpate.core import Float, ManualClock, Progress, ndarray, silent
from palpate.softness.cone_display import ConeDisplay
from palpate.softness.control.pressure_servo import PressureServo
from palpate.softness.display_bench_test import BenchTest, IndentationPlan, run_bench_test
from palpate.softness.display_parts import ArmMechanics, FingerMechanics
from palpate.softness.pressure_response import PressureResponse, measure_pressure_response
from palpate.softness.virtual.rendering_bench import BenchParts, RenderingBench

Times = Float[ndarray, " n"]

CLAMPED = ArmMechanics(mass_kg=1e12)  # in a minute, 5 N move it by less than a nanometre
PROBE = FingerMechanics(0.05, 1e5, 60.0, 100.0, 1500.0, 10.0, 0.0)  # stiff: some micrometres under 5 N


class HeldProbe:
    """A probe that is where it was told to be."""

    gap_m = 0.0

    def __init__(self) -> None:
        self.way_m = 0.0

    def move(self, way_m: float) -> None:
        """Be at a way of the tip from now on [m]."""
        self.way_m = way_m

    def meant(self, time_s: Times, finger: FingerMechanics) -> tuple[Times, Times]:
        """Places where it is told to be, and no speed [m], [m/s]."""
        return np.full(len(time_s), self.way_m), np.zeros(len(time_s))


def virtual_bench_test(
    plan: IndentationPlan | None = None, parts: BenchParts | None = None, *,
    stated: ConeDisplay | None = None, seed: int = 0, progress: Progress = silent,
) -> BenchTest:  # fmt: skip
    """Run a plan on the virtual bench in accelerated time; `stated` is the assumed display."""
    parts = parts or BenchParts()
    probe, clock = HeldProbe(), ManualClock()
    bench = RenderingBench(clock, probe, replace(parts, arm=CLAMPED, finger=PROBE, plate=False), seed=seed)
    shape = stated or replace(parts.shape, sleeve_n_m=parts.chamber.sleeve_n_m)
    return run_bench_test(
        plan or IndentationPlan(), bench.display, probe.move, lambda: bench.truth().force_n, clock, shape,
        progress,
    )  # fmt: skip


def virtual_pressure_response(
    servo: PressureServo, amplitude_pa: float, parts: BenchParts | None = None, *, seed: int = 0
) -> PressureResponse:
    """Measure a servo's pressure response on the virtual bench, with the tip held halfway."""
    parts = parts or BenchParts()
    probe, clock = HeldProbe(), ManualClock()
    probe.move(parts.shape.height_m / 2)
    clamped = replace(parts, arm=CLAMPED, finger=PROBE, plate=False)
    bench = RenderingBench(clock, probe, clamped, servo, seed=seed)
    return measure_pressure_response(bench.display, amplitude_pa, clock)
