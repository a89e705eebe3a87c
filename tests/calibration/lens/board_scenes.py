"""Boards before a known lens: corners with noise, and photographs of them."""

import math

import cv2
import numpy as np

from palpate.calibration.lens import Board, BoardView
from palpate.core import Lens

FISHEYE = Lens("kannala-brandt", (292.0, 290.0), (324.0, 236.0), (0.02, -0.008, 0.003, -0.0006), (480, 640))
PINHOLE = Lens("pinhole", (520.0, 523.0), (316.0, 247.0), (-0.18, 0.06, 6e-4, -4e-4, -0.01), (480, 640))
BOARD = Board(9, 6, 0.025)


def poses(lens, board, count, rng, *, tilt=0.6, spread=1.0, near=1.0):
    """Rotations and translations of boards that lie wholly in the frame, all over it."""
    height, width = lens.size_px
    middle = board.corners_m.mean(axis=0)
    found = []
    while len(found) < count:
        turn = cv2.Rodrigues(np.array([*rng.uniform(-tilt, tilt, 2), rng.uniform(-0.5, 0.5)]))[0]
        x, y = rng.uniform(-0.5, 0.5, 2) * spread
        aim = lens.rays(np.array([[(0.5 + x) * width, (0.5 + y) * height]]))[0]
        place = aim * rng.uniform(0.16, 0.34) * near - turn @ middle
        at = lens.project(board.corners_m @ turn.T + place)
        if np.isfinite(at).all() and (at > 8).all() and (at < np.array([width, height]) - 9).all():
            found.append((turn, place, at))
    return found


def corner_views(lens, count=20, noise_px=0.1, seed=0, board=BOARD, **where):
    """Views of a board with Gaussian noise on each coordinate."""
    rng = np.random.default_rng(seed)
    return [
        BoardView(f"{i:03d}.png", board.corners_m, at + rng.normal(0, noise_px, at.shape), lens.size_px)
        for i, (_, _, at) in enumerate(poses(lens, board, count, rng, **where))
    ]


def photograph(lens, board, turn, place, square_px=64, over=2):
    """What the lens sees of a printed board: the plane cut by `over`² rays of each pixel."""
    picture = board.picture(square_px)
    height, width = lens.size_px
    at = (np.arange(over) + 0.5) / over - 0.5
    rows, columns = (np.arange(n)[:, None] + at for n in (height, width))
    grid = np.stack(np.meshgrid(columns.ravel(), rows.ravel()), axis=-1)
    rays = lens.rays(grid) @ turn  # in the board's axes
    origin = -place @ turn
    with np.errstate(invalid="ignore", divide="ignore"):
        far = -origin[2] / rays[..., 2]
        on_board = origin[:2] + far[..., None] * rays[..., :2]
        # The picture's corner (0, 0) is two squares off: a margin, and a square beyond the first corner.
        pixels = (on_board / board.square_m + 2) * square_px - 0.5
    pixels = np.where((far > 0)[..., None] & np.isfinite(pixels), pixels, -100).astype(np.float32)
    seen = cv2.remap(picture, pixels, None, cv2.INTER_LINEAR, borderValue=110)
    mean = seen.reshape(height, over, width, over).mean(axis=(1, 3))
    return np.round(30 + 0.75 * mean).astype(np.uint8)


def write_photographs(folder, lens, board, count, seed=0, noise=2.0, **where):
    """Photographs of boards all over the frame, with their true corners."""
    rng, corners = np.random.default_rng(seed), {}
    folder.mkdir(parents=True, exist_ok=True)
    for i, (turn, place, at) in enumerate(poses(lens, board, count, rng, **where)):
        image = photograph(lens, board, turn, place) + rng.normal(0, noise, lens.size_px)
        cv2.imwrite(str(folder / f"{i:03d}.png"), np.clip(image, 0, 255).round().astype(np.uint8))
        corners[f"{i:03d}.png"] = at
    return corners


def farthest_px(found, true, to_rad):
    """Greatest distance between where two lenses put directions within an angle of the axis [px]."""
    theta, around = np.meshgrid(np.linspace(0, to_rad, 20), np.linspace(0, math.tau, 24))
    unit = np.stack([np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)], axis=-1)
    return float(np.nanmax(np.linalg.norm(found.project(unit) - true.project(unit), axis=-1)))
