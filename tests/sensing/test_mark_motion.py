"""Marks in a skin: their motion is what they were moved by, and skins without any have none."""

import json

import cv2
import numpy as np
import pytest

from palpate.core import ImageError
from palpate.estimators.lattice.dotted_skin import DottedSkin
from palpate.sensing.uncalibrated import MarkMotion, PinFollower, follow_marks
from palpate.sensing.untouched_view import SeenTouch, UntouchedView, overlay_of

PITCH, RADIUS = 24.0, 5.0
SHAPE = 240, 320
SITES = [(c, r) for c in range(-4, 5) for r in range(-4, 5) if abs(c + r) <= 4]
PLACES = np.array([(160 + PITCH * (c + r / 2), 120 + PITCH * r * np.sqrt(0.75)) for c, r in SITES])


def skin(places: np.ndarray, dark: bool, seed: int) -> np.ndarray:
    """A grey skin with dots at places, drawn four times finer, with noise."""
    fine = np.full((4 * SHAPE[0], 4 * SHAPE[1]), 60.0, np.float32)
    for x, y in places:
        cv2.circle(fine, (round(4 * x + 1.5), round(4 * y + 1.5)), round(4 * RADIUS), 190.0, -1)
    image = cv2.resize(fine, SHAPE[::-1], interpolation=cv2.INTER_AREA)
    noisy = image + np.random.default_rng(seed).normal(0, 1.5, SHAPE)
    bright = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return (255 - bright).astype(np.uint8) if dark else bright


def bulge(places: np.ndarray, middle: tuple[float, float], px: float) -> np.ndarray:
    """Displacement away from a middle, greatest at 50 px."""
    away = places - np.array(middle)
    far = np.hypot(*away.T)[:, None]
    return px * away / 50 * np.exp(0.5 - 0.5 * (far / 50) ** 2)


@pytest.mark.parametrize("dark", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_marks_move_by_what_they_were_moved_by(dark: bool) -> None:
    follower = follow_marks(skin(PLACES, dark, 0), "any")
    assert isinstance(follower, PinFollower)
    assert follower.kind == ("dark" if dark else "bright")
    assert follower.pitch_px == pytest.approx(PITCH, rel=0.01)
    for step in (0.5, 1.0):
        truth = step * bulge(PLACES, (160.0, 120.0), 6.0)
        moved = follower.moved(skin(PLACES + truth, dark, 1))
        which = np.hypot(*(moved.at_px[:, None] - PLACES[None]).transpose(2, 0, 1)).argmin(axis=1)
        assert moved.lost == 0
        assert np.abs(moved.moved_px - truth[which]).max() < 0.3  # circles are drawn to a quarter of a pixel
        assert moved.largest_px == pytest.approx(np.hypot(*truth.T).max(), abs=0.3)


def test_marks_keep_their_names_over_jumps_of_less_than_half_their_distance_and_after_being_covered() -> None:
    follower = PinFollower(skin(PLACES, False, 0))
    for shift in ([9.0, 0.0], [0.0, 0.0], [0.0, -9.0], [0.0, 0.0]):
        assert follower.moved(np.full(SHAPE, 60, np.uint8)).lost == len(PLACES)
        moved = follower.moved(skin(PLACES + shift, False, 2))
        assert np.median(moved.moved_px, axis=0) == pytest.approx(shift, abs=0.2)


def test_a_skin_without_marks_has_none_and_noise_has_none() -> None:
    rng = np.random.default_rng(3)
    even = np.rint(rng.normal(100, 3, SHAPE)).astype(np.uint8)
    assert follow_marks(even, "any") is None
    with pytest.raises(ImageError):
        follow_marks(even, "bright")


def test_a_described_skin_s_dots_are_found_in_each_frame() -> None:
    follower = follow_marks(skin(PLACES, True, 0), DottedSkin("hexagonal", PITCH, RADIUS, "dark"))
    assert follower is not None
    truth = bulge(PLACES, (160.0, 120.0), 5.0)
    moved = follower.moved(skin(PLACES + truth, True, 1))
    assert moved.lost == 0
    assert moved.largest_px == pytest.approx(np.hypot(*truth.T).max(), abs=0.3)
    covered = follower.moved(np.full(SHAPE, 90, np.uint8))
    assert (len(covered.at_px), covered.lost) == (0, len(PLACES))


def turned(places: np.ndarray, degrees: float, shift: tuple[float, float]) -> np.ndarray:
    """Places turned about the frame's middle, and shifted."""
    angle = np.deg2rad(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return (places - [160, 120]) @ turn.T + [160, 120] + np.array(shift)


def test_what_marks_have_in_common_is_a_shift_and_a_turn_and_nothing_more() -> None:
    def motion(now: np.ndarray) -> MarkMotion:
        return MarkMotion(PLACES, now - PLACES, 0)

    shift, apart = motion(turned(PLACES, 3.0, (2.0, -1.0))).apart()
    assert shift == pytest.approx(turned(PLACES, 3.0, (2.0, -1.0)).mean(axis=0) - PLACES.mean(axis=0))
    assert np.abs(apart).max() < 1e-9
    spread = 0.05 * (PLACES - PLACES.mean(axis=0))
    assert motion(PLACES + spread).apart()[1] == pytest.approx(spread, abs=1e-9)


def test_pins_that_move_together_are_no_touch_and_pins_that_move_apart_are_one() -> None:
    by_picture = UntouchedView([skin(PLACES, False, i) for i in range(8)])
    view = UntouchedView([skin(PLACES, False, i) for i in range(8)], marks="bright", by_marks=True)
    together = PLACES + np.array([2.0, -1.0])
    assert by_picture.seen(skin(together, False, 40)).verdict == "touched"
    seen = view.seen(skin(together, False, 40))
    assert (seen.verdict, "2.0, -1.0" in seen.why) == ("untouched", True)
    seen = view.seen(skin(together + bulge(PLACES, (172.0, 120.0), 3.0), False, 41))
    assert seen.verdict == "touched"
    assert seen.region is not None
    assert np.hypot(*(np.array(seen.region.centre_px) - [172, 120])) < PITCH / 2
    assert seen.region.area_px < 0.6 * SHAPE[0] * SHAPE[1]  # and not all that the shift has changed


def press(seed: int) -> tuple[UntouchedView, SeenTouch]:
    view = UntouchedView([skin(PLACES, False, i) for i in range(8)], marks="any")
    return view, view.seen(skin(PLACES + bulge(PLACES, (172.0, 120.0), 4.0), False, seed))


def test_the_overlay_has_the_outline_the_centre_and_an_arrow_for_each_mark_that_moved() -> None:
    view, seen = press(22)
    shapes = overlay_of(seen, view.region, arrow_times=3.0)
    assert seen.marks is not None
    assert seen.region is not None
    assert [line["role"] for line in shapes["lines"]] == ["skin", "region"]
    assert len(shapes["arrows"]) + sum(dot["role"] == "mark" for dot in shapes["dots"]) == len(
        seen.marks.at_px
    )
    longest = max(np.hypot(*np.subtract(arrow["end"], arrow["start"])) for arrow in shapes["arrows"])
    assert longest == pytest.approx(3 * seen.marks.largest_px, abs=0.15)  # places are to 0.1 px
    (centre,) = (dot["at"] for dot in shapes["dots"] if dot["role"] == "centre")
    assert centre == pytest.approx(seen.region.centre_px, abs=0.051)
    assert len(shapes["lines"][1]["points"]) <= 120
    assert json.loads(json.dumps(shapes)) == shapes
