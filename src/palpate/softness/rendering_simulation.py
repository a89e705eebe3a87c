"""A rendering simulated on the virtual bench in accelerated time, and its deviation from both cues."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from operator import attrgetter

import numpy as np

from palpate.core import Clock, Float, ManualClock, Progress, ndarray, silent
from palpate.softness.characteristics import SoftObject
from palpate.softness.control.rendering_loop import PERIOD_S, RenderingLoop
from palpate.softness.control.servos import PressureServo, ReferenceTable
from palpate.softness.display_parts import FingerPresses, depth_for
from palpate.softness.rendering_law import DisplayBounds, Mode, RenderingLaw
from palpate.softness.virtual.rendering_bench import WATCHDOG_S, BenchParts, BenchTruth, RenderingBench

Column = Float[ndarray, " n"]

PRESSES = 3
TOLD_EVERY = 200  # periods
STATE = attrgetter(*(field.name for field in fields(BenchTruth)))  # `astuple` copies, a fifth of the time
MIN_N = 0.01  # of force, from which a finger is said to touch


@dataclass(frozen=True, slots=True, eq=False)
class Rendering:
    """Simulated presses, one value per period; the first press is not scored.

    Attributes:
        told_pa: commanded pressure [Pa].
        work_j: cumulative work of the finger on the object [J].
        largest_n: greatest force, also between periods [N].
    """

    law: RenderingLaw
    frequency_hz: float
    time_s: Column
    force_n: Column
    pushed_m: Column
    area_m2: Column
    arm_m: Column
    pressure_pa: Column
    told_pa: Column
    work_j: Column
    largest_n: float

    @property
    def displacement_m(self) -> Column:
        """Displacement of the finger's surface [m]."""
        return self.pushed_m + self.arm_m

    @property
    def scored(self) -> ndarray:
        """Whether each period is in touch, after the first press."""
        return (self.time_s > self.time_s[0] + 1.0 / self.frequency_hz) & (self.force_n > MIN_N)

    @property
    def inside(self) -> ndarray:
        """Whether each period is scored, and its state can be rendered as it is."""
        if self.law.mode is Mode.KINESTHETIC:
            return self.scored
        pushed = np.clip(self.pushed_m, 0.0, self.law.display.height_m)
        return np.asarray(self.scored & self.law.at(pushed).rendered)

    @property
    def peak_n(self) -> float:
        """Greatest force among what is scored [N]."""
        return float(self.force_n[self.scored].max())

    def off_area_n(self) -> Column:
        """Force felt less that of the object at the area felt [N]."""
        curve = self.law.object.area
        return self.force_n - np.interp(self.area_m2, curve.x, curve.force_n)

    def off_displacement_n(self) -> Column:
        """Force felt less that of the object at the displacement felt [N]."""
        curve = self.law.object.displacement
        return self.force_n - np.interp(self.displacement_m, curve.x, curve.force_n)

    def share(self, off_n: Column, where: ndarray | None = None) -> float:
        """Root mean square of a deviation, over the peak of force; NaN where nothing is."""
        chosen = off_n[self.scored if where is None else where]
        return float(np.sqrt(np.mean(chosen**2))) / self.peak_n if len(chosen) else float("nan")

    @property
    def given_back_j(self) -> float:
        """Greatest energy that came out of the object beyond what had gone in [J]; 0 of a passive one."""
        return max(0.0, -float(self.work_j.min()))


def law_of(
    soft: SoftObject, mode: Mode, parts: BenchParts, bounds: DisplayBounds | None = None
) -> RenderingLaw:
    """Law for a bench, with the sleeve that its display has."""
    shape = replace(parts.shape, sleeve_n_m=parts.chamber.sleeve_n_m)
    return RenderingLaw(soft, shape, bounds or DisplayBounds(pressure_pa=parts.greatest_pa), mode)


def virtual_bench(
    soft: SoftObject, mode: Mode, clock: Clock, peak_n: float, frequency_hz: float, *, seed: int = 0,
    parts: BenchParts | None = None, servo: PressureServo | None = None, starts_s: float = 0.0,
    watchdog_s: float = WATCHDOG_S,
) -> tuple[RenderingBench, RenderingLaw]:  # fmt: skip
    """Return a virtual bench under a pressing finger, and its law; arguments as in `simulate`."""
    parts = replace(parts or BenchParts(), plate=mode is Mode.KINESTHETIC)
    felt = soft if mode is not Mode.CUTANEOUS else _still(soft)
    finger = FingerPresses(depth_for(felt, peak_n, parts.finger), frequency_hz, starts_s=starts_s)
    return RenderingBench(clock, finger, parts, servo, seed, watchdog_s), law_of(soft, mode, parts)


def simulate(
    soft: SoftObject, mode: Mode = Mode.BOTH, *, peak_n: float, frequency_hz: float = 1.0, seed: int = 0,
    parts: BenchParts | None = None, servo: PressureServo | None = None, presses: int = PRESSES,
    progress: Progress = silent,
) -> Rendering:  # fmt: skip
    """Simulate presses of a rendered object; `peak_n` is the force of a slow press."""
    clock = ManualClock()
    bench, law = virtual_bench(soft, mode, clock, peak_n, frequency_hz, seed=seed, parts=parts, servo=servo)
    loop = RenderingLoop(bench.display_if_any, bench.arm, ReferenceTable(law), clock)
    truths: list[BenchTruth] = []
    told: list[float] = []
    periods = round(presses / frequency_hz / PERIOD_S)
    for i in range(periods):
        told.append(loop.tick().told_pa)
        truths.append(bench.truth())
        clock.sleep(PERIOD_S)
        if i % TOLD_EVERY == 0:
            progress("periods", i, periods)
    rows = np.array([STATE(one) for one in truths])
    time, force, pushed, area, arm, pressure, _, work, largest = rows.T
    return Rendering(
        law, frequency_hz, time, force, pushed, area, arm, pressure, np.array(told), work, float(largest[-1])
    )


def _still(soft: SoftObject) -> SoftObject:
    """The object as it is felt in CM3: its surface does not give way."""
    x = soft.displacement.x * 1e-6
    return replace(soft, displacement=replace(soft.displacement, x=x))
