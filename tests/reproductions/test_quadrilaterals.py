"""The published chain on rendered boards: its points, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.rendered_boards import View, board, noisy

from palpate.core import ImageError, RangeError
from palpate_reproductions.nusense.quadrilaterals import QuadSettings, published_stages

VIEW = View(pitch=24.0, turn=0.08, size=(480, 360), barrel=0.05, at=(240.0, 180.0))
SETTINGS = QuadSettings(pitch_px=24.0)


@pytest.fixture(scope="module")
def frame() -> np.ndarray:
    return noisy(board(replace(VIEW, bulge=4.0), extent=(14, 10)), np.random.default_rng(0))


def test_midpoints_lie_on_corners_to_some_pixels(frame) -> None:
    view = replace(VIEW, bulge=4.0)
    stages = published_stages(frame, SETTINGS)
    _, true = view.marks((14, 10))
    far, _ = cKDTree(stages.midpoints).query(true)
    # Corners of contours are whole pixels: the robust detector is an order nearer.
    assert np.median(far) < 1.5
    assert (far < 4).mean() > 0.85


def test_settings_and_frames_that_cannot_be_are_refused(frame) -> None:
    with pytest.raises(RangeError, match="c_th"):
        QuadSettings(c_th=2.5)
    with pytest.raises(ImageError, match="within"):
        published_stages(frame, replace(SETTINGS, region=(400, 0, 200, 100)))
    with pytest.raises(ImageError, match="8-bit"):
        published_stages(frame.astype(float), SETTINGS)
    assert published_stages(np.full((300, 300, 3), 90, np.uint8), SETTINGS).midpoints.shape == (0, 2)
