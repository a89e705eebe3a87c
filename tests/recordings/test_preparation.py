"""From a frame to an estimator's input."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core.errors import ImageError, InputError
from palpate.recordings.preparation import Preparation

FRAME = np.random.default_rng(0).integers(0, 256, (40, 90, 3), np.uint8)
LEFT, RIGHT = (2, 3, 20, 20), (50, 11, 24, 16)


@pytest.mark.parametrize("channels", [1, 3])
def test_two_crops_lie_side_by_side_each_as_it_would_be_alone(channels: int) -> None:
    both = Preparation(LEFT, (10, 24), channels, RIGHT).apply(FRAME)  # type: ignore[arg-type]
    alone = [Preparation(box, (10, 12), channels).apply(FRAME) for box in (LEFT, RIGHT)]  # type: ignore[arg-type]
    assert both.shape == (10, 24, channels)
    np.testing.assert_array_equal(both[:, :12], alone[0])
    np.testing.assert_array_equal(both[:, 12:], alone[1])


@pytest.mark.parametrize("box", [(80, 0, 20, 20), (0, 30, 20, 20)])
def test_a_second_crop_outside_the_frame_is_refused(box: tuple[int, int, int, int]) -> None:
    with refused("crop-outside", ImageError):
        Preparation(LEFT, (10, 24), 1, box).apply(FRAME)


@pytest.mark.parametrize(
    ("first", "size", "second"),
    [(None, (10, 24), RIGHT), (LEFT, (10, 25), RIGHT), (LEFT, (10, 24), (0, 0, 0, 4))],
)
def test_two_crops_that_cannot_lie_side_by_side_are_refused(
    first: tuple[int, int, int, int] | None, size: tuple[int, int], second: tuple[int, int, int, int]
) -> None:
    with pytest.raises(InputError):
        Preparation(first, size, 1, second)
