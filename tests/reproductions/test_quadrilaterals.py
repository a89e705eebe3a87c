"""The published chain on rendered boards: its stages, its points, and that the fast form is the same."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.rendered_boards import View, board, noisy

from palpate.core import ImageError, RangeError
from palpate_reproductions.nusense.quadrilaterals import QuadSettings, published_stages, quad_midpoints

VIEW = View(pitch=24.0, turn=0.08, size=(480, 360), barrel=0.05, at=(240.0, 180.0))
SETTINGS = QuadSettings(pitch_px=24.0)


@pytest.fixture(scope="module")
def frame() -> np.ndarray:
    return noisy(board(replace(VIEW, bulge=4.0), extent=(14, 10)), np.random.default_rng(0))


def test_the_fast_chain_gives_the_points_of_the_plain_one(frame) -> None:
    for region in (None, (60, 40, 340, 260)):
        settings = replace(SETTINGS, region=region)
        plain, fast = published_stages(frame, settings).midpoints, quad_midpoints(frame, settings)
        assert len(plain) > 50
        assert np.abs(plain - fast).max() < 1e-9


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
        quad_midpoints(frame, replace(SETTINGS, region=(400, 0, 200, 100)))
    with pytest.raises(ImageError, match="8-bit"):
        published_stages(frame.astype(float), SETTINGS)
    assert quad_midpoints(np.full((300, 300, 3), 90, np.uint8), SETTINGS).shape == (0, 2)
