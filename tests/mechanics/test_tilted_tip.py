"""Inclined contact of a linear tip: symmetry, equilibrium, Hertz, and what friction may do."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.mechanics.axisymmetric.tilted_tip import TiltedContact, TiltedPress, tip_modes, top_modes
from palpate.mechanics.half_space.hertz import Body

NU = 0.48


@pytest.fixture(scope="module")
def tip():
    """A homogeneous tip, coarse."""
    return tip_modes(0.02, 0.001, 5e4, 5e4, NU, rings=20, azimuths=14, modes=16)


@pytest.fixture(scope="module")
def top():
    return top_modes(0.02, 0.04, 1e5, NU, rings=16, modes=16)


def pressed(tip, top, degrees, friction, approaches) -> list[TiltedPress]:
    return TiltedContact(tip, top, np.deg2rad(degrees), friction).through(np.array(approaches))


@pytest.mark.parametrize(("approach_mm", "over_hertz"), [(0.5, 1.119), (1.5, 1.254)])
def test_head_on_it_is_finite_strain_while_the_approach_is_small(tip, approach_mm, over_hertz) -> None:
    """Force on a rigid plate over Hertz's, as `tools/finite_strain` solved it: a held dome is stiffer."""
    both = Body(5e4 / (1 - NU**2), 0.02)
    (state,) = pressed(tip, None, 0.0, 0.0, [1e-3 * approach_mm])
    assert_allclose(state.lift_n / both.force_n(1e-3 * approach_mm), over_hertz, rtol=0.04)


def test_without_friction_the_force_is_along_the_specimens_normal(tip, top) -> None:
    (state,) = pressed(tip, top, 30.0, 0.0, [3e-3])
    assert_allclose(state.force_n[:, 1:], 0.0, atol=1e-9)
    assert_allclose(state.lift_n, 2 * np.cos(np.deg2rad(30)) * state.force_n[:, 0].sum(), rtol=1e-9)


def test_a_tilted_dome_touches_as_an_upright_one_while_the_contact_is_small(tip) -> None:
    """A sphere has no side: with the same approach along the normal, force and area hardly change."""
    upright, tilted = (
        pressed(tip, None, degrees, 0.0, [1.5e-3 / np.cos(np.deg2rad(degrees))])[0] for degrees in (0.0, 30.0)
    )
    normal = tilted.lift_n / np.cos(np.deg2rad(30))
    assert_allclose(normal, upright.lift_n, rtol=0.15)
    assert_allclose(tilted.area_m2, upright.area_m2, rtol=0.15)


def test_friction_pushes_up_the_slope_and_never_beyond_its_cone(tip, top) -> None:
    states = pressed(tip, top, 45.0, 0.5, np.linspace(0.5e-3, 4e-3, 6))
    for state in states:
        assert (np.hypot(*state.force_n[:, 1:].T) <= 0.5 * state.force_n[:, 0] + 1e-9).all()
    assert states[-1].force_n[:, 1].sum() > 0
    free = pressed(tip, top, 45.0, 0.0, [4e-3])[0]
    assert states[-1].lift_n > free.lift_n


def test_force_and_area_grow_with_the_approach_and_a_softer_specimen_has_the_larger_area(tip, top) -> None:
    approaches = np.linspace(1e-3, 7e-3, 7)
    soft, rigid = pressed(tip, top, 30.0, 0.5, approaches), pressed(tip, None, 30.0, 0.5, approaches)
    for states in (soft, rigid):
        assert (np.diff([s.lift_n for s in states]) > 0).all()
        assert (np.diff([s.area_m2 for s in states]) > 0).all()
    force = 0.9 * soft[-1].lift_n
    areas = [np.interp(force, [s.lift_n for s in x], [s.area_m2 for s in x]) for x in (soft, rigid)]
    assert areas[0] > areas[1]
