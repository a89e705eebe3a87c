"""Flipped pictures are called so where the untouched sensor tells it, and nothing else is ever called so."""

from functools import cache

import cv2
import numpy as np
import pytest

from palpate.estimators.guard import MIRRORED, NoveltyDetector, fit_novelty_detector, thumbnails
from palpate.estimators.guard.known_changes import FLIPPED, FLIPS, flipped, told_flip

ROWS, COLUMNS = np.mgrid[0:48, 0:64]
EVERYWHERE, LEFT, RIGHT = (8, 56), (8, 24), (40, 56)
N = 120


def frames(tilt, seed: int, n: int, where: tuple[int, int] = EVERYWHERE, touched: bool = True):
    """A disc on a skin whose light falls off by a tilt to the right and down, evenly at (0, 0)."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(n):
        across, down = rng.uniform(*where), rng.uniform(8, 40)
        disc = 80 * touched * np.exp(-((ROWS - down) ** 2 + (COLUMNS - across) ** 2) / 50)
        light = 100 + tilt[0] * (COLUMNS - 31.5) + tilt[1] * (ROWS - 23.5)
        made.append((light + disc)[..., None] + rng.normal(0, 2, (48, 64, 1)))
    return np.clip(made, 0, 255).astype(np.uint8)


@cache
def guard_of(
    tilt: tuple[float, float], where: tuple[int, int] = EVERYWHERE, untouched: int = 6
) -> NoveltyDetector:
    folds = np.array_split(np.arange(N), 5)
    rest = frames(tilt, 9, 6, touched=False)[:untouched]
    seen = thumbnails(frames(tilt, 0, N, where))
    return fit_novelty_detector(seen, folds, thumbnails(rest) if untouched else seen[:0])


def kinds(guard: NoveltyDetector, images: np.ndarray) -> list[str]:
    """Kinds of the flipped, "" for others; whoever is called flipped is refused."""
    verdicts = [guard.judge(np.ascontiguousarray(image)) for image in images]
    assert all(one.atypicality > 1 for one in verdicts if one.kind in MIRRORED)
    return [one.kind if one.kind in MIRRORED else "" for one in verdicts]


@pytest.mark.parametrize("kind", FLIPS)
def test_a_flipped_picture_is_called_by_its_flip_and_what_takes_it_back_does(kind: str) -> None:
    guard, right = guard_of((1.2, 0.9)), frames((1.2, 0.9), 1, 30)
    code = FLIPS[kind]
    wrong = np.stack([cv2.flip(one, code)[..., None] for one in right])
    told = kinds(guard, wrong)
    assert told.count(kind) >= 28
    assert set(told) <= {kind, FLIPPED, ""}
    assert set(kinds(guard, right)) == {""}
    back = np.stack([cv2.flip(one, code)[..., None] for one in wrong])
    assert (back == right).all()
    assert np.array_equal(flipped(right[0].astype(np.float32), code), wrong[0])


def test_other_changes_are_called_no_flip() -> None:
    guard, right = guard_of((1.2, 0.9)), frames((1.2, 0.9), 2, 15)
    for change in (
        lambda image: np.roll(image, 6, axis=1),
        lambda image: cv2.GaussianBlur(image, (0, 0), 6)[..., None],
        lambda image: np.clip(image * 0.6, 0, 255).astype(np.uint8),
        lambda image: 255 - image,
    ):
        assert set(kinds(guard, np.stack([change(one) for one in right]))) == {""}


def test_touches_that_were_calibrated_on_one_side_alone_are_no_flip_on_the_other() -> None:
    for tilt in ((0.0, 0.0), (1.2, 0.9)):
        assert set(kinds(guard_of(tilt, LEFT), frames(tilt, 3, 20, RIGHT))) == {""}


def test_without_an_untouched_sensor_or_with_one_that_is_its_own_mirror_image_none_is_told() -> None:
    for guard, tilt in ((guard_of((1.2, 0.9), untouched=0), (1.2, 0.9)), (guard_of((0.0, 0.9)), (0.0, 0.9))):
        assert set(kinds(guard, frames(tilt, 4, 30)[:, :, ::-1])) == {""}


def test_which_flip_it_is_is_told_only_where_one_fits_much_better() -> None:
    assert told_flip({"mirrored-x": 0.4, "rotated-180": 0.81}) == "mirrored-x"
    assert told_flip({"mirrored-x": 0.4, "rotated-180": 0.79}) == FLIPPED
    assert told_flip({"mirrored-x": 0.9, "rotated-180": 1.1}) == "mirrored-x"
    assert told_flip({"mirrored-x": 1.1}) == told_flip({}) == ""
