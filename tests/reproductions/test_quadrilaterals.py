"""The published chain on rendered boards: its stages, its points, and that the fast form is the same."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.rendered_boards import View, board, noisy

from palpate.core import ImageError, RangeError
from palpate_reproductions.nusense.quadrilaterals import (
    QuadSettings,
    midpoints_by_pairs,
    midpoints_by_tree,
    published_stages,
    quad_midpoints,
)

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


def test_each_stage_s_picture_is_of_the_crop_and_is_named_in_order(frame) -> None:
    stages = published_stages(frame, replace(SETTINGS, region=(60, 40, 340, 260)))
    assert list(stages.pictures) == [
        "cropped", "grey", "equalised", "filtered", "edges", "thresholded", "dilated", "eroded"
    ]  # fmt: skip
    assert all(picture.shape[:2] == (260, 340) for picture in stages.pictures.values())
    masks = [stages.pictures[name] > 0 for name in ("thresholded", "dilated", "eroded")]
    assert (masks[0] <= masks[2]).all()
    assert (masks[2] <= masks[1]).all()
    # Only yellow tiles are drawn around.
    grey = stages.pictures["grey"].astype(float)
    x, y = np.rint(stages.quads.mean(axis=1)).astype(int).T
    assert grey[y, x].min() > np.median(grey)


def test_the_tree_pairs_what_the_double_loop_pairs() -> None:
    rng = np.random.default_rng(1)
    i, j = np.meshgrid(np.arange(12), np.arange(12))
    middles = np.stack([2 * i + j % 2, j], axis=-1).reshape(-1, 2) * 24.0 + rng.normal(0, 1, (144, 2))
    corners = 10.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    quads = middles[:, None] + corners + rng.normal(0, 0.5, (144, 4, 2))
    plain, fast = midpoints_by_pairs(list(quads), 1.7 * 24), midpoints_by_tree(quads, 1.7 * 24)
    assert plain.shape == fast.shape == (11 * 23, 2)
    assert np.abs(plain - fast).max() < 1e-9
    # A c_th beyond two pitches joins tiles that do not meet.
    assert len(midpoints_by_tree(quads, 2.2 * 24)) > len(fast)


def test_settings_and_frames_that_cannot_be_are_refused(frame) -> None:
    with pytest.raises(RangeError, match="c_th"):
        QuadSettings(c_th=2.5)
    with pytest.raises(ImageError, match="within"):
        quad_midpoints(frame, replace(SETTINGS, region=(400, 0, 200, 100)))
    with pytest.raises(ImageError, match="8-bit"):
        published_stages(frame.astype(float), SETTINGS)
    assert quad_midpoints(np.full((300, 300, 3), 90, np.uint8), SETTINGS).shape == (0, 2)
