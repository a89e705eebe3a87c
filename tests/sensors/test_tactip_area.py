"""A_c0 in mm² through the camera: of the spec, or of a lens file, also among glare and with pins hidden."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.nuisance_pins import Glare, _blob, _discs
from tests.refusals import refused

from palpate.core import InputError, Lens
from palpate.estimators.pins import find_pins
from palpate.sensors.tactip import tactip
from palpate.sensors.tactip.posed_tip import skin_places_m, untouched_area_m2
from palpate.sensors.tactip.tactip_press import _projected, head_on, pictured

LENS = Lens("kannala-brandt", (220.0, 221.0), (133.0, 135.0), (-0.12, 0.05, -0.01, 0.0), (267, 267))


def true_mm2(spec) -> float:
    return np.pi * (1e3 * spec.pins.rings * spec.pins.pitch_m) ** 2


def untouched(spec):
    return head_on(spec.table.press(np.inf), spec.table.radius_m, 0.0, (0.0, 0.0))


def frame(places: np.ndarray, radius: float, size: int, seed: int) -> np.ndarray:
    """Twenty pins hidden, five lamps beyond the rest, side light, blur by nothing but the discs' edges."""
    rng = np.random.default_rng(seed)
    shown = rng.permutation(len(places))[20:]
    y, x = np.mgrid[:size, :size]
    image = 20 + 170 * _discs(places[shown], np.full(len(shown), radius), size)
    image *= 0.6 + 0.4 * x / size
    reach = np.hypot(*(places - places.mean(axis=0)).T).max()
    for angle in np.arange(5) * 1.256 + 0.3:
        at = places.mean(axis=0) + 1.2 * reach * np.array([np.cos(angle), np.sin(angle)])
        image = np.maximum(image, _blob(x, y, Glare(at, 0.04 * size, 0.017 * size, angle + 1.57, 255.0)))
    return np.clip(np.rint(image + 2 * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def found():
    """Pins of a frame through the spec's own camera."""
    spec = tactip(127)
    places, radius = pictured(spec, untouched(spec), (1.5, -0.8))
    return find_pins(frame(places, float(radius.mean()), 300, seed=127))


def test_the_area_is_the_spec_s_through_its_own_camera(found) -> None:
    spec = tactip(127)
    assert_allclose(1e6 * untouched_area_m2(spec, found.xy_px, found.cells), true_mm2(spec), rtol=0.01)


def test_the_area_is_the_same_through_a_wide_lens() -> None:
    """In its pixels the field is no copy of the skin: the middle is drawn wider than the rim."""
    spec = tactip(127)
    tangent, _ = _projected(spec, untouched(spec))
    places = LENS.project(np.column_stack([tangent, np.ones(len(tangent))]))
    found = find_pins(frame(places, 3.0, 267, seed=1))
    assert_allclose(1e6 * untouched_area_m2(spec, found.xy_px, found.cells, LENS), true_mm2(spec), rtol=0.01)
    wrong = Lens("pinhole", LENS.focal_px, LENS.centre_px, (0.0,) * 5, LENS.size_px)
    assert abs(1e6 * untouched_area_m2(spec, found.xy_px, found.cells, wrong) / true_mm2(spec) - 1) > 0.02


def test_places_on_the_skin_are_those_the_pins_stand_at() -> None:
    spec = tactip(127)
    places, _ = pictured(spec, untouched(spec))
    roots = np.hypot(*skin_places_m(spec, places).T)
    assert_allclose(np.unique(np.round(roots / spec.pins.pitch_m, 6))[:4], [0, 1, np.sqrt(3), 2], atol=1e-4)


def test_a_camera_that_is_not_this_one_and_pins_without_names_are_refused(found) -> None:
    spec = tactip(127)
    with refused("lens-differs", InputError):
        skin_places_m(spec, np.array([[5000.0, 0.0]]))
    with refused("no-lattice", InputError):
        untouched_area_m2(spec, found.xy_px, None)
    with refused("pin-count", InputError):
        untouched_area_m2(tactip(331), found.xy_px, found.cells)
