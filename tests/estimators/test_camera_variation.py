"""What a camera does from day to day is drawn into training images at the sizes that are stated."""

import numpy as np
import pytest

from palpate.core import InputError
from palpate.estimators.networks import make_model
from palpate.estimators.networks.augmentation import CameraVariation, with_outlines_moved

NOTHING = {
    "shift_px": 0.0, "turn_deg": 0.0, "zoom_percent": 0.0, "blur_px": 0.0, "width_px": 0.0,
    "gain_percent": 0.0, "noise": 0.0, "below_quality_100": 0.0,
}  # fmt: skip
ROWS, COLUMNS = np.mgrid[0:64, 0:80] * 1.0
BLOB = (40 + 150 * np.exp(-((COLUMNS - 52.0) ** 2 + (ROWS - 25.0) ** 2) / 50)).astype(np.float32)


def drawn(n: int = 400, image: np.ndarray = BLOB, **sizes: float) -> np.ndarray:
    """So many draws of one image ``[n h w]``."""
    images = np.repeat(image[None, None], n, axis=0)
    return CameraVariation(**(NOTHING | sizes)).drawn(images, np.random.default_rng(0))[:, 0]


def places(images: np.ndarray) -> np.ndarray:
    """Centroid (x, y) of what is above the ground, of each image."""
    weight = np.maximum(images - 41, 0)
    total = weight.sum(axis=(1, 2))
    return np.stack([(weight * axis).sum(axis=(1, 2)) / total for axis in (COLUMNS, ROWS)], axis=1)


def test_no_size_changes_nothing_and_a_seed_repeats() -> None:
    np.testing.assert_array_equal(drawn(3), np.repeat(BLOB[None], 3, axis=0))
    images = np.repeat(BLOB[None, None], 4, axis=0)
    once, again = (CameraVariation().drawn(images, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(once, again)


def test_shifts_reach_their_size_either_way_and_not_beyond() -> None:
    away = places(drawn(shift_px=3.0)) - places(BLOB[None])
    assert np.abs(away).max() <= 3.1
    assert (away.max(axis=0) > 2.7).all()
    assert (away.min(axis=0) < -2.7).all()
    parts = places(drawn(shift_px=3.0, turn_deg=0.01)) - places(BLOB[None])
    whole = np.abs(parts - np.rint(parts)).max(axis=1) < 0.05
    assert 0.4 < np.mean(whole) < 0.6, "half of the images are moved by parts of a pixel"


def test_turns_and_zooms_are_about_the_middle() -> None:
    middle = np.array([39.5, 31.5])
    arm = places(BLOB[None])[0] - middle
    turned = places(drawn(turn_deg=4.0)) - middle
    angle = np.degrees(np.arctan2(arm[0] * turned[:, 1] - arm[1] * turned[:, 0], turned @ arm))
    assert 3.5 < angle.max() < 4.3
    assert -4.3 < angle.min() < -3.5
    zoomed = np.linalg.norm(places(drawn(zoom_percent=8.0)) - middle, axis=1) / np.linalg.norm(arm)
    assert 1.07 < zoomed.max() < 1.09
    assert 0.91 < zoomed.min() < 0.93


def test_blur_gain_and_noise_have_their_sizes() -> None:
    peaks = drawn(blur_px=3.0).max(axis=(1, 2))
    assert 0.4 < np.mean(peaks < BLOB.max() - 0.5) < 0.6
    # A Gaussian of variance 25 blurred by sigma 3 keeps 25 / 34 of its height.
    assert peaks.min() == pytest.approx(40 + 150 * 25 / 34, abs=2)
    gain = drawn(gain_percent=20.0)[:, 0, 0] / BLOB[0, 0]
    assert 1.18 < gain.max() <= 1.2
    assert 0.8 <= gain.min() < 0.82
    noise = (drawn(noise=4.0) - BLOB).std(axis=(1, 2))
    assert 3.8 < noise.max() < 4.2
    assert 0.4 < np.mean(noise == 0) < 0.6


def test_outlines_move_by_their_size() -> None:
    """The radius of a disc by its light, grown and shrunk by half a pixel along rows and columns."""
    disc = np.clip(10.5 - np.hypot(COLUMNS - 40, ROWS - 32), 0, 1).astype(np.float32)[..., None]
    rng = np.random.default_rng(0)
    for px in (-0.5, 0.5):
        moved = [with_outlines_moved(disc, px, rng).sum() for _ in range(20)]
        radii = np.unique(np.round(np.sqrt(np.array(moved) / np.pi) - np.sqrt(disc.sum() / np.pi), 4))
        # Eight neighbours reach |cos| + |sin| of the direction, 4 / pi on average; four reach the greater of
        # both, 2 sqrt(2) / pi on average.
        reached = np.sort(np.array([2 * np.sqrt(2), 4]) / np.pi * px)
        np.testing.assert_allclose(radii, reached, rtol=0.1)


def test_levels_stay_levels_and_differences_are_not_compressed() -> None:
    dark = drawn(image=np.full_like(BLOB, 3.0), noise=20.0)
    assert dark.min() == 0
    difference = np.where(COLUMNS < 40, -20, 20).astype(np.float32)
    left = drawn(image=difference, below_quality_100=90.0, width_px=0.9)
    np.testing.assert_array_equal(left, np.repeat(difference[None], len(left), axis=0))
    compressed = drawn(40, below_quality_100=90.0)
    assert 0 < np.mean((compressed != BLOB).any(axis=(1, 2))) < 0.6


def test_strength_scales_all_but_the_shift_and_sizes_are_checked() -> None:
    half = CameraVariation().scaled(0.5)
    assert half.shift_px == CameraVariation().shift_px
    assert half.turn_deg == CameraVariation().turn_deg / 2
    with pytest.raises(InputError, match="blur_px"):
        CameraVariation(blur_px=-1)
    with pytest.raises(InputError, match="variation"):
        make_model("compact-cnn", {"variation": 3.0})
