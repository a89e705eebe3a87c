"""Laws of traction recovered from a pattern's motion, against the virtual pad's truth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from tests.refusals import refused

import palpate
from palpate.core import InputError, Pose, PressHistory, RangeError
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.surface_strain import (
    PatternedSkin,
    StrainMeter,
    contact_peaks,
    on_plane,
    recover_traction,
    traction_recovery,
)
from palpate.sensors.nusense.pad_view import seen_px

SENSOR = palpate.sensor("nusense")
SPEC = SENSOR.spec
SKIN = PatternedSkin(SPEC.layers.stack, 2, SPEC.camera_m, SPEC.friction)


def seen(contact, rng, sigma=0.05):
    truth = SENSOR.tile_corners(contact)
    places = truth.places_px + sigma * rng.normal(size=truth.places_px.shape)
    return on_plane(ControlPoints(truth.cells, places, np.full(len(places), sigma)), SPEC.lens, SPEC.camera_m)


def seen_together(contacts, rng, sigma):
    """Marks under several contacts: on linear layers their motions add up."""
    truths = [SENSOR.tile_corners(contact) for contact in contacts]
    rest = np.column_stack([truths[0].rest_m, np.zeros(len(truths[0].rest_m))])
    places = seen_px(SPEC, rest + sum(truth.skin_m - rest for truth in truths), (0.0, 0.0))
    places = places + sigma * rng.normal(size=places.shape)
    marks = ControlPoints(truths[0].cells, places, np.full(len(places), sigma))
    return on_plane(marks, SPEC.lens, SPEC.camera_m)


def press(depth, x=3e-3, y=-2e-3, lateral=None):
    history = PressHistory() if lateral is None else PressHistory(lateral_n=lateral)
    return SENSOR.press(SENSOR.probe("round"), Pose(x, y, depth), history=history)


@pytest.fixture(scope="module")
def meter():
    return StrainMeter(seen(press(0.0), np.random.default_rng(0)))


def test_force_of_a_press_comes_back(meter):
    """From 2 to 8 N: the mean to 5 %, and each to 8 %."""
    rng = np.random.default_rng(1)
    for depth in (0.75e-3, 1.7e-3):
        off = []
        for _ in range(2):
            contact = press(depth, rng.uniform(-12e-3, 12e-3), rng.uniform(-8e-3, 8e-3))
            found = recover_traction(meter.fields(seen(contact, rng)), SKIN)
            off.append(found.force_n / contact.force_n - 1)
            assert found.force_n == pytest.approx(found.pressure_pa.sum() * found.spacing_m**2)
            assert 0.8 < found.misfit < 1.2
            centre = found.pressure_pa @ found.nodes_m / found.pressure_pa.sum()
            assert np.hypot(*(centre - [contact.pose.x_m, contact.pose.y_m])) < 0.25e-3
        assert abs(np.mean(off)) < 0.05
        assert np.abs(off).max() < 0.08


def test_force_goes_with_the_modulus(meter):
    """An image tells p/E: a skin taken for 10 % stiffer gives 10 % more."""
    contact = press(1.5e-3)
    fields = meter.fields(seen(contact, np.random.default_rng(2)))
    layers = SPEC.layers
    stiffer = replace(
        layers, rubber_pa=1.1 * layers.rubber_pa, gel_pa=1.1 * layers.gel_pa, pdms_pa=1.1 * layers.pdms_pa
    )
    one, other = (recover_traction(fields, skin) for skin in (SKIN, replace(SKIN, stack=stiffer.stack)))
    assert other.force_n / one.force_n == pytest.approx(1.1, abs=0.01)


def test_a_wrong_support_shows_in_the_force(meter):
    """The control: the same layers on a half-space of gel are another skin."""
    from palpate.mechanics.layers.stack import ElasticLayer, Stack

    contact = press(1.5e-3)
    fields = meter.fields(seen(contact, np.random.default_rng(2)))
    first, second, gel, *_ = SPEC.layers.stack.layers
    endless = Stack(
        (first, second, ElasticLayer(np.inf, gel.youngs_modulus_pa, gel.poisson_ratio)), "half-space"
    )
    found = recover_traction(fields, replace(SKIN, stack=endless))
    assert abs(found.force_n / contact.force_n - 1) > 0.1 or found.misfit > 1.5


def test_a_lateral_load_comes_back_under_friction(meter):
    contact = press(1.5e-3)
    load = (-0.35 * contact.force_n, 0.1 * contact.force_n)
    pulled = press(1.5e-3, lateral=load)
    fields = meter.fields(seen(pulled, np.random.default_rng(3)))
    found = recover_traction(fields, SKIN, "coulomb")
    assert found.lateral_n == pytest.approx(load, abs=0.06 * contact.force_n)
    assert found.misfit < 1.2
    assert (np.hypot(*found.shear_pa.T) <= SKIN.friction * found.pressure_pa * (1 + 1e-9) + 1e-6).all()
    assert recover_traction(fields, SKIN, "frictionless").misfit > 2  # the control: this law cannot pull


def test_under_a_light_touch_noise_elsewhere_on_the_skin_is_no_load():
    """At 0.1 N the stretch stands out of the noise by little; force and nodes stay those of the contact."""
    rng, sigma = np.random.default_rng(6), 0.01
    meter = StrainMeter(seen(press(0.0), np.random.default_rng(0), sigma))
    for _ in range(8):
        contact = press(0.12e-3, rng.uniform(-10e-3, 10e-3), rng.uniform(-6e-3, 6e-3))
        found = recover_traction(meter.fields(seen(contact, rng, sigma)), SKIN)
        assert found.force_n == pytest.approx(contact.force_n, abs=0.05)
        assert np.hypot(*(found.nodes_m - [contact.pose.x_m, contact.pose.y_m]).T).max() < 8e-3


def test_a_lesser_contact_that_is_no_peak_of_its_own_carries_its_load():
    """2 N and 1 N at 7 mm, or 0.5 N twice at 14 mm and more: patches of stretch beside that of the peak."""
    rng, sigma = np.random.default_rng(8), 0.01
    meter, without_peak = StrainMeter(seen(press(0.0), np.random.default_rng(0), sigma)), 0
    for turn in np.radians([40.0, 140.0]):
        x, y = 3.5e-3 * np.cos(turn), 3.5e-3 * np.sin(turn)
        near = [press(0.81e-3, x, y), press(0.54e-3, -x, -y)]
        apart = [press(0.81e-3, 2 * x, 2 * y), press(0.36e-3, -2 * x, -2 * y), press(0.36e-3, -2 * y, 2 * x)]
        for contacts in (near, apart):
            fields = meter.fields(seen_together(contacts, rng, sigma))
            without_peak += len(contact_peaks(fields)) < len(contacts)
            found, force = recover_traction(fields, SKIN), sum(contact.force_n for contact in contacts)
            assert found.force_n == pytest.approx(force, rel=0.03)
            assert found.misfit < 1.2
    assert without_peak >= 2  # the control: of 4


def test_no_contact_has_no_traction(meter):
    rng = np.random.default_rng(4)
    assert recover_traction(meter.fields(seen(press(0.0), rng)), SKIN) is None


def test_what_cannot_be_recovered_is_refused(meter):
    fields = meter.fields(seen(press(1e-3), np.random.default_rng(5)))
    with refused("unknown-name", InputError):
        recover_traction(fields, SKIN, "sticky")
    with refused("not-positive", RangeError):
        recover_traction(fields, SKIN, step_pa=0.0)
    with refused("unit-differs", InputError):
        recover_traction(replace(fields, unit="px"), SKIN)
    with refused("standard-errors", InputError):
        recover_traction(replace(fields, variances=0 * fields.variances), SKIN)
    with refused("layer-count", InputError):
        PatternedSkin(SPEC.layers.stack, 7)


def test_motion_under_loads_is_scipy_s_of_nine_splines_seen_through_the_camera() -> None:
    """At places that no spline reaches, beyond the grid of 102 mm, nothing moves."""
    rng = np.random.default_rng(3)
    skin = replace(SKIN, camera_m=25e-3)
    at, nodes = rng.uniform(-15e-3, 15e-3, (40, 2)), rng.uniform(-5e-3, 5e-3, (12, 2))
    knots = traction_recovery._node_motion(skin.stack, skin.interface, 1e-3)
    dx, dy = ((at[:, i, None] - nodes[:, i]) / traction_recovery.CELL_M + len(knots) / 2 for i in range(2))
    seen = traction_recovery._motion(skin, skin.interface, at, nodes, 1e-3)
    for load in range(3):
        x, y, z = (map_coordinates(knots[..., load, i], [dy, dx], order=3, prefilter=False) for i in range(3))
        there = np.concatenate([x + at[:, :1] * z / 25e-3, y + at[:, 1:] * z / 25e-3])
        np.testing.assert_allclose(seen[load], there, rtol=0, atol=1e-12 * np.abs(there).max())
    away = traction_recovery._motion(skin, skin.interface, at + 80e-3, nodes, 1e-3)
    assert np.all(np.array(away) == 0.0)
