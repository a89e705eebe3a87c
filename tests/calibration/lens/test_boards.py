"""Laws of finding boards: corners where they are, no wrong board taken for the right one."""

from functools import cache

import cv2
import numpy as np
import pytest
from tests.calibration.lens.board_scenes import BOARD, FISHEYE, photograph, poses, write_photographs

from palpate.calibration.lens import Board, BoardView, calibrate_lens, find_board, read_views
from palpate.core import ImageError, InputError

CHARUCO = Board(7, 5, 0.03, "4X4_50")


@cache
def seen_and_true(board):
    turn, place, at = poses(FISHEYE, board, 1, np.random.default_rng(1), tilt=0.4)[0]
    return photograph(FISHEYE, board, turn, place), at


@pytest.mark.parametrize("board", [BOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_corners_are_found_to_a_part_of_a_pixel(board):
    image, at = seen_and_true(board)
    found = find_board(image, board, "a.png")
    assert isinstance(found, BoardView)
    number = np.round(found.corners_m[:, :2] / board.square_m).astype(int) @ (1, board.columns)
    ways = [at[number], at[::-1][number]]  # half a turn of a chessboard is the same board
    error = min(np.sqrt(np.mean(np.sum((found.places_px - way) ** 2, axis=1))) for way in ways)
    assert error < (0.15 if board is BOARD else 0.3)


def test_no_board_is_none_and_another_size_is_named():
    image, _ = seen_and_true(BOARD)
    assert find_board(np.full((480, 640), 90, np.uint8), BOARD, "a.png") is None
    assert find_board(image, Board(7, 4), "a.png") in [(9, 6), (9, 7)]


def test_part_of_a_charuco_board_is_enough():
    image, _ = seen_and_true(CHARUCO)
    whole = find_board(image, CHARUCO, "a.png")
    image = image.copy()
    image[:, : int(np.median(whole.places_px[:, 0]))] = 90
    part = find_board(image, CHARUCO, "a.png")
    assert 12 <= len(part.places_px) < len(whole.places_px)
    known = {
        tuple(np.round(corner, 6)): place
        for corner, place in zip(whole.corners_m, whole.places_px, strict=True)
    }
    off = [
        np.linalg.norm(known[tuple(np.round(c, 6))] - p)
        for c, p in zip(part.corners_m, part.places_px, strict=True)
    ]
    assert np.median(off) < 0.2


@pytest.mark.slow
def test_photographs_give_the_lens(tmp_path):
    """From pixels on: the directions of a 40 degree cone within 0.5 px of the true lens's."""
    write_photographs(tmp_path / "photos", FISHEYE, BOARD, 12)
    told = []
    fit = calibrate_lens(tmp_path / "photos", BOARD, progress=lambda *step: told.append(step))
    assert fit.lens.model == "kannala-brandt"
    assert len(fit.views) >= 10
    theta = np.linspace(0, 0.7, 20)
    rays = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    assert np.nanmax(np.linalg.norm(fit.lens.project(rays) - FISHEYE.project(rays), axis=1)) < 0.5
    assert ("looking for the board", 12, 12) in told


def test_bad_folders_are_refused(tmp_path):
    folder = tmp_path / "photos"
    with pytest.raises(InputError, match="not a folder"):
        read_views(folder, BOARD)
    folder.mkdir()
    with pytest.raises(InputError, match="no photographs"):
        read_views(folder, BOARD)
    cv2.imwrite(str(folder / "a.png"), np.zeros((48, 64), np.uint8))
    cv2.imwrite(str(folder / "b.png"), np.zeros((50, 64), np.uint8))
    with pytest.raises(InputError, match=r"several sizes.*64x48.*64x50"):
        read_views(folder, BOARD)
    (folder / "b.png").write_bytes(b"no image")
    with pytest.raises(ImageError, match=r"b\.png"):
        read_views(folder, BOARD)


@pytest.mark.slow
def test_a_folder_of_another_board_is_refused_with_its_size(tmp_path):
    write_photographs(tmp_path, FISHEYE, BOARD, 2)
    with pytest.raises(InputError, match=r"--board 9x[67]"):
        read_views(tmp_path, Board(7, 4))
