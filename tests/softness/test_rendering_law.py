"""The rendering law: golden values of the report's foam, both cues apart, onset and what is not rendered."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics.half_space.hertz import Body
from palpate.softness import (
    Characteristic,
    DisplayBounds,
    Limit,
    RenderingLaw,
    SoftObject,
    hertz_object,
    polynomial,
)  # fmt: skip

CM2 = 1e-4
FINGER = Body(1e5, 15e-3)
WAY = np.linspace(0.0, 10e-3, 2001)[1:]
WIDE = DisplayBounds(pressure_pa=100e3, force_n=20.0, arm_m=(-30e-3, 30e-3))


def foam(displacement_m: float = 1e-2) -> SoftObject:
    """The report's foam, P = 1.4 A² + 0.33 A + 0.554 with A in cm²; the unit of its 42 d + 0.64 is open."""
    return SoftObject(
        "foam",
        polynomial("area", [0.554, 0.33, 1.4], CM2, 1.35 * CM2),
        polynomial("displacement", [0.64, 42.0], displacement_m, 0.08 * displacement_m),
        "the report",
    )


def ball(greatest_n: float = 8.0) -> SoftObject:
    return hertz_object("ball", Body(5e4, 10e-3), FINGER, greatest_n)


def test_the_foam_needs_the_pressures_of_its_polynomial() -> None:
    law = RenderingLaw(foam(), bounds=WIDE)
    state = law.at(WAY)
    least = int(np.argmin(np.where(state.rendered, state.pressure_pa, np.inf)))
    assert_allclose(state.pressure_pa[least] / 1e3, 20.91, atol=0.01)
    assert_allclose(state.area_m2[least] / CM2, 0.6291, atol=2e-3)
    assert_allclose(state.pressure_pa[-1] / 1e3, 26.06, atol=0.01)
    strong = RenderingLaw(foam(), bounds=DisplayBounds(600e3, 20.0, (-30e-3, 30e-3)))
    at_tenth = strong.at(strong.display.pushed_m(0.1 * CM2))
    assert_allclose(at_tenth.pressure_pa / 1e3, 60.1, atol=0.05)
    assert at_tenth.rendered.all()


def test_below_the_area_of_its_greatest_pressure_the_foam_is_not_rendered() -> None:
    law = RenderingLaw(foam(), bounds=WIDE)
    alpha = law.object.area
    bare = alpha.x[np.argmax(alpha.force_n / np.maximum(alpha.x, 1e-12) < 100e3)]
    assert_allclose(bare / CM2, 0.058, atol=1e-3)
    assert law.onset.area_m2 >= bare * 0.99  # the line of the onset needs more than the bare quotient
    state = law.at(WAY)
    assert set(state.limit[state.area_m2 < law.onset.area_m2]) == {Limit.ONSET}
    assert state.pressure_pa.max() <= 100e3


def test_the_printed_form_of_the_arms_reference_is_the_same() -> None:
    law = RenderingLaw(ball(), bounds=WIDE)
    state = law.at(WAY)
    P, p = state.force_n, state.pressure_pa
    printed = law.object.displacement.at_force(P) - 10 / 6.5 * np.sqrt(P / (p * math.pi))
    assert_allclose(state.arm_m[state.rendered], printed[state.rendered], atol=1e-12)
    assert state.rendered.any()


def test_both_cues_of_a_ball_are_met_wherever_it_is_rendered() -> None:
    law = RenderingLaw(ball(), bounds=WIDE)
    state = law.at(WAY)
    both = Body(5e4, 10e-3).against(FINGER)
    good = state.rendered & (state.area_m2 > 0.5e-6)  # a table's first piece is straight
    assert good.mean() > 0.5
    assert_allclose(both.area_m2(state.force_n[good]), state.area_m2[good], rtol=2e-3)
    assert_allclose(both.approach_m(state.force_n[good]), state.displacement_m[good], rtol=2e-3)


def test_the_onset_meets_value_and_slope_and_force_rises_through_it() -> None:
    law = RenderingLaw(foam(), bounds=WIDE)
    A = law.onset.area_m2
    forces = law.onset.force_n(A * np.array([1 - 2e-4, 1 - 1e-4, 1.0, 1 + 1e-4]))
    assert_allclose(forces[1] / forces[2], 1.0, atol=1e-3)
    assert_allclose(np.diff(forces)[0], np.diff(forces)[2], rtol=2e-2)
    state = law.at(WAY)
    assert (np.diff(state.force_n) > 0).all()
    assert_allclose(law.at(0.0).force_n, 0.0)


@given(st.floats(0.0, 2.0), st.floats(0.05, 3.0), st.floats(0.0, 5.0), st.floats(2e4, 2e5))
def test_no_object_asks_for_more_than_the_bounds(zero_n, slope_n, square_n, pressure_pa) -> None:
    soft = SoftObject(
        "any", polynomial("area", [zero_n, slope_n, square_n], CM2, 1.5 * CM2),
        polynomial("displacement", [0.0, 100.0], 1.0, 0.2), "",
    )  # fmt: skip
    try:
        law = RenderingLaw(soft, bounds=DisplayBounds(pressure_pa=pressure_pa, arm_m=(-5e-3, 5e-3)))
    except RangeError:
        return
    state = law.at(WAY)
    assert state.pressure_pa.min() >= 0.0
    assert state.pressure_pa.max() <= pressure_pa * (1 + 1e-9)
    assert np.abs(state.arm_m).max() <= 5e-3
    good = state.rendered
    assert_allclose(state.force_n[good], soft.area.force_at(state.area_m2[good]), rtol=1e-6)


def test_each_limit_is_named() -> None:
    tight = RenderingLaw(ball(), bounds=DisplayBounds(100e3, 0.5, (-2e-3, 0.5e-3))).at(WAY)
    assert {Limit.ARM, Limit.FORCE} <= set(tight.limit)
    assert Limit.AREA in RenderingLaw(ball(0.5), bounds=WIDE).at(WAY).limit
    weak = RenderingLaw(foam(), bounds=DisplayBounds(24e3, 20.0, (-30e-3, 30e-3))).at(WAY)
    assert Limit.PRESSURE in weak.limit
    assert weak.rendered.any()


def test_what_no_display_renders_is_refused() -> None:
    with refused("pressure", RangeError, match="1 kPa"):
        RenderingLaw(foam(), bounds=DisplayBounds(pressure_pa=1e3))
    curve = Characteristic("area", np.array([2e-4, 3e-4]), np.array([1.0, 2.0]))
    late = SoftObject("late", curve, ball().displacement, "")
    with refused("area", RangeError, match="200"):
        RenderingLaw(late)
    with pytest.raises(RangeError):
        RenderingLaw(ball()).at(math.nan)
    with pytest.raises(RangeError, match="above 0"):
        DisplayBounds(pressure_pa=math.inf)
    with refused("arm-range", RangeError, match="0 mm"):
        DisplayBounds(arm_m=(1e-3, 2e-3))
