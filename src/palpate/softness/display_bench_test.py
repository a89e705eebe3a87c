"""Bench test of a contact-area display: steps of a flat probe at several pressures, compared with P = p A(s).

The points are fitted by P = c p A(s) + k s + f d, with d = 1 pressing and -1 on the way back: c is the scale
of area or pressure, k the stiffness of the sleeve, f the friction. The law has c = 1, the stated k, and f =
0.

Reference: E. P. Scilingo, M. Bianchi, G. Grioli, A. Bicchi, Rendering softness, IEEE Trans. Haptics 3 (2010)
109, doi:10.1109/TOH.2010.2, section 3.1.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from palpate.core import (
    Clock,
    DeviceError,
    Float,
    InputError,
    Progress,
    RangeError,
    SoftnessDevice,
    ndarray,
    new_file,
    silent,
)
from palpate.softness.cone_display import ConeDisplay

PERIOD_S = 1e-3
MIN_POINTS = 6
FAR_M = 0.5e-3  # by which the tip may miss the probe's way before the probe is not on it

Column = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True)
class IndentationPlan:
    """Steps of a flat probe, in and back, at several gauge pressures in the given order (0 shows sleeve and
    friction).
    """

    pressures_pa: tuple[float, ...] = (20e3, 5e3, 40e3, 10e3, 30e3, 0.0)
    ways_m: tuple[float, ...] = tuple(1e-3 * i for i in range(1, 10))
    speed_m_s: float = 5e-3
    settle_s: float = 0.25
    mean_s: float = 0.1

    def __post_init__(self) -> None:
        times = (self.speed_m_s, self.settle_s, self.mean_s)
        if not all(math.isfinite(one) and one > 0 for one in times):
            raise RangeError("speed, settling and averaging of a bench test are finite and above 0")
        if not all(math.isfinite(one) and one >= 0 for one in self.pressures_pa):
            raise RangeError("pressures of a bench test are finite and 0 Pa or more")
        if len({one for one in self.pressures_pa if one > 0}) < 2:
            raise InputError("a bench test needs two pressures above 0 at least, to tell area from sleeve")
        rising = np.all(np.diff(self.ways_m) > 0) and len(self.ways_m) > 1 and self.ways_m[0] > 0
        if not rising or not math.isfinite(self.ways_m[-1]):
            raise InputError("ways of a bench test are two or more, finite, above 0 m and rising")


@dataclass(frozen=True, slots=True)
class BenchPoint:
    """Means at one step; `direction` is 1 pressing, -1 on the way back."""

    told_pa: float
    pressure_pa: float
    pushed_m: float
    force_n: float
    direction: int


@dataclass(frozen=True, slots=True, eq=False)
class BenchTest:
    """Points of a bench test beside the law of a stated display."""

    shape: ConeDisplay
    points: tuple[BenchPoint, ...]

    def __post_init__(self) -> None:
        if len(self.points) < MIN_POINTS:
            raise InputError(f"{len(self.points)} points; a bench test needs {MIN_POINTS} or more")

    def column(self, name: str) -> Column:
        """One of a point's figures, of all points."""
        return np.array([getattr(one, name) for one in self.points], float)

    @property
    def pushing_n(self) -> Column:
        """The gas's force p A(s) at each point [N]."""
        way = np.clip(self.column("pushed_m"), 0.0, self.shape.height_m)
        return self.column("pressure_pa") * self.shape.area_m2(way)

    @property
    def law_n(self) -> Column:
        """Force of the law at each point, p A(s) + k s with the stated k [N]."""
        return self.pushing_n + self.shape.sleeve_n_m * self.column("pushed_m")

    @property
    def off_n(self) -> Column:
        """Force measured less the law's [N]."""
        return np.asarray(self.column("force_n") - self.law_n)

    @property
    def peak_n(self) -> float:
        """Greatest force measured [N]."""
        return float(self.column("force_n").max())

    @property
    def rms_n(self) -> float:
        """Root mean square of what the law misses [N]."""
        return float(np.sqrt(np.mean(self.off_n**2)))

    def fit(self) -> BenchFit:
        """c, k and f by least squares."""
        told = np.column_stack([self.pushing_n, self.column("pushed_m"), self.column("direction")])
        found, _, rank, _ = np.linalg.lstsq(told, self.column("force_n"), rcond=None)
        if rank < 3:
            raise InputError("these points do not tell area, sleeve and friction apart; press both ways")
        left = self.column("force_n") - told @ found
        variance = float(left @ left) / (len(left) - 3)
        errors = np.sqrt(variance * np.diag(np.linalg.inv(told.T @ told)))
        scale, sleeve, friction = (float(one) for one in found)
        left_n = float(np.sqrt(np.mean(left**2)))
        return BenchFit(scale, sleeve, friction, float(errors[0]), left_n)


