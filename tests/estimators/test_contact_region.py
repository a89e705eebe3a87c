"""The contact's region from fields of pins that are known in closed form."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError
from palpate.estimators.compliance.contact_area import (
    Field,
    RigidPlateStretch,
    cell_growth,
    outward,
    ring_ellipse,
    ring_px,
)
from palpate.estimators.pins import PinTracks


def lattice(rings=6, pitch=20.0, centre=(149.5, 149.5)) -> np.ndarray:
    steps = [
        (i, j) for i in range(-rings, rings + 1) for j in range(-rings, rings + 1) if abs(i + j) <= rings
    ]
    i, j = np.array(steps).T
    return np.array(centre) + pitch * np.stack([i + j / 2, np.sqrt(0.75) * j], axis=1)


def dome(at, ring=80.0, stretch=0.05, centre=(149.5, 149.5), squash=1.0, turn=0.0) -> np.ndarray:
    """Outward motion stretch r exp(-(r / ring)^2 / 2): greatest at the ring, and the stretch in the middle.

    With a squash the ring is an ellipse of half axes ring and ring / squash, the larger turned from x.
    """
    c, s = np.cos(turn), np.sin(turn)
    x = (at - np.array(centre)) @ np.array([[c, -s], [s, c]])
    r2 = (x[:, 0] ** 2 + (squash * x[:, 1]) ** 2) / ring**2
    return (at - np.array(centre)) * (stretch * np.exp(-r2 / 2))[:, None]


@pytest.mark.parametrize("ring", [50.0, 105.0])
def test_the_ring_is_where_motion_outwards_is_greatest(rng, ring) -> None:
    at = lattice()
    field = Field(at, dome(at, ring))
    assert_allclose(ring_px(field), ring, rtol=0.01)
    noisy = Field(at, dome(at, ring) + 0.05 * rng.standard_normal(at.shape))
    assert_allclose(ring_px(noisy), ring, rtol=0.03)
    assert np.isnan(ring_px(Field(at, 0.05 * (at - 149.5))))  # beyond the pins


def test_the_stretch_and_the_middle_are_those_of_the_field() -> None:
    at, centre = lattice(), (155.0, 146.0)
    field = Field(at, dome(at, 90.0, 0.04, centre))
    assert_allclose(field.middle_px, centre, atol=0.3)
    assert_allclose(field.stretch(), 0.04 * np.eye(2), atol=2e-3)
    r, away = outward(field)
    assert_allclose(away, 0.04 * r * np.exp(-((r / 90) ** 2) / 2), atol=0.05)


def test_an_inclined_contacts_ring_is_an_ellipse() -> None:
    at, turn = lattice(), 1.2
    found = ring_ellipse(Field(at, dome(at, 80.0, squash=1.3, turn=turn)))
    assert_allclose(found.axes_px, (80.0, 80.0 / 1.3), rtol=0.04)
    assert_allclose(np.cos(2 * (found.angle_rad - turn)), 1.0, atol=0.05)
    assert found.visible_share == 1.0


def test_cells_grow_as_the_field_diverges() -> None:
    at = lattice()
    growth = cell_growth(Field(at, 0.02 * (at - 149.5)))
    inner = np.isfinite(growth)
    assert inner.sum() > 60
    assert_allclose(growth[inner], 2 * np.log(1.02), rtol=1e-9)


def test_the_ratio_to_a_rigid_plate_is_one_on_it_and_less_where_it_is_softer() -> None:
    rings = np.linspace(40, 110, 12)
    rigid = RigidPlateStretch.fitted(rings, 0.001 * rings)
    assert_allclose(rigid.ratio(75.0, 0.075), 1.0, rtol=1e-6)
    assert rigid.ratio(75.0, 0.06) < 0.85
    with refused("ring-outside-range", RangeError):
        rigid.ratio(150.0, 0.1)
    with refused("too-few-rings", InputError):
        RigidPlateStretch.fitted(rings[:3], rings[:3])


def test_lost_pins_are_left_out_and_too_few_are_refused() -> None:
    at = lattice()
    reach, weight = np.full(len(at), 9.0), np.ones(len(at))
    first = PinTracks(at, 18, 200, reach, weight)
    moved = at + 1.0
    moved[:100] = np.nan
    assert len(Field.between(first, PinTracks(moved, 18, 200, reach, weight)).at_px) == 27
    moved[:120] = np.nan
    with refused("pins-lost", InputError):
        Field.between(first, PinTracks(moved, 18, 200, reach, weight))
