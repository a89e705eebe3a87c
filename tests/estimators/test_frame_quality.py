"""Laws of how a frame's light and sharpness are told."""

import numpy as np
import pytest

from palpate.estimators.shear.shear_reader import _level, look_at, why_unreadable

WHOLE = (slice(None), slice(None))


@pytest.mark.parametrize("count", [1, 2, 7, 1000])
def test_a_level_by_counting_is_numpys_percentile(count: int) -> None:
    rng = np.random.default_rng(count)
    for values in (rng.integers(0, 256, count), rng.integers(0, 3, count), rng.choice([0, 5, 250], count)):
        for percent in (0, 10, 50, 97, 100):
            assert _level(values, percent) == pytest.approx(np.percentile(values, percent), abs=1e-9)


def test_a_dark_a_saturated_and_a_blurred_frame_are_refused_each_by_its_reason() -> None:
    board = np.kron(np.indices((12, 12)).sum(axis=0) % 2, np.ones((10, 10)))
    frame = (40 + 150 * board).astype(np.uint8)
    seen = look_at(frame, WHOLE)
    assert not why_unreadable(seen, seen).code
    smooth = frame.astype(float)
    for _ in range(12):
        smooth = (smooth + np.roll(smooth, 1, 0) + np.roll(smooth, 1, 1)) / 3
    for changed, code in (
        (frame // 4, "low_contrast"),
        (np.where(board > 0, 255, 40).astype(np.uint8), "saturated"),
        (smooth.astype(np.uint8), "blurred"),
    ):
        assert why_unreadable(look_at(changed, WHOLE), seen).code == code
