"""Red and blue exchanged are seen where there is colour, and never said of frames in the right order."""

from functools import cache

import numpy as np
import pytest

from palpate.estimators.guard import EXCHANGED, NoveltyDetector, fit_novelty_detector, thumbnails
from palpate.estimators.guard.novelty import channels_exchanged

ROWS, COLUMNS = np.mgrid[0:64, 0:64]
ANYWHERE = slice(12, 52)


def lamps(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    """Red light from the left and blue from the right on a gel: a touch has a red side and a blue one."""
    slope = (COLUMNS - at[1]) * np.exp(-((ROWS - at[0]) ** 2 + (COLUMNS - at[1]) ** 2) / 60)
    red, blue = 90 - 0.8 * COLUMNS - 8 * slope, 40 + 0.8 * COLUMNS + 8 * slope
    return np.stack([red, np.full((64, 64), 70.0), blue], axis=-1) + rng.normal(0, 2, (64, 64, 3))


def even_lamps(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    """The same with blue as bright as red over the whole picture, so that their means tell nothing."""
    image = lamps(rng, at)
    image[..., 2] -= 0.4
    image[..., 1] += 0.4 * COLUMNS + 0.2 * ROWS  # a third lamp, which a mirror would move
    return image


def dim_lamps(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    """Little light under the same noise: a mirrored picture is that of exchanged channels, but for noise."""
    return 0.2 * lamps(rng, at) + rng.normal(0, 1.9, (64, 64, 3))


def fringes(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    """Grey where nothing touches, as between polarisers; a touch is bright, in colours that follow on."""
    order = 1.3 * np.exp(-((ROWS - at[0]) ** 2 + (COLUMNS - at[1]) ** 2) / 300)
    light = [38 + 120 * np.sin(np.pi * order * 550 / nm) ** 2 for nm in (630, 540, 460)]
    return np.stack(light, axis=-1) + rng.normal(0, 2, (64, 64, 3))


def grey(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    """A camera that is grey, whose three channels differ by noise."""
    disc = 90 * np.exp(-((ROWS - at[0]) ** 2 + (COLUMNS - at[1]) ** 2) / 60)
    return (60 + disc)[..., None] + rng.normal(0, 2, (64, 64, 3))


def frames(scene, seed: int, n: int, where: slice = ANYWHERE) -> np.ndarray:
    rng = np.random.default_rng(seed)
    made = [scene(rng, rng.uniform(where.start, where.stop, 2)) for _ in range(n)]
    return np.clip(made, 0, 255).astype(np.uint8)


@cache
def guard_of(scene, n: int = 120, where: tuple[int, int] = (12, 52)) -> NoveltyDetector:
    thumbs = thumbnails(frames(scene, 0, n, slice(*where)))
    return fit_novelty_detector(thumbs, np.array_split(np.arange(n), 5), thumbs[:0])


def share(guard: NoveltyDetector, images: np.ndarray) -> float:
    """Of frames that are said to be exchanged; those are refused."""
    verdicts = [guard.judge(np.ascontiguousarray(image)) for image in images]
    said = [one.kind == EXCHANGED for one in verdicts]
    assert all(one.atypicality > 1 for one, exchanged in zip(verdicts, said, strict=True) if exchanged)
    return float(np.mean(said))


@pytest.mark.parametrize(("scene", "seen"), [(lamps, 0.95), (fringes, 0.95), (even_lamps, 0.85)])
def test_exchanged_channels_are_seen_and_right_ones_are_not(scene, seen: float) -> None:
    guard = guard_of(scene)
    right = frames(scene, 1, 60)
    assert share(guard, right[..., ::-1]) > seen
    assert share(guard, right) == 0


@pytest.mark.parametrize("scene", [lamps, fringes])
def test_light_of_another_colour_is_no_exchange(scene) -> None:
    guard, right = guard_of(scene), frames(scene, 2, 20)
    for tint in np.array([(0.85, 1.0, 1.15), (1.4, 1.0, 0.6), (0.6, 1.0, 1.4)]):
        assert share(guard, np.clip(right * tint, 0, 255).astype(np.uint8)) == 0
        assert share(guard, np.clip(right + 60 * (tint - 1), 0, 255).astype(np.uint8)) == 0


def test_touches_where_none_was_calibrated_are_no_exchange() -> None:
    assert share(guard_of(lamps, where=(12, 28)), frames(lamps, 3, 40, slice(32, 52))) == 0
    for n in (8, 20):
        few, right = guard_of(lamps, n=n), frames(lamps, 3, 40)
        assert share(few, right) == 0
        assert share(few, right[..., ::-1]) > 0.1


def test_a_mirrored_picture_and_green_exchanged_are_other_faults() -> None:
    for scene in (lamps, fringes):
        assert share(guard_of(scene), frames(scene, 4, 20)[:, :, ::-1]) == 0
    assert share(guard_of(lamps), frames(lamps, 1, 20)[..., [1, 0, 2]]) == 0


def test_what_may_be_mirrored_or_exchanged_is_refused_and_given_neither_name(monkeypatch) -> None:
    guard, right = guard_of(dim_lamps), frames(dim_lamps, 4, 40)
    mirrored = np.concatenate([right[:, :, ::-1], right[:, ::-1, ::-1]])
    beyond = [guard.judge(np.ascontiguousarray(image)).atypicality > 1 for image in mirrored]
    assert share(guard, right) == 0
    assert share(guard, mirrored) < 0.1
    monkeypatch.setattr(NoveltyDetector, "_may_be_mirrored", lambda *_: False)
    assert share(guard, mirrored) > 0.3, "without asking, these would be called exchanged"
    assert [guard.judge(np.ascontiguousarray(image)).atypicality > 1 for image in mirrored] == beyond


def test_a_grey_sensor_and_one_channel_are_not_judged() -> None:
    guard = guard_of(grey)
    assert share(guard, frames(grey, 1, 20)[..., ::-1]) == share(guard, frames(grey, 1, 20)) == 0
    one = frames(grey, 1, 1)[0, ..., :1].astype(np.float32)
    assert not channels_exchanged(one, one)
