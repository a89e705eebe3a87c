"""Motion of the camera, contacts at the rim, and the lens: no valid reading of touch that is wrong."""

from copy import deepcopy
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

import palpate
from palpate.core import Frame, Pose
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.shear import ShearReader
from palpate.estimators.shear.touch_places import camera_motion
from palpate.estimators.surface_strain import StrainMeter

SENSOR = palpate.sensor("nusense")
SKIN = SENSOR.shear_skin()
TOUCH = ("x", "y", "edge", "contacts", "gamma", "slip", "damage")
LIMIT_PX = 0.017  # noise of one mark's shift, the detection limit without a contact


def frame_of(
    depth: float = 0.0, x: float = 0.0, y: float = 0.0, seed: int = 0, words: str = "round"
) -> Frame:
    contact = SENSOR.press(SENSOR.probe(words), Pose(x, y, depth))
    return SENSOR.render(contact, np.random.default_rng(seed))


def moved(frame: Frame, dx: float = 0.0, dy: float = 0.0, zoom: float = 1.0, turn: float = 0.0) -> Frame:
    """The frame by a camera that has moved [px, rad]."""
    height, width = frame.image.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), np.degrees(turn), zoom)
    matrix[:, 2] += dx, dy
    image = cv2.warpAffine(
        frame.image, matrix, (width, height), flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE
    )
    return replace(frame, image=image)


@cache
def untouched() -> Frame:
    return frame_of()


@cache
def begun() -> ShearReader:
    return ShearReader(SKIN, untouched())


def reader() -> ShearReader:
    return deepcopy(begun())


def is_camera_motion(readings) -> bool:
    """Whether every reading of touch has the code of camera motion, and none is valid."""
    return all(readings[name].code == "camera_moved" and not readings[name].valid for name in TOUCH)


@pytest.mark.parametrize("depth", [0.0, 1.2e-3])
def test_a_shift_a_zoom_and_a_rotation_of_all_marks_are_motion_of_the_camera(depth) -> None:
    own, frame = reader(), frame_of(depth, 4e-3, -3e-3, 2)
    for motion in ({"dy": -0.5}, {"zoom": 0.997}, {"turn": 0.003}, {"dx": 0.2}):
        touch = own.touch(moved(frame, **motion))
        assert is_camera_motion(touch.readings)
        assert touch.code == "camera_moved"
    assert own.read(frame_of(depth, 4e-3, -3e-3, 1))["gamma"].valid


def test_below_the_limit_the_interval_of_gamma_covers_the_motion() -> None:
    own = reader()
    rest = own.read(frame_of(seed=3))["gamma"]
    for share in np.linspace(0.1, 2.0, 4):
        gamma = own.read(moved(frame_of(seed=3), share * LIMIT_PX))["gamma"]
        if gamma.valid:
            assert gamma.low <= rest.value <= gamma.high
        else:
            assert gamma.code == "camera_moved"
            assert share > 0.8  # the limit is not lower than stated


@pytest.mark.slow
def test_no_valid_reading_is_wrong_at_the_limit_and_sound_ones_stay_valid() -> None:
    """Each motion 20 times about the limit: 0 to 0.12 px, over which gamma may err by three half-widths."""
    own, rng, wrong, refused, sound = reader(), np.random.default_rng(7), 0, 0, 0
    for i in range(60):
        x, y = rng.uniform(-18e-3, 18e-3), rng.uniform(-12e-3, 12e-3)
        frame = frame_of(rng.uniform(0.4e-3, 1.6e-3), x, y, 100 + i)
        truth = own.read(frame)
        sound, refused = sound + 1, refused + (not truth["gamma"].valid)
        size = rng.uniform(0.0, 0.12)
        motion = [{"dx": size}, {"zoom": 1 + size / 120}, {"turn": size / 120}][i % 3]
        now = own.read(moved(frame, **motion))
        for name, true in (("gamma", truth["gamma"].value), ("x", x), ("y", y)):
            one = now[name]
            wrong += one.valid and abs(one.value - true) > 1.5 * (one.high - one.low)
    assert wrong == 0
    assert refused <= 0.03 * sound


@pytest.mark.parametrize(
    ("words", "x", "y", "depth"), [("flat", 9.9e-3, -16.8e-3, 0.4e-3), ("round", 22.3e-3, 4.5e-3, 1.6e-3)]
)
def test_a_contact_beyond_the_area_has_no_valid_place_and_is_no_tear(words, x, y, depth) -> None:
    readings = reader().read(frame_of(depth, x, y, 5, words))
    for name in ("x", "y", "gamma", "contacts", "damage"):
        assert not readings[name].valid
        assert readings[name].code == "outside_calibrated_area"
    assert readings["damage"].value == ""


@pytest.mark.parametrize("scale", [1.0, 1.027, 0.978])
def test_a_place_s_interval_holds_the_error_of_a_wrong_focal_length(scale) -> None:
    lens = SKIN.lens
    wrong = replace(lens, focal_px=(lens.focal_px[0] * scale, lens.focal_px[1] * scale))
    own, at = ShearReader(replace(SKIN, lens=wrong), untouched()), (14e-3, -9e-3)
    readings = own.read(frame_of(1.0e-3, *at, 6))
    for name, true in zip("xy", at, strict=True):
        one = readings[name]
        assert one.valid
        assert abs(one.value - true) < 3 * (one.high - one.low) / 2
    if scale == 1.0:  # a lens that fits costs nothing
        assert readings["x"].high - readings["x"].low < 0.1e-3


def test_single_marks_that_jump_are_no_motion_of_the_camera() -> None:
    columns, rows = np.meshgrid(np.arange(20), np.arange(15))
    cells = np.column_stack([columns.ravel(), rows.ravel()])
    rest, sigma = cells * 2e-3, np.full(len(cells), 2e-6)
    meter = StrainMeter(ControlPoints(cells, rest, sigma, "m"))
    jumped = rest + 2e-6 * np.random.default_rng(4).standard_normal(rest.shape)
    jumped[(cells[:, 0] >= 16) & (cells[:, 1] % 3 == 0), 0] += 5e-5
    assert not camera_motion(meter.fields(ControlPoints(cells, jumped, sigma, "m")), 2e-3, 1e4)
    shifted = meter.fields(ControlPoints(cells, jumped + 2e-4, sigma, "m"))
    assert camera_motion(shifted, 2e-3, 1e4).code == "camera_moved"
