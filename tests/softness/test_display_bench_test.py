"""A display's bench test: what the law misses, and displays and sensors that are not as stated are found."""

import math
from dataclasses import replace

import pytest
from tests.refusals import refused

from palpate.core import DeviceError, InputError, ManualClock, RangeError
from palpate.softness import ConeDisplay
from palpate.softness.display_bench_test import BenchPoint, BenchTest, IndentationPlan, run_bench_test
from palpate.softness.display_parts import DisplaySensors
from palpate.softness.virtual.rendering_bench import (
    CLAMPED,
    PROBE,
    BenchParts,
    HeldProbe,
    RenderingBench,
    virtual_bench_test,
)

SHORT = IndentationPlan((10e3, 30e3), (3e-3, 6e-3, 9e-3), 10e-3, 0.2, 0.05)
STATED = ConeDisplay(sleeve_n_m=20.0)


@pytest.fixture(scope="module")
def good() -> BenchTest:
    return virtual_bench_test(SHORT)


def test_a_display_as_stated_keeps_the_law_and_shows_its_sleeve(good: BenchTest) -> None:
    fit = good.fit()
    assert good.rms_n < 0.001 * good.peak_n
    assert fit.scale == pytest.approx(1.0, abs=0.002)
    assert fit.sleeve_n_m == pytest.approx(20.0, abs=0.3)
    assert abs(fit.friction_n) < 1e-3  # at rest, where the bench's smoothed friction has crept away


class WrongScale:
    """A display whose pressure sensor says 0.9 of what is."""

    def __init__(self, display) -> None:
        self._display = display

    def __getattr__(self, name: str):
        return getattr(self._display, name)

    def latest(self):
        seen = self._display.latest()
        return replace(seen, pressure_pa=0.9 * seen.pressure_pa)


class NoHall(WrongScale):
    """A display whose Hall sensor stands still."""

    def latest(self):
        return replace(self._display.latest(), pushed_m=0.0)


def _bench() -> tuple[RenderingBench, HeldProbe, ManualClock]:
    probe, clock = HeldProbe(), ManualClock()
    parts = BenchParts(arm=CLAMPED, finger=PROBE, sensors=DisplaySensors())
    return RenderingBench(clock, probe, parts), probe, clock


def _run(kind, plan: IndentationPlan = SHORT) -> tuple[BenchTest, RenderingBench]:
    bench, probe, clock = _bench()
    display = kind(bench.display)
    return run_bench_test(plan, display, probe.move, lambda: bench.truth().force_n, clock, STATED), bench


def test_a_pressure_sensor_of_a_wrong_scale_is_found_and_the_display_is_vented_at_the_end() -> None:
    test, bench = _run(WrongScale)
    assert test.fit().scale == pytest.approx(1 / 0.9, abs=0.003)
    with pytest.raises(DeviceError, match="vented"):
        bench.display.set_pressure(1e3)


def test_a_tip_that_does_not_go_with_the_probe_ends_the_test_vented() -> None:
    bench, probe, clock = _bench()
    with refused("tip-position", DeviceError, match=r"3\.00 mm"):
        run_bench_test(SHORT, NoHall(bench.display), probe.move, lambda: 0.0, clock)
    with pytest.raises(DeviceError, match="vented"):
        bench.display.set_pressure(1e3)


def test_the_fit_gives_back_what_made_the_points() -> None:
    points = tuple(
        BenchPoint(p, p, s, 0.8 * p * math.pi * (0.65 * s) ** 2 + 30.0 * s + 0.05 * d, d)
        for p in (1e4, 3e4) for s in (2e-3, 5e-3, 8e-3) for d in (1, -1)
    )  # fmt: skip
    fit = BenchTest(ConeDisplay(), points).fit()
    assert (fit.scale, fit.sleeve_n_m, fit.friction_n) == pytest.approx((0.8, 30.0, 0.05), rel=1e-9)
    with pytest.raises(InputError, match="both ways"):
        BenchTest(ConeDisplay(), tuple(replace(one, pressure_pa=0.0) for one in points)).fit()


@pytest.mark.parametrize(
    "wrong",
    [
        {"pressures_pa": (1e4,)},
        {"pressures_pa": (1e4, math.nan)},
        {"ways_m": (2e-3, 1e-3)},
        {"settle_s": 0.0},
    ],
)
def test_a_plan_that_tells_nothing_is_refused(wrong: dict) -> None:
    with pytest.raises((InputError, RangeError)):
        IndentationPlan(**wrong)


def test_a_plan_beyond_the_display_is_refused_before_it_is_released() -> None:
    with refused("display-limits", RangeError, match="100 kPa"):
        virtual_bench_test(replace(SHORT, ways_m=(3e-3, 11e-3)))