@dataclass(frozen=True, slots=True)
class BenchFit:
    """Fitted c (`scale`), k, and f, with the standard error of c and the residual RMS."""

    scale: float
    sleeve_n_m: float
    friction_n: float
    scale_error: float
    rms_n: float


def run_bench_test(
    plan: IndentationPlan,
    display: SoftnessDevice,
    move: Callable[[float], None],
    force_n: Callable[[], float],
    clock: Clock,
    shape: ConeDisplay | None = None,
    progress: Progress = silent,
) -> BenchTest:
    """Run a plan; the display is always vented at its end.

    Args:
        display: released here, and commanded every period.
        move: commands the probe to a tip displacement [m]; returns at once; called with 0 before each
            pressure.
        force_n: returns the reference force [N].
    """
    shown = display.range
    if plan.ways_m[-1] > shown.height_m or max(plan.pressures_pa) > shown.greatest_pa:
        raise RangeError(
            f"the plan goes to {plan.ways_m[-1] * 1e3:g} mm and {max(plan.pressures_pa) / 1e3:g} kPa; the "
            f"display allows {shown.height_m * 1e3:g} mm and {shown.greatest_pa / 1e3:g} kPa",
            code="display-limits",
        )
    points: list[BenchPoint] = []
    steps = [*((way, 1) for way in plan.ways_m), *((way, -1) for way in plan.ways_m[-2::-1])]
    move(0.0)
    display.release()
    try:
        for i, told in enumerate(plan.pressures_pa):
            progress("pressures", i, len(plan.pressures_pa))
            at = 0.0
            all(each_period(display, told, plan.settle_s, clock))
            for way, direction in steps:
                _travel(display, told, move, at, way, plan.speed_m_s, clock)
                all(each_period(display, told, plan.settle_s, clock))
                pressure, pushed, force = _means(display, told, force_n, plan.mean_s, clock)
                if told > 0 and abs(pushed - way) > FAR_M:
                    raise DeviceError(
                        f"the tip is at {pushed * 1e3:.2f} mm where the probe was told {way * 1e3:.2f} mm; "
                        "they may differ by "
                        f"{FAR_M * 1e3:g} mm: set the probe's zero at first touch, and check the Hall sensor",
                        code="tip-position",
                    )
                points.append(BenchPoint(told, pressure, pushed, force, direction))
                at = way
            _travel(display, told, move, at, 0.0, plan.speed_m_s, clock)
    finally:
        display.vent()
    return BenchTest(shape or ConeDisplay(shown.height_m, shown.radius_m), tuple(points))


def write_bench_table(test: BenchTest, path: Path) -> None:
    """Write the points as CSV, SI units in the columns' names."""
    with new_file(path) as building, building.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow([*(one.name for one in fields(BenchPoint)), "law_n"])
        rows.writerows([*astuple(one), law] for one, law in zip(test.points, test.law_n, strict=True))


def each_period(
    display: SoftnessDevice, told_pa: float, seconds: float, clock: Clock
) -> Iterator[tuple[int, int]]:
    """Command a pressure once per period; yield the number of each period, from 1, and of all."""
    periods = max(round(seconds / PERIOD_S), 1)
    for i in range(1, periods + 1):
        display.set_pressure(told_pa)
        yield i, periods
        clock.sleep(PERIOD_S)


def _travel(
    display: SoftnessDevice, told_pa: float, move: Callable[[float], None],
    start_m: float, end_m: float, speed_m_s: float, clock: Clock,
) -> None:  # fmt: skip
    for i, periods in each_period(display, told_pa, abs(end_m - start_m) / speed_m_s, clock):
        move(start_m + (end_m - start_m) * i / periods)


def _means(
    display: SoftnessDevice, told_pa: float, force_n: Callable[[], float], seconds: float, clock: Clock
) -> tuple[float, float, float]:
    rows = []
    for _ in each_period(display, told_pa, seconds, clock):
        seen = display.latest()
        if seen.fault:
            raise DeviceError(f"the display says: {seen.fault}")
        rows.append((seen.pressure_pa, seen.pushed_m, force_n()))
    pressure, pushed, force = np.mean(rows, axis=0)
    if not math.isfinite(pressure + pushed + force):
        raise DeviceError("pressure, way or force of the bench test is no number; check the sensors")
    return float(pressure), float(pushed), float(force)
