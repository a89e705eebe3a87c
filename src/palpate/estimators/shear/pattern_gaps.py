"""Tiles that have come off a pattern, and dark lines across it: where its colours are gone.

A tile that has come off leaves a dark square, and its corners are those of other shapes. A cut through the
coloured layer that gapes is a dark line, which crosses tiles and is narrower than they are.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from palpate.core import Bool, Float, Int, Shaped, UInt8, ndarray
from palpate.estimators.brightest_channel import brightest_channel
from palpate.estimators.lattice import ControlPoints

BARE = 0.3  # of the tiles' median level: what a tile that has come off is darker than
DARK = 0.55  # of the brightest tile around: what a gap of a pixel is darker than; red has 0.72 of yellow
AROUND = 1.5  # pitches, in which the brightest tile is looked for
TILE_REACH = 0.95  # pitches from its middle, which a tile that has come off may darken
MIN_GAP = 2.0  # pitches, of a dark line's length
SMOOTH_PX = 0.6
SMOOTH_REACH_PX = 4  # beyond which that smoothing brings nothing

Cells = set[tuple[int, int]]


class TileCentres:
    """Middles of a pattern's tiles in the image of a resting skin.

    Args:
        points: corners in the reference frame [px].
        shape: of that frame.
        pitch_px: side of a tile.
    """

    def __init__(self, points: ControlPoints, shape: tuple[int, ...], pitch_px: float) -> None:
        low, high = points.cells.min(axis=0) - 1, points.cells.max(axis=0)
        column, row = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        cells = np.column_stack([column.ravel(), row.ravel()])
        self._span = np.maximum(np.ptp(points.cells, axis=0), 1)
        self._fit = np.linalg.lstsq(self._cubic(points.cells), points.places, rcond=None)[0]
        self._size, self._pitch = shape[:2], pitch_px
        places = np.rint(self.at(cells + 0.5)).astype(int)  # tile (i, j) is amid corners i and i + 1
        inside = ((places >= 1) & (places < [shape[1] - 1, shape[0] - 1])).all(axis=1)
        self._cells, self._places = cells[inside], places[inside]
        hull = cv2.convexHull(points.places.astype(np.float32))
        self._within = np.zeros(self._size, np.uint8)
        cv2.fillConvexPoly(self._within, np.rint(hull).astype(np.int32), 1)
        self._around = 2 * round(AROUND * pitch_px) + 1
        self._box = _box(self._within, self._around // 2 + SMOOTH_REACH_PX)

    def at(self, cells: Float[ndarray, "n 2"] | Int[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
        """Places of cells, whole for corners and amid them for tiles [px]."""
        return np.asarray(self._cubic(cells) @ self._fit)

    def bare(self, image: Shaped[ndarray, ...]) -> Bool[ndarray, " n"]:
        """Which tiles have come off."""
        x, y = self._places.T
        around = [image[y + j, x + i].reshape(len(x), -1) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        level = np.mean([one.max(axis=1) for one in around], axis=0)
        return np.asarray(level < BARE * np.median(level))

    def corners_of(self, bare: Bool[ndarray, " n"]) -> Cells:
        """Corners of the tiles that have come off."""
        tiles = self._cells[bare].tolist()
        return {(i + di, j + dj) for i, j in tiles for di in (0, 1) for dj in (0, 1)}

    def longest_gap(self, image: Shaped[ndarray, ...], bare: Bool[ndarray, " n"]) -> float:
        """Length of the longest dark line across tiles [pitches]; 0 below two."""
        rows, columns = self._box
        bright = cv2.GaussianBlur(brightest_channel(image[rows, columns]), (0, 0), SMOOTH_PX)
        around = cv2.dilate(bright, np.ones((self._around, self._around), np.uint8))
        dark = np.uint8(bright < DARK * around) & self._within[rows, columns]
        for x, y in (self._places[bare] - [columns.start, rows.start]).tolist():
            cv2.circle(dark, (x, y), round(TILE_REACH * self._pitch), 0, -1)
        if cv2.countNonZero(dark) < MIN_GAP * self._pitch / math.sqrt(
            2
        ):  # fewer than a line has, even aslant
            return 0.0
        count, _, stats, _ = cv2.connectedComponentsWithStats(dark)
        if count < 2:
            return 0.0
        length = float(np.hypot(*stats[1:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].T).max()) / self._pitch
        return length if length >= MIN_GAP else 0.0

    def _cubic(self, cells: ndarray) -> Float[ndarray, "n 10"]:
        x, y = (cells / self._span).T
        return np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])


def _box(mask: UInt8[ndarray, "h w"], beside_px: int) -> tuple[slice, slice]:
    """Rows and columns of a mask, and some beside it, as far as there are any."""
    x, y, width, height = cv2.boundingRect(mask)
    rows, columns = (
        slice(max(first - beside_px, 0), min(first + count + beside_px, size))
        for first, count, size in ((y, height, mask.shape[0]), (x, width, mask.shape[1]))
    )
    return rows, columns


def without(points: ControlPoints, corners: Cells) -> ControlPoints:
    """Points less those of some cells."""
    if not corners:
        return points
    kept = np.array([cell not in corners for cell in map(tuple, points.cells.tolist())], bool)
    return ControlPoints(points.cells[kept], points.places[kept], points.sigma[kept], points.unit)
