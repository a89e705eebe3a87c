"""NUSense: contact and motion of its tiles against closed forms, and its frames against the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

import palpate
from palpate.check import check_sensor
from palpate.core import (
    FRESH,
    Contact,
    ImageError,
    InputError,
    Pose,
    PressHistory,
    RangeError,
    Seating,
    Specimen,
)
from palpate.mechanics.axisymmetric.shape_table import SphereTable
from palpate.mechanics.layers.stack import ElasticLayer, Stack
from palpate.sensors.nusense.nusense_sensor import NuSense
from palpate.sensors.nusense.nusense_spec import NuSenseSpec, PadLight, fabricated
from palpate.sensors.nusense.pad_contact import pad_contact, parse_indenter, relaxed_press
from palpate.sensors.nusense.pad_view import pad_window, rest_places
from palpate.sensors.nusense.pattern_motion import pattern_motion

Kernel = Callable[[np.ndarray, np.ndarray], np.ndarray]

MM = 1e-3
SENSOR = palpate.sensor("nusense")
ROUND = parse_indenter("round")
E_PA, NU, DEPTH_M = 0.3e6, 0.499, 1.5e-3
SHEAR_PA = E_PA / 2 / (1 + NU)
THICK = Stack((ElasticLayer(DEPTH_M, E_PA, NU), ElasticLayer(math.inf, E_PA, NU)), "half-space")


def _touch(words: str = "round", depth_mm: float = 1.5, x_mm: float = 0.0, y_mm: float = 0.0) -> Contact:
    return SENSOR.press(SENSOR.probe(words), Pose(x_mm * MM, y_mm * MM, depth_mm * MM))


def _cell_m2(contact: Contact) -> float:
    return float(contact.x_m[1] - contact.x_m[0]) ** 2


@pytest.mark.slow
def test_nusense_keeps_every_law_of_a_sensor() -> None:
    assert not [(one.code, one.message) for one in check_sensor(SENSOR) if not one.ok]


def test_a_thick_pad_is_pressed_as_hertz_says() -> None:
    for depth_m in (0.02e-3, 0.1e-3, 0.3e-3):
        solved = relaxed_press(THICK, ROUND, depth_m).solved
        force_n = 4 / 3 * E_PA / (1 - NU**2) * math.sqrt(5e-3) * depth_m**1.5
        assert solved.force_n == pytest.approx(force_n, rel=0.02)
        assert math.sqrt(solved.area_m2 / math.pi) == pytest.approx(math.sqrt(5e-3 * depth_m), rel=0.02)


def _summed(contact: Contact, load: np.ndarray, kernel: Kernel, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Displacement at (x, y) by the loads of all cells, each as a force in its middle."""
    rows, columns = np.nonzero(load)
    force = load[rows, columns] * _cell_m2(contact)
    return kernel(x[:, None] - contact.x_m[columns], y[:, None] - contact.y_m[rows]) @ force


