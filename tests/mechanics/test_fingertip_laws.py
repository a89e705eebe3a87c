"""Fingertips on rigid and soft flats: closed forms, similarity, and what a composition costs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import InputError, PalpateError, RangeError
from palpate.mechanics.axisymmetric.tip_table import shipped_tips, tip_table
from palpate.mechanics.fingertip_laws import (
    Fingertip,
    exponential_fingertip,
    finite_strain_fingertip,
    hertz_fingertip,
    on_flat,
)
from palpate.mechanics.half_space.hertz import Body

BALL = Body(50e3, 15e-3)
MODULI = st.floats(1e3, 1e7)


def exponential() -> Fingertip:
    """Constants of no one's finger: round numbers."""
    return exponential_fingertip(0.1, 1.5e3, 80e-6, 0.5)


def share(tip: Fingertip, parts: int = 50) -> np.ndarray:
    return np.linspace(0.01, 1.0, parts) * tip.greatest_n


def test_a_hertz_fingertip_is_hertz_until_the_contact_is_half_its_radius() -> None:
    tip = hertz_fingertip(BALL)
    F = share(tip)
    assert_allclose(tip.approach_m(F), BALL.approach_m(F))
    assert_allclose(tip.area_m2(F), BALL.area_m2(F))
    assert_allclose(math.sqrt(float(tip.area_m2(tip.greatest_n)) / math.pi), BALL.radius_m / 2)
    with refused("outside-law", RangeError, match=r"1\.875"):
        tip.approach_m(1.01 * tip.greatest_n)
    with pytest.raises(RangeError):
        tip.area_m2(-1e-9)


def test_the_exponential_gives_back_its_force_and_its_power() -> None:
    tip = exponential()
    F = share(tip)
    assert_allclose(0.1 * (np.exp(1.5e3 * tip.approach_m(F)) - 1), F)
    assert_allclose(tip.area_m2(1.0), 80e-6)
    assert_allclose(tip.area_m2(2.0) / tip.area_m2(0.5), 2.0)
    assert float(tip.approach_m(0.0)) == float(tip.area_m2(0.0)) == 0.0
    with refused("outside-law", RangeError):
        tip.area_m2(2.1)


def test_a_table_is_its_own_tip_and_forces_grow_as_modulus_and_radius_squared() -> None:
    table = tip_table("base")
    press = table.press(math.inf)
    own = finite_strain_fingertip("base", table.radius_m, table.gel_pa)
    assert_allclose(own.approach_m(press.force_n), press.approach_m, rtol=1e-12)
    assert_allclose(own.area_m2(press.force_n), press.area_m2, rtol=1e-12)
    assert_allclose(own.area_m2(5.5), press.area_m2[-1], rtol=1e-12)
    other = finite_strain_fingertip("base", 2 * table.radius_m, 3 * table.gel_pa)
    assert_allclose(other.greatest_n, 12 * own.greatest_n)
    assert_allclose(other.approach_m(12 * press.force_n), 2 * press.approach_m, rtol=1e-12)
    assert_allclose(other.area_m2(12 * press.force_n), 4 * press.area_m2, rtol=1e-12)


@settings(max_examples=10)
@given(MODULI)
def test_a_hertz_finger_on_a_flat_is_the_pair_of_hertz(flat_pa: float) -> None:
    tip = on_flat(hertz_fingertip(BALL), flat_pa)
    pair, F = Body(flat_pa, math.inf).against(BALL), share(tip, 7)
    assert_allclose(tip.approach_m(F), pair.approach_m(F), rtol=1e-9)
    assert_allclose(tip.area_m2(F), pair.area_m2(F), rtol=1e-9)
    assert_allclose(pair.area_m2(tip.greatest_n), math.pi * (BALL.radius_m / 2) ** 2, rtol=1e-9)


@pytest.mark.parametrize("name", shipped_tips())
def test_on_a_soft_flat_the_composition_is_near_the_solution_at_finite_strain(name: str) -> None:
    table = tip_table(name)
    tip = finite_strain_fingertip(name, table.radius_m, table.gel_pa)
    F = np.array([0.5, 1.0, 2.0])
    for flat_pa in (60e3, 100e3, 400e3):
        solved, made = table.press(flat_pa), on_flat(tip, flat_pa / (1 - table.poisson_ratio**2))
        assert_allclose(made.approach_m(F), solved.at("approach_m", F), rtol=0.05)
        assert_allclose(made.area_m2(F), solved.at("area_m2", F), rtol=0.11)


@pytest.mark.parametrize(
    ("call", "error", "said"),
    [
        (lambda: exponential_fingertip(0.0, 1e3, 1e-4, 0.5), RangeError, "not-positive"),
        (lambda: exponential_fingertip(0.1, 1e3, math.nan, 0.5), RangeError, "not-positive"),
        (lambda: exponential_fingertip(0.1, 1e3, 1e-4, 0.7), RangeError, "exponent-range"),
        (lambda: exponential_fingertip(0.1, 1e3, 1e-4, 0.5, 2.5), RangeError, "outside-law"),
        (lambda: finite_strain_fingertip("thumb", 8e-3, 3e4), InputError, "unknown-name"),
        (lambda: finite_strain_fingertip("base", 0.0, 3e4), RangeError, "not-positive"),
        (lambda: hertz_fingertip(Body(5e4, math.inf)), RangeError, "not-finite"),
        (lambda: on_flat(exponential(), 0.0), RangeError, "not-positive"),
    ],
)
def test_fingers_that_no_one_has_are_refused(call, error: type[PalpateError], said: str) -> None:
    with refused(said, error):
        call()
