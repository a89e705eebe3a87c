"""The brightest channel of every pixel."""

import numpy as np
import pytest

from palpate.estimators.brightest_channel import brightest_channel


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 1), (5, 7, 3), (5, 7, 4)])
def test_it_is_the_greatest_of_the_channels_and_a_grey_image_itself(shape) -> None:
    image = np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8)
    found = brightest_channel(image)
    np.testing.assert_array_equal(found, image if image.ndim == 2 else image.max(axis=2))
    assert found.dtype == np.uint8
    assert found.flags.c_contiguous
