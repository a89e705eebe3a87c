"""Laws of contacts and rings found in a skin's strain."""

import math

import numpy as np
import pytest

import palpate
from palpate.core import Pose
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.surface_strain import StrainMeter, contact_peaks, find_rings, on_plane

SENSOR = palpate.sensor("nusense")
SPEC = SENSOR.spec
PITCH = 2.4e-3


def grid():
    column, row = np.meshgrid(np.arange(20), np.arange(15))
    cells = np.column_stack([column.ravel(), row.ravel()])
    return cells, PITCH * (cells - cells.mean(axis=0))


def formed(centre, s=4e-3, q=2.0, A=5e-4, B=0.0, T=(0.0, 0.0)):
    """Marks moved by the form itself."""
    _cells, at = grid()
    d = (at - centre) / s
    w = (1 + (d**2).sum(axis=1))[:, None]
    return at + (A * d + B * np.stack([-d[:, 1], d[:, 0]], axis=1)) * w**-q + np.array(T) * w ** (-q - 1)


def fields_of(places, rng=None, sigma=1e-9):
    cells, at = grid()
    noise = [np.zeros_like(at)] * 2 if rng is None else sigma * rng.normal(size=(2, *at.shape))
    one, other = (
        ControlPoints(cells, p + n, np.full(len(cells), sigma), "m")
        for p, n in ((at, noise[0]), (places, noise[1]))
    )
    return StrainMeter(one).fields(other)


def seen(contact, rng, sigma=0.05):
    """Corners of the virtual sensor with noise, on its pattern [m]."""
    truth = SENSOR.tile_corners(contact)
    places = truth.places_px + sigma * rng.normal(size=truth.places_px.shape)
    return on_plane(ControlPoints(truth.cells, places, np.full(len(places), sigma)), SPEC.lens, SPEC.camera_m)


def press(words, x=0.0, y=0.0, depth=0.0):
    return SENSOR.press(SENSOR.probe(words), Pose(x, y, depth))


def test_the_form_itself_comes_back():
    (ring,) = find_rings(fields_of(formed((3e-3, -2e-3), B=1e-4, T=(5e-5, -8e-5))))
    r = 1 / math.sqrt(3)
    top = r * (1 + r * r) ** -2
    assert (ring.x, ring.y) == pytest.approx((3e-3, -2e-3), abs=2e-6)
    assert ring.radius == pytest.approx(4e-3 * r, rel=1e-3)
    assert ring.outward == pytest.approx(5e-4 * top, rel=1e-3)
    assert ring.around == pytest.approx(1e-4 * top, rel=1e-3)
    assert ring.along == pytest.approx((5e-5, -8e-5), rel=1e-2)


def test_stated_errors_are_those_of_noise_drawn():
    rng = np.random.default_rng(4)
    rings = [find_rings(fields_of(formed((1e-3, 2e-3)), rng, 8e-6))[0] for _ in range(100)]
    for name in ("x", "y", "radius", "outward", "around"):
        drawn = np.std([getattr(ring, name) for ring in rings])
        stated = np.mean([getattr(ring, f"{name}_error") for ring in rings])
        assert drawn == pytest.approx(stated, rel=0.25), name


def test_presses_of_the_virtual_pad_are_found_where_they_are():
    """Corners with noise of 0.05 px: the thesis has 0.50 mm."""
    rng = np.random.default_rng(7)
    meter = StrainMeter(seen(press("round"), rng))
    off, pull = [], []
    for depth in (0.9e-3, 1.5e-3):
        for _ in range(5):
            x, y = rng.uniform(-16e-3, 16e-3), rng.uniform(-10.5e-3, 10.5e-3)
            (ring,) = find_rings(meter.fields(seen(press("round", x, y, depth), rng)))
            off.append((ring.x - x, ring.y - y))
            pull += [(ring.x - x) / ring.x_error, (ring.y - y) / ring.y_error]
            assert 1e-3 < ring.radius < 3e-3
    assert np.sqrt(np.mean(np.sum(np.square(off), axis=1))) < 0.15e-3
    assert 0.4 < np.std(pull) < 1.6


def test_no_contact_has_no_ring():
    rng = np.random.default_rng(8)
    rest = press("round")
    meter = StrainMeter(seen(rest, rng))
    assert not any(contact_peaks(meter.fields(seen(rest, rng))) for _ in range(60))


@pytest.mark.parametrize(("words", "count"), [("two-points:4:8:30", 2), ("round", 1), ("edge:20:35", 1)])
def test_contacts_are_counted(words, count):
    rng = np.random.default_rng(9)
    meter = StrainMeter(seen(press(words), rng))
    found = contact_peaks(meter.fields(seen(press(words, 1e-3, 0.0, 0.6e-3), rng)))
    assert len(found) == count
    if words.startswith("two"):
        _, _, apart, *turn = words.split(":")
        half = float(apart) / 2e3 * np.exp(1j * math.radians(float(*turn) if turn else 0.0))
        rings = find_rings(meter.fields(seen(press(words, 1e-3, 0.0, 0.6e-3), rng)))
        places = sorted((complex(r.x - 1e-3, r.y) for r in rings), key=lambda z: z.real)
        np.testing.assert_allclose(places, [-half, half], atol=0.35e-3)


def test_a_pull_inwards_is_no_contact():
    inward, outward = (find_rings(fields_of(formed((0, 0), A=A))) for A in (-5e-4, 5e-4))
    assert any(math.hypot(ring.x, ring.y) < 4e-3 for ring in outward)
    assert not any(math.hypot(ring.x, ring.y) < 4e-3 for ring in inward)
