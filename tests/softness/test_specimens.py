"""Specimens of the report's three classes: what each keeps alike, and by how much it does not."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import InputError, PalpateError, RangeError
from palpate.mechanics.half_space.hertz import Body
from palpate.mechanics.layers.bonded_layer import punch_factor
from palpate.softness import SpecimenClass, series_spread, specimen_object, specimens
from palpate.softness.specimens import HEIGHT_M, RADIUS_M, plate_stiffness_n_m

FINGER = Body(100e3 / 0.75, 15e-3)
MODULI = (8e5, 5e5, 3e5, 1.5e5, 1e5)  # of no silicone in particular
ALIKE, PLATE, MIRRORED = SpecimenClass


def at(kind: SpecimenClass, force_n: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and area of the five at a force."""
    objects = [specimen_object(one, FINGER, force_n) for one in specimens(kind, MODULI)]
    return (
        np.array([float(soft.displacement.at_force(force_n)) for soft in objects]),
        np.array([float(soft.area.at_force(force_n)) for soft in objects]),
    )


def test_in_the_first_class_softener_adds_to_both_cues() -> None:
    way, area = at(ALIKE, 2.0)
    assert (np.diff(way) > 0).all()
    assert (np.diff(area) > 0).all()
    assert way[-1] / way[0] > 1.2
    assert area[-1] / area[0] > 1.4


def test_under_a_plate_areas_are_one_and_ways_differ_as_its_disc_yields() -> None:
    way, area = at(PLATE, 2.0)
    assert_allclose(area, area[0], rtol=1e-9)
    assert_allclose(area[0], FINGER.area_m2(2.0), rtol=1e-9)
    rest = way - FINGER.approach_m(2.0)
    assert_allclose(rest * MODULI, rest[0] * MODULI[0])
    assert_allclose(rest[0], 2.0 / plate_stiffness_n_m(MODULI[0]))


def test_a_bonded_disc_is_homogeneous_strain_and_the_pressure_that_its_faces_hold() -> None:
    """Of an incompressible disc dp/dr = -2 E e r / h^2 besides E e; a layer without end yields less."""
    r = (np.arange(2000) + 0.5) * RADIUS_M / 2000
    stress = 1e5 * (1 + (RADIUS_M**2 - r**2) / HEIGHT_M**2)  # per strain e
    held = (stress * 2 * math.pi * r).sum() * RADIUS_M / 2000 / HEIGHT_M
    assert_allclose(plate_stiffness_n_m(1e5, 0.5), held, rtol=1e-6)
    endless = 2 * RADIUS_M * 1e5 / (1 - 0.499**2) * punch_factor(RADIUS_M / HEIGHT_M, 0.499)
    assert_allclose(endless / plate_stiffness_n_m(1e5, 0.499), 1.046, atol=2e-3)


def test_mirrored_pairs_have_nearly_one_way_and_less_area_with_the_stiffer_above() -> None:
    way, area = at(MIRRORED, 2.0)
    assert_allclose([way[4] / way[0], way[3] / way[1]], [1.099, 1.047], atol=2e-3)
    assert_allclose([area[4] / area[0], area[3] / area[1]], [1.327, 1.171], atol=2e-3)
    assert (np.diff(area) > 0).all()


def test_springs_in_a_line_are_alike_where_the_sums_of_compliance_are() -> None:
    """The report's condition: 1/E(0) + 1/E(45) = 1/E(10) + 1/E(35) = 2/E(20)."""
    compliance = np.array([1.0, 1.5, 3.0, 4.5, 5.0]) * 1e-6
    assert_allclose(series_spread(specimens(MIRRORED, list(1 / compliance))), 0, atol=1e-12)
    compliance[2] = 2.0e-6
    assert_allclose(series_spread(specimens(MIRRORED, list(1 / compliance))), 0.5)


@pytest.mark.parametrize("kind", list(SpecimenClass))
def test_a_curve_ends_at_the_force_asked_or_where_strain_is_small_no_more(kind: SpecimenClass) -> None:
    one = specimens(kind, MODULI)[4]
    assert_allclose(specimen_object(one, FINGER, 1.25).greatest_n, 1.25)
    most = specimen_object(one, FINGER).greatest_n
    for force in (0.0, -1.0, 1.001 * most, math.nan):
        with pytest.raises(RangeError, match="at most"):
            specimen_object(one, FINGER, force)


@pytest.mark.parametrize(
    ("moduli", "poisson", "error", "said"),
    [
        (MODULI[:4], 0.49, InputError, "moduli-count"),
        (MODULI[::-1], 0.49, InputError, "moduli-order"),
        ((*MODULI[:4], 1.5e5), 0.49, InputError, "moduli-order"),
        ((*MODULI[:4], 0.0), 0.49, RangeError, "modulus"),
        ((math.nan, *MODULI[1:]), 0.49, RangeError, "modulus"),
        (MODULI, 0.5, RangeError, "poisson"),
        (MODULI, -0.1, RangeError, "poisson"),
    ],
)
def test_moduli_that_are_no_silicones_are_refused(
    moduli, poisson: float, error: type[PalpateError], said: str
) -> None:
    with refused(said, error):
        specimens(MIRRORED, moduli, poisson)