def _boussinesq(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Displacement along x at the tiles under 1 N along z."""
    rho = np.sqrt(x**2 + y**2 + DEPTH_M**2)
    return (x * DEPTH_M / rho**3 - (1 - 2 * NU) * x / (rho * (rho + DEPTH_M))) / (4 * np.pi * SHEAR_PA)


def _cerruti(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Displacement along x at the tiles under 1 N along x."""
    rho, m, z = np.sqrt(x**2 + y**2 + DEPTH_M**2), 1 - 2 * NU, DEPTH_M
    whole = 1 / rho + x**2 / rho**3 + m * (1 / (rho + z) - x**2 / (rho * (rho + z) ** 2))
    return whole / (4 * np.pi * SHEAR_PA)


def test_tiles_in_a_thick_pad_move_sideways_as_boussinesq_says() -> None:
    r = np.array([0.5, 1.0, 2.0, 4.0, 8.0]) * MM
    for depth_m in (0.02e-3, 0.4e-3):
        contact = pad_contact(THICK, 0.5, ROUND, Pose(0.0, 0.0, depth_m), FRESH)
        motion = pattern_motion(THICK, 1, contact)
        expected = _summed(contact, contact.pressure_pa, _boussinesq, r, 0 * r)
        np.testing.assert_allclose(motion.at(r, 0 * r)[0], expected, rtol=0.01)
        np.testing.assert_allclose(motion.at(0 * r, -r)[1], -expected, rtol=0.01)


def test_tiles_in_a_thick_pad_are_pulled_along_as_cerruti_says() -> None:
    pulled = PressHistory(path_m=((5e-6, 0.0),))
    contact = pad_contact(THICK, 0.5, ROUND, Pose(0.0, 0.0, 0.2e-3), pulled)
    still = pad_contact(THICK, 0.5, ROUND, Pose(0.0, 0.0, 0.2e-3), FRESH)
    moved, unmoved = (pattern_motion(THICK, 1, one) for one in (contact, still))
    x = np.array([0.5, 1.0, 2.0, 4.0]) * MM
    places = np.concatenate([x, 0 * x]), np.concatenate([0 * x, x])
    own = moved.at(*places)[0] - unmoved.at(*places)[0]
    expected = _summed(contact, contact.shear_pa[0], _cerruti, *places)
    # Differences from the first: the images of a half-space move all places alike.
    np.testing.assert_allclose(
        own[0] - own[1:], expected[0] - expected[1:], rtol=0.02, atol=0.003 * np.ptp(expected)
    )


def test_a_shifted_ball_on_a_thick_pad_bears_what_mindlin_says() -> None:
    depth_m, shift_m = 0.3e-3, 10e-6
    contact = pad_contact(THICK, 0.5, ROUND, Pose(0.0, 0.0, depth_m), PressHistory(path_m=((shift_m, 0.0),)))
    stiffness = 8 * contact.radius_m * SHEAR_PA / (2 - NU)
    most = 0.5 * contact.force_n
    mindlin = most * (1 - (1 - 2 * stiffness * shift_m / (3 * most)) ** 1.5)
    assert contact.lateral_n[0] == pytest.approx(mindlin, rel=0.03)


@pytest.mark.parametrize("words", ["round", "edge:20:35"])
def test_pressure_and_shear_hold_what_the_probe_bears(words: str) -> None:
    probe = parse_indenter(words)
    contact = SENSOR.press(
        probe, Pose(2e-3, -1e-3, 0.4e-3), None, PressHistory(lateral_n=(0.3, 0.1), stiffening=1.2)
    )
    cell = _cell_m2(contact)
    assert contact.pressure_pa.sum() * cell == pytest.approx(contact.force_n, rel=1e-6)
    np.testing.assert_allclose(contact.shear_pa.sum(axis=(1, 2)) * cell, (0.3, 0.1), atol=1e-4)
    limit = SENSOR.spec.friction * contact.pressure_pa
    assert (np.hypot(*contact.shear_pa) <= limit * (1 + 1e-6) + 1e-6).all()


def test_a_probe_pulled_beyond_friction_slides_with_friction_times_pressure() -> None:
    contact = SENSOR.press(ROUND, Pose(0.0, 0.0, 1e-3), None, PressHistory(lateral_n=(0.0, 99.0)))
    np.testing.assert_allclose(contact.shear_pa[1], SENSOR.spec.friction * contact.pressure_pa)
    assert contact.lateral_n == pytest.approx((0.0, SENSOR.spec.friction * contact.force_n))


def test_a_pad_that_remembers_bears_more_and_looks_the_same() -> None:
    relaxed = SENSOR.press(ROUND, Pose(0.0, 0.0, 1e-3))
    stiff = SENSOR.press(ROUND, Pose(0.0, 0.0, 1e-3), None, PressHistory(stiffening=1.18))
    assert stiff.force_n == pytest.approx(1.18 * relaxed.force_n)
    np.testing.assert_allclose(SENSOR.motion(stiff).moved_m, SENSOR.motion(relaxed).moved_m, atol=1e-12)


def test_the_linear_law_misses_finite_strain_by_what_the_explanation_says() -> None:
    table = SphereTable.load("sphere-h2-mu0")
    stack = Stack((ElasticLayer(table.thickness * 5e-3, 1e6, table.poisson_ratio),))
    for depth in (0.1, 0.2, 0.34):
        force_n = relaxed_press(stack, ROUND, depth * 5e-3).solved.force_n
        over = force_n / (table.at(depth).force * 1e6 * 25e-6)
        assert 1.005 < over < 1.05


def test_pixels_show_the_tiles_that_the_corners_say() -> None:
    spec = replace(SENSOR.spec, light=PadLight(blur_px=0.0))
    contact = _touch(depth_mm=2.0, x_mm=8.0, y_mm=5.0)
    for shift in ((0.0, 0.0), (0.4, -1.3)):
        truth = SENSOR.tile_corners(contact, Seating(1.0, shift))
        window = pad_window(spec, shift)
        rest = rest_places(spec, SENSOR.motion(contact), shift)
        across, down = truth.places_px.T - np.array([[window.left], [window.top]])
        i, j = np.floor(across).astype(int), np.floor(down).astype(int)
        s, t = across - i, down - j
        shown = (
            rest[:, j, i] * (1 - s) * (1 - t)
            + rest[:, j, i + 1] * s * (1 - t)
            + rest[:, j + 1, i] * (1 - s) * t
            + rest[:, j + 1, i + 1] * s * t
        )
        off_m = np.abs(shown.T - truth.rest_m).max()
        assert off_m < 0.02 * SENSOR.spec.camera_m / SENSOR.spec.lens.focal_px[0]


def test_x_runs_to_the_right_of_the_image_and_y_upwards() -> None:
    truth = SENSOR.tile_corners(_touch(depth_mm=0.0))
    x, y = truth.rest_m.T
    column, row = truth.places_px.T
    assert np.corrcoef(x, column)[0, 1] > 0.99
    assert np.corrcoef(y, row)[0, 1] < -0.99
    assert len(truth.cells) == 20 * 15
    assert len({tuple(cell) for cell in truth.cells.tolist()}) == 300


def test_copies_differ_and_the_same_number_is_the_same_pad() -> None:
    assert palpate.sensor("nusense-7").spec == fabricated(7)
    moduli = [fabricated(copy).layers.gel_pa for copy in range(200)]
    assert np.std(moduli) / np.mean(moduli) == pytest.approx(0.1, abs=0.02)
    assert len({fabricated(copy).pattern.offset_m for copy in range(50)}) == 50
    soft = palpate.sensor("nusense-soft").press(ROUND, Pose(0.0, 0.0, 1e-3))
    assert soft.force_n < 0.9 * SENSOR.press(ROUND, Pose(0.0, 0.0, 1e-3)).force_n


@pytest.mark.parametrize("words", ["sphere", "edge:0", "punch:99", "cube:3"])
def test_words_that_are_no_indenter_are_refused(words: str) -> None:
    with refused("unknown-name", InputError, match="NUSense"):
        SENSOR.probe(words)


def test_what_is_not_modelled_is_refused() -> None:
    with refused("outside-pad", RangeError):
        _touch(x_mm=26)
    with refused("outside-table", RangeError):
        _touch(depth_mm=2.5)
    with pytest.raises(RangeError):
        _touch(depth_mm=math.nan)
    with pytest.raises(RangeError, match="yields"):
        SENSOR.press(ROUND, Pose(0.0, 0.0, 1e-3), Specimen("S", 1e3))
    with pytest.raises(RangeError, match="stiffening"):
        SENSOR.press(ROUND, Pose(0.0, 0.0, 1e-3), None, PressHistory(stiffening=0.0))
    with pytest.raises(InputError, match="leans"):
        SENSOR.press(replace(ROUND, tilt_rad=0.1), Pose(0.0, 0.0, 1e-3))
    with pytest.raises(InputError, match="no NUSense"):
        palpate.sensor("nusense-huge")
    with pytest.raises(RangeError, match="tiles"):
        NuSenseSpec(pattern=replace(SENSOR.spec.pattern, columns=30))
    frame = SENSOR.render(_touch(), np.random.default_rng(0))
    with pytest.raises(ImageError):
        SENSOR.rectify(replace(frame, image=frame.image[:-8]))
    assert isinstance(SENSOR, NuSense)
