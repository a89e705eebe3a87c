"""The lens's blur and distortion, and JPEG: each against its closed form, and off by default."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.core import RangeError
from palpate.optics.image_chain import ImageChain, as_kept, through_lens


def grey(plane) -> np.ndarray:
    return np.repeat(np.asarray(plane, np.float32)[..., None], 3, axis=2)


def test_a_point_is_spread_by_the_stated_standard_deviation_and_keeps_its_light() -> None:
    point = np.zeros((61, 61))
    point[30, 30] = 1.0
    seen = through_lens(grey(point), ImageChain(blur_px=2.5))[..., 1]
    rows, columns = np.indices(seen.shape) - 30
    assert_allclose(seen.sum(), 1.0, rtol=1e-5)
    assert_allclose(np.sqrt((seen * rows**2).sum()), 2.5, rtol=0.01)
    assert_allclose(np.sqrt((seen * columns**2).sum()), 2.5, rtol=0.01)


@pytest.mark.parametrize("distortion", [-0.1, 0.08])
def test_a_point_is_seen_farther_out_by_the_square_of_its_distance(distortion) -> None:
    """Half of the diagonal of 201 x 151 px is 125 px; a spot at (160, 75) lies 60 px from the middle."""
    rows, columns = np.mgrid[:151, :201]
    spot = np.exp(-((columns - 160) ** 2 + (rows - 75) ** 2) / 18)
    seen = through_lens(grey(spot), ImageChain(distortion=distortion))[..., 0]
    at = (seen * columns).sum() / seen.sum()
    assert_allclose(at, 100 + 60 * (1 + distortion * (60 / 125) ** 2), atol=0.08)
    assert_allclose((seen * rows).sum() / seen.sum(), 75, atol=0.02)


def test_jpeg_changes_more_the_lower_its_quality_and_colour_more_than_brightness(rng) -> None:
    rows, columns = np.mgrid[:64, :64]
    image = np.stack([128 + 90 * np.sin(columns / 3), 128 + 90 * np.cos(rows / 4), 100 + rows], axis=2)
    image = np.clip(image, 0, 255).astype(np.uint8)
    off = [
        np.sqrt(np.mean((as_kept(image, ImageChain(jpeg_quality=q)).astype(float) - image) ** 2))
        for q in (95, 70, 20)
    ]
    assert 0 < off[0] < off[1] < off[2]
    red = np.zeros((64, 64, 3), np.uint8)
    red[..., 0], red[::2, :, 1] = 200, 200  # rows of colour finer than the file keeps
    kept = as_kept(red, ImageChain(jpeg_quality=98)).astype(float)
    assert np.abs(kept - red)[..., 1].mean() > 10
    assert kept[..., 0].mean() > kept[..., 2].mean() + 50  # red stays red


def test_what_no_lens_or_file_can_be_is_refused() -> None:
    for wrong in ({"blur_px": -1.0}, {"blur_px": np.nan}, {"distortion": 0.5}, {"jpeg_quality": 0}):
        with pytest.raises(RangeError):
            ImageChain(**wrong)
