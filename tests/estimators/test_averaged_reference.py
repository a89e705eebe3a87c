"""Marks followed from an average of untouched frames, as live ones are: it has less noise than a frame."""

import numpy as np
import pytest

import palpate
from palpate.core import Frame, Pose
from palpate.core.sensor import for_live
from palpate.estimators.shear import ShearReader, ShearTouch
from palpate.sensing.streaming.live_readers import mean_image

SENSOR = for_live(palpate.sensor("nusense"))
SKIN = SENSOR.shear_skin()
ROUND = SENSOR.probe("round")
AVERAGED = 15


def _frame(x_mm: float, y_mm: float, depth_mm: float, rng: np.random.Generator) -> Frame:
    return SENSOR.render(SENSOR.press(ROUND, Pose(1e-3 * x_mm, 1e-3 * y_mm, 1e-3 * depth_mm)), rng)


@pytest.fixture(scope="module")
def readers() -> list[ShearReader]:
    rng = np.random.default_rng(4)
    rest = [_frame(0, 0, 0, rng) for _ in range(AVERAGED)]
    return [ShearReader(SKIN, one) for one in (rest[0], Frame(mean_image([one.image for one in rest])))]


def _presses(reader: ShearReader, count: int) -> list[tuple[ShearTouch, float, float]]:
    rng = np.random.default_rng(8)
    found = []
    for _ in range(count):
        x, y, depth = rng.uniform(-13, 13), rng.uniform(-9, 9), rng.uniform(0.4, 1.6)
        found.append((reader.touch(_frame(x, y, depth, rng)), x, y))
    return found


def test_a_frames_errors_are_its_own_whatever_the_references(readers: list[ShearReader]) -> None:
    frame = _frame(2, 1, 1, np.random.default_rng(3))
    errors = [np.median(reader.touch(frame).points.sigma) for reader in readers]
    assert errors[1] == pytest.approx(errors[0], rel=0.15)
    own = [np.median(reader.marks.reference.sigma) for reader in readers]
    # by the square root of 15, but for rounding the average to whole levels
    assert own[1] / own[0] == pytest.approx(1 / np.sqrt(AVERAGED), rel=0.5)
    assert own[1] < 0.5 * errors[1]


def test_a_press_is_told_by_its_pressure_beside_an_averaged_reference(readers: list[ShearReader]) -> None:
    found = _presses(readers[1], 4)
    tractions = [touch.places.traction for touch, _, _ in found]
    assert all(one is not None and one.misfit < 1.4 and one.closure == "frictionless" for one in tractions)
    assert all(touch.places.contacts[0].told_by == "pressure" for touch, _, _ in found)
    off_mm = [
        1e3 * touch.readings[name].value - true
        for touch, *at in found
        for name, true in zip("xy", at, strict=True)
    ]
    assert np.sqrt(np.mean(np.square(off_mm))) < 0.04


def test_nothing_is_seen_of_an_untouched_skin_beside_an_averaged_reference(
    readers: list[ShearReader],
) -> None:
    rng = np.random.default_rng(6)
    for _ in range(4):
        touch = readers[1].touch(_frame(0, 0, 0, rng))
        assert not touch.places.contacts
        assert touch.places.unsure == 0
        assert touch.readings["damage"].value == "no"
