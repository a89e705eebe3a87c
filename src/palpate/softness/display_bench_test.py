"""Bench test of a contact-area display: steps of a flat probe at several pressures, compared with P = p A(s).

The points are fitted by P = c p A(s) + k s + f d, with d = 1 pressing and -1 on the way back: c is the scale
of area or pressure, k the stiffness of the sleeve, f the friction. The law has c = 1, the stated k, and f =
0.

Reference: E. P. Scilingo, M. Bianchi, G. Grioli, A. Bicchi, Rendering softness, IEEE Trans. Haptics 3 (2010)
109, doi:10.1109/TOH.2010.2, section 3.1.

Frequency response of a display's pressure, with the tip held halfway.

The response depends on the amplitude: valve overlap attenuates small sines, saturation large ones.
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
from palpate.softness.display_parts import ConeDisplay

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


MIDDLE_PA = 30e3
FREQUENCIES_HZ = (2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 45.0, 65.0, 90.0, 130.0, 180.0)
SETTLE_S = 0.3
CYCLES = 4.0  # that are fitted, after one that is not
MIN_FITTED_S = 0.15
HALF_POWER = 1 / math.sqrt(2)


@dataclass(frozen=True, slots=True, eq=False)
class PressureResponse:
    """Gain and unwrapped phase (negative when late) of a pressure to sines of one amplitude."""

    amplitude_pa: float
    frequency_hz: Column
    gain: Column
    phase_rad: Column

    @property
    def bandwidth_hz(self) -> float:
        """Lowest frequency at which the gain falls to -3 dB [Hz]; infinite if never, 0 if from the first."""
        below = self.gain < HALF_POWER
        if not below.any():
            return math.inf
        i = int(np.argmax(below))
        if i == 0:
            return 0.0
        share = (self.gain[i - 1] - HALF_POWER) / (self.gain[i - 1] - self.gain[i])
        low, high = np.log(self.frequency_hz[i - 1 : i + 1])
        return float(np.exp(low + share * (high - low)))

    @property
    def peak(self) -> float:
        """Greatest gain."""
        return float(self.gain.max())


def measure_pressure_response(
    display: SoftnessDevice,
    amplitude_pa: float,
    clock: Clock,
    *,
    middle_pa: float = MIDDLE_PA,
    frequencies_hz: tuple[float, ...] = FREQUENCIES_HZ,
    progress: Progress = silent,
) -> PressureResponse:
    """Measure the response at each frequency, up to 200 Hz; the display is always vented at the end.

    The tip must be held stiffly halfway: a moving tip pumps the gas.
    """
    if not 0 < amplitude_pa <= min(middle_pa, display.range.greatest_pa - middle_pa):
        raise RangeError(
            f"a sine of {amplitude_pa / 1e3:g} kPa about {middle_pa / 1e3:g} kPa; it has to be above 0 and "
            f"to stay within 0 and {display.range.greatest_pa / 1e3:g} kPa",
            code="pressure",
        )
    rising = len(frequencies_hz) > 1 and np.all(np.diff(frequencies_hz) > 0)
    if not rising or not 0 < frequencies_hz[0] <= frequencies_hz[-1] <= 200.0:
        raise InputError("frequencies of a pressure's response are two or more, rising, above 0 to 200 Hz")
    answers = []
    display.release()
    try:
        for i, frequency_hz in enumerate(frequencies_hz):
            progress("frequencies", i, len(frequencies_hz))
            answers.append(_answer(display, amplitude_pa, middle_pa, 2 * math.pi * frequency_hz, clock))
    finally:
        display.vent()
    answer = np.array(answers)
    return PressureResponse(
        amplitude_pa, np.array(frequencies_hz), np.abs(answer) / amplitude_pa, np.unwrap(np.angle(answer))
    )


def _answer(
    display: SoftnessDevice, amplitude_pa: float, middle_pa: float, omega: float, clock: Clock
) -> complex:
    """Complex amplitude of what is measured while sin(omega t) is told [Pa]."""
    cycle_s = 2 * math.pi / omega
    fitted_s = max(CYCLES * cycle_s, MIN_FITTED_S)
    all(each_period(display, middle_pa, SETTLE_S, clock))
    times, seen = [], []
    began_ns = clock.now_ns()
    while (time_s := 1e-9 * (clock.now_ns() - began_ns)) < cycle_s + fitted_s:
        said = display.latest()
        if said.fault:
            raise DeviceError(f"the display says: {said.fault}", code="display-fault")
        times.append(time_s)
        seen.append(said.pressure_pa)
        wave = amplitude_pa * np.exp(1j * omega * time_s)
        display.set_pressure(middle_pa + float(wave.imag), omega * float(wave.real))
        clock.sleep(PERIOD_S)
    at, pressure = np.array(times), np.array(seen)
    if not np.isfinite(pressure).all():
        raise DeviceError("a pressure is no number; check the sensor")
    at, pressure = at[at >= cycle_s], pressure[at >= cycle_s]
    basis = np.column_stack([np.sin(omega * at), np.cos(omega * at), np.ones_like(at)])
    (sine, cosine, _), *_ = np.linalg.lstsq(basis, pressure, rcond=None)
    return complex(sine, cosine)
