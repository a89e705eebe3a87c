"""Laws of rectification: the fast map is the exact one, straight is straight, and no other camera's frame."""

import cv2
import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import ImageError, Lens
from palpate.recordings.preparation import Preparation, exact_maps, fixed_maps, rectified

LENS = Lens("kannala-brandt", (330.0, 331.0), (318.0, 242.0), (0.03, -0.01, 0.004, -0.001), (480, 640), 0.8)


def test_the_fixed_point_map_lies_within_a_twentieth_of_a_pixel_of_the_exact_one():
    """Steps of 1/32 px: 1/64 px at most along each axis, where the lens has an answer."""
    x, y = exact_maps(LENS)
    whole, part = fixed_maps(LENS)
    found_x = whole[..., 0] + (part & 31) / 32
    found_y = whole[..., 1] + (part >> 5) / 32
    seen = x >= 0
    off = np.hypot(found_x - x, found_y - y)[seen]
    assert off.max() <= np.hypot(1 / 64, 1 / 64) + 1e-4 < 0.05
    assert off.max() > 0.01


def test_the_map_is_opencv_s_within_the_field():
    theirs = cv2.fisheye.initUndistortRectifyMap(
        LENS.matrix, np.array(LENS.distortion), np.eye(3), LENS.matrix, (640, 480), cv2.CV_32FC1
    )
    own = exact_maps(LENS)
    seen = own[0] >= 0
    assert 0.9 < seen.mean() < 1
    for mine, other in zip(own, theirs, strict=True):
        assert np.abs(mine - other)[seen].max() < 1e-3  # float32 of hundreds of pixels


def test_a_grid_behind_the_lens_becomes_straight():
    """Grey is a function of the direction alone: rectified, it is that of the flat pinhole."""
    column, row = np.meshgrid(np.arange(640.0), np.arange(480.0))

    def picture(lens):
        rays = lens.rays(np.stack([column, row], axis=-1))
        with np.errstate(invalid="ignore"):
            grey = (
                127
                + 60 * np.sin(18 * rays[..., 0] / rays[..., 2])
                + 60 * np.sin(15 * rays[..., 1] / rays[..., 2])
            )
        return np.nan_to_num(grey, nan=0).astype(np.uint8)

    flat, seen = picture(LENS.flat()), exact_maps(LENS)[0] > 0
    inner = cv2.erode(seen.astype(np.uint8), np.ones((15, 15))) > 0
    bent = picture(LENS)
    error = np.abs(rectified(bent, LENS).astype(int) - flat.astype(int))[inner]
    assert error.max() <= 4  # rounding of grey, and linear interpolation of waves of 100 px
    assert np.abs(bent.astype(int) - flat.astype(int))[inner].max() > 60


def test_beyond_the_field_the_image_is_black_and_not_made_up():
    seen = exact_maps(LENS)[0] >= 0
    white = rectified(np.full((480, 640, 3), 255, np.uint8), LENS)
    away = cv2.dilate(seen.astype(np.uint8), np.ones((3, 3))) == 0
    assert away.any()
    assert (white[away] == 0).all()
    assert white[200:280, 280:360].min() == 255


def test_a_frame_of_another_size_is_refused():
    with refused("image-size", ImageError, match="640x480 px"):
        rectified(np.zeros((240, 320), np.uint8), LENS)
    with pytest.raises(ImageError, match=LENS.id):
        Preparation(None, (48, 64), 1, lens=LENS).apply(np.zeros((240, 320), np.uint8))


def test_crops_count_in_the_rectified_image():
    frame = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    crop = (100, 50, 200, 150)
    whole = Preparation(None, (480, 640), 3, lens=LENS).apply(frame)
    part = Preparation(crop, (150, 200), 3, lens=LENS).apply(frame)
    np.testing.assert_array_equal(part, whole[50:200, 100:300])
    np.testing.assert_array_equal(whole, rectified(frame, LENS))
