"""The virtual TacTip: lattice, lever, refraction."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import Pose
from palpate.core.errors import InputError, RangeError
from palpate.sensors.tactip import PINS_127, PINS_331, PinLayout, tactip
from palpate.sensors.tactip.tactip_camera import slopes
from palpate.sensors.tactip.tactip_press import LeaningSkin, head_on, lattice, markers
from palpate.sensors.tactip.tactip_sensor import TacTip

S1, S3 = 0.2419e6, 0.035e6


@pytest.fixture(scope="module")
def spec():
    return tactip()


@pytest.mark.parametrize(("pins", "count"), [(PINS_127, 127), (PINS_331, 331)])
def test_a_hexagon_of_pins_has_as_many_as_its_name_says(pins, count) -> None:
    polar, azimuth = lattice(pins, 0.019)
    assert len(polar) == len(azimuth) == pins.count == count
    assert polar[0] == 0
    x, y = 0.019 * np.sin(polar) * np.cos(azimuth), 0.019 * np.sin(polar) * np.sin(azimuth)
    gaps = np.hypot(x[:, None] - x, y[:, None] - y) + np.eye(count)
    assert_allclose(gaps.min(axis=1), pins.pitch_m, rtol=1e-6)


def test_an_untouched_dome_has_its_markers_on_a_smaller_dome(spec) -> None:
    skin = head_on(spec.table.press(S1), 0.02, 0.0, (0.0, 0.0))
    at = markers(skin, spec.pins, 0.019)
    assert_allclose(
        np.hypot(np.hypot(at[:, 0], at[:, 1]), at[:, 2] - 0.02), 0.019 - spec.pins.length_m, rtol=1e-5
    )


def test_a_lever_shows_tilt_larger_than_displacement(spec) -> None:
    skin = head_on(spec.table.press(S1), 0.02, 4.0, (0.0, 0.0))
    rest = head_on(spec.table.press(S1), 0.02, 0.0, (0.0, 0.0))

    def outward(length_m: float) -> float:
        pins = replace(spec.pins, length_m=length_m)
        away = markers(skin, pins, 0.019)[:, :2] - markers(rest, pins, 0.019)[:, :2]
        return float(np.hypot(*away.T).max())

    assert outward(2.5e-3) > 1.5 * outward(0.0)


def test_a_lean_turns_the_field_towards_it(spec) -> None:
    skin = head_on(spec.table.press(S1), 0.02, 3.0, (0.05, 0.0))
    assert isinstance(skin, LeaningSkin)
    polar, azimuth = np.array([0.3, 0.3]), np.array([0.0, math.pi])
    places, normals = skin.at(polar, azimuth)
    assert places[0, 2] > places[1, 2]  # more pushed in on the side of the lean
    assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_refraction_obeys_snell_and_vanishes_without_gel() -> None:
    r, depth, air, n = np.array([0.0, 0.005, 0.015]), 0.015, 0.04, 1.41
    t = slopes(r, np.full(3, depth), air, n)
    g = np.arcsin(np.sin(np.arctan(t)) / n)
    assert_allclose(depth * np.tan(g) + air * t, r, atol=1e-12)
    assert_allclose(slopes(r, np.full(3, depth), air, 1.0), r / (depth + air))


def test_what_cannot_be_built_is_refused(spec) -> None:
    with refused("pin-count", InputError):
        tactip(200)
    with refused("pin-radius", RangeError):
        replace(spec, pins=PinLayout(9, 2.6e-3, 1e-3, 0.5e-3))
    with refused("camera-position", RangeError):
        replace(spec, camera=replace(spec.camera, height_m=0.015))
    with refused("speed-range", RangeError):
        replace(spec, speed_m_s=0.0)


@pytest.mark.parametrize("words", ["rigid", "S1=7.6"])
def test_a_press_ends_at_the_deepest_approach_as_it_is_printed(spec, words) -> None:
    tip = TacTip(spec)
    probe, specimen = tip.probe(words), tip.specimen(words)
    deepest_m = tip.known_depth_m(probe, specimen)
    force_n = tip.press(probe, Pose(0.0, 0.0, deepest_m), specimen).force_n
    with pytest.raises(RangeError) as refused:
        tip.press(probe, Pose(0.0, 0.0, deepest_m * (1 + 2e-6)), specimen)
    asked, known = re.findall(r"[\d.]+(?= mm)", str(refused.value))
    assert float(asked) > float(known)
    at_known = tip.press(probe, Pose(0.0, 0.0, 1e-3 * float(known)), specimen)
    assert_allclose(at_known.force_n, force_n, rtol=1e-5)
    rounded = tip.press(probe, Pose(0.0, 0.0, deepest_m * (1 + 5e-7)), specimen)
    assert rounded.force_n == force_n
    assert len(tip.markers_px(rounded)) == len(tip.markers_px(at_known))
