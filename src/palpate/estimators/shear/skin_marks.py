"""Marks of a patterned skin in its plane, frame by frame: tiles under a lens, or a maker's dots.

x runs with the image's columns, y against its rows. Lost tiles leave dark squares with other corners; a
gaping cut is a dark line across tiles, narrower than they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import cv2
import numpy as np

from palpate.core import Bool, Float, ImageError, InputError, Int, Lens, RangeError, Shaped, UInt8, ndarray
from palpate.estimators.fringe_light import brightest_channel
from palpate.estimators.lattice import ControlPoints, DottedSkin, MarkTracker, TrackedPoints, find_dots
from palpate.estimators.surface_strain import PatternedSkin, on_plane

BARE = 0.3  # ratio to the tiles' median level of a lost tile
DARK = 0.55  # ratio to the brightest tile nearby of a gap; red has 0.72 of yellow
AROUND = 1.5  # pitches, in which the brightest tile is looked for
TILE_REACH = 0.95  # pitches from its middle, which a tile that has come off may darken
MIN_GAP = 2.0  # pitches, of a dark line's length
SMOOTH_PX = 0.6
SMOOTH_REACH_PX = 4  # beyond which that smoothing brings nothing

Cells = set[tuple[int, int]]


class TileCentres:
    """Centers of a pattern's tiles in the image of the resting skin."""

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
        """Return positions of cells, integer for corners and half-integer for tiles [px]."""
        return np.asarray(self._cubic(cells) @ self._fit)

    def bare(self, image: Shaped[ndarray, ...]) -> Bool[ndarray, " n"]:
        x, y = self._places.T
        around = [image[y + j, x + i].reshape(len(x), -1) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        level = np.mean([one.max(axis=1) for one in around], axis=0)
        return np.asarray(level < BARE * np.median(level))

    def corners_of(self, bare: Bool[ndarray, " n"]) -> Cells:
        tiles = self._cells[bare].tolist()
        return {(i + di, j + dj) for i, j in tiles for di in (0, 1) for dj in (0, 1)}

    def longest_gap(self, image: Shaped[ndarray, ...], bare: Bool[ndarray, " n"]) -> float:
        """Return the length of the longest dark line across tiles [pitches]; 0 below two."""
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
    """Rows and columns of a mask with a margin, inside the image."""
    x, y, width, height = cv2.boundingRect(mask)
    rows, columns = (
        slice(max(first - beside_px, 0), min(first + count + beside_px, size))
        for first, count, size in ((y, height, mask.shape[0]), (x, width, mask.shape[1]))
    )
    return rows, columns


def without(points: ControlPoints, corners: Cells) -> ControlPoints:
    """Return points without those of some cells."""
    if not corners:
        return points
    kept = np.array([cell not in corners for cell in map(tuple, points.cells.tolist())], bool)
    return ControlPoints(points.cells[kept], points.places[kept], points.sigma[kept], points.unit)


FLIPPED = np.array([1.0, -1.0])
MAX_LOST = 0.01  # of the reference's marks, from frame to frame; beyond, the whole frame is searched


@dataclass(frozen=True, slots=True)
class TiledSkin:
    """Checkerboard on a flat skin, seen from below by a camera across the skin.

    Attributes:
        pitch_m: Side of a tile [m].
        camera_m: Distance of the lens from the resting pattern [m].
        tolerance_m: Standard deviation of a cast mark's position [m].
        scale_tolerance: Relative tolerance of pitch and distance.
        sinking: Depth of the pattern in a press's middle over its greatest outward shift; 0 if unknown.
        layers: Mechanics of the skin; without it positions come from the ring alone.
    """

    pitch_m: float
    columns: int
    rows: int
    camera_m: float
    lens: Lens
    tolerance_m: float = 0.02e-3
    scale_tolerance: float = 0.03
    sinking: float = 0.0
    layers: PatternedSkin | None = None
    name: str = ""

    def __post_init__(self) -> None:
        positive = (self.pitch_m, self.camera_m, self.tolerance_m, self.scale_tolerance)
        if not all(0 < value < math.inf for value in positive):
            raise RangeError(
                f"pitch {self.pitch_m} m, camera {self.camera_m} m, tolerances {self.tolerance_m} m and "
                f"{self.scale_tolerance}; above 0 and finite"
            )
        if min(self.columns, self.rows) < 4:
            raise RangeError(f"{self.columns} x {self.rows} tiles; a skin has 4 or more along each side")

    @property
    def pitch_px(self) -> float:
        """Side of a tile at the image center [px]."""
        return self.pitch_m * math.sqrt(self.lens.focal_px[0] * self.lens.focal_px[1]) / self.camera_m


@runtime_checkable
class SkinMarks(Protocol):
    """Marks of one reference frame, and of those after it.

    Attributes:
        pitch: Distance of neighboring marks [unit].
        px_per_unit: Scale of a frame in its center.
        bare: Corners of lost tiles in the last frame.
        gap: Longest dark line across tiles in it [pitches].
    """

    unit: Literal["px", "m"]
    pitch: float
    px_per_unit: float
    reference: ControlPoints
    bare: set[tuple[int, int]]
    gap: float

    def follow(self, image: Shaped[ndarray, ...]) -> TrackedPoints:
        """Return marks of a frame on the skin [unit], or none and the reason."""

    def in_image(self, places: Shaped[ndarray, "n 2"]) -> Shaped[ndarray, "n 2"]:
        """Return positions on the skin [unit] in the image [px]."""


class TileMarks:
    """Corners of a checkerboard on the skin [m], from an 8-bit no-contact image."""

    unit: Literal["px", "m"] = "m"

    def __init__(self, skin: TiledSkin, image: Shaped[ndarray, ...]) -> None:
        skin.lens.check_size((image.shape[0], image.shape[1]))
        self.skin = skin
        self.pitch = skin.pitch_m
        self.px_per_unit = skin.pitch_px / skin.pitch_m
        self._tracker = MarkTracker(image, skin.pitch_px)
        self.reference = on_plane(self._tracker.reference.points, skin.lens, skin.camera_m)
        self._before = len(self.reference)
        self._tiles = TileCentres(self._tracker.reference.points, image.shape, self._tracker.pitch)
        self._look(image)
        self.reference = without(self.reference, self.bare)

    def follow(self, image: Shaped[ndarray, ...]) -> TrackedPoints:
        """Return the marks of a frame [m] without those of lost tiles, searching again for lost ones."""
        count = len(self.reference)
        tracked = self._tracker.settled(self._tracker.follow(image), image, count)
        if not tracked.found_anew and len(tracked.points) < self._before - MAX_LOST * count:
            anew = self._tracker.settled(self._tracker.search(image), image, count)
            tracked = anew if len(anew.points) > len(tracked.points) else tracked
        self._before = len(tracked.points)
        if not len(tracked.points):
            return tracked
        self._look(image)
        points = on_plane(without(tracked.points, self.bare), self.skin.lens, self.skin.camera_m)
        return TrackedPoints(points, tracked.found_anew)

    def _look(self, image: Shaped[ndarray, ...]) -> None:
        """Detect lost tiles, and a dark line across tiles."""
        off = self._tiles.bare(image)
        self.bare, self.gap = self._tiles.corners_of(off), self._tiles.longest_gap(image, off)

    def in_image(self, places: Shaped[ndarray, "n 2"]) -> Shaped[ndarray, "n 2"]:
        rays = np.column_stack([places * FLIPPED, np.full(len(places), self.skin.camera_m)])
        return self.skin.lens.project(rays)


class DotMarks:
    """Dots of a maker's skin about their middle, in m if their distance is known, else px."""

    def __init__(self, skin: DottedSkin, image: Shaped[ndarray, ...], lens: Lens | None = None) -> None:
        if lens is not None:
            lens.check_size((image.shape[0], image.shape[1]))
        self.skin, self._lens, self._shape = skin, lens, image.shape
        self._first = self._last = find_dots(image, skin)
        self.unit: Literal["px", "m"] = "px" if skin.pitch_mm is None else "m"
        flat = self._straightened(self._first.places)
        self._middle, found = flat.mean(axis=0), _pitch(self._first.cells, flat)
        self.px_per_unit = 1.0 if skin.pitch_mm is None else found / (1e-3 * skin.pitch_mm)
        self.pitch = found / self.px_per_unit
        self.reference = self._on_skin(self._first)
        self.bare: set[tuple[int, int]] = set()
        self.gap = 0.0

    def follow(self, image: Shaped[ndarray, ...]) -> TrackedPoints:
        """Return dots named as in the previous frame or, if lost, the reference."""
        if image.dtype != np.uint8 or image.shape != self._shape:
            raise InputError(
                f"a frame {image.dtype} {list(image.shape)}; give 8-bit frames of {list(self._shape)}"
            )
        reason = ""
        for before in (self._last, self._first):
            try:
                found = self._known(find_dots(image, self.skin, before))
            except ImageError as refusal:
                reason = str(refusal)
                continue
            if len(found) >= len(self._first) / 2:
                self._last = found
                return TrackedPoints(self._on_skin(found), True)
            reason = f"{len(found)} of the reference's {len(self._first)} dots are seen, fewer than half"
        self._last = self._first
        none = ControlPoints(np.empty((0, 2), int), np.empty((0, 2)), np.empty(0))
        return TrackedPoints(none, True, reason)

    def in_image(self, places: Shaped[ndarray, "n 2"]) -> Shaped[ndarray, "n 2"]:
        """Return positions on the skin without lens distortion [px]."""
        return np.asarray(places * FLIPPED * self.px_per_unit + self._middle)

    def _known(self, found: ControlPoints) -> ControlPoints:
        names = set(map(tuple, self._first.cells.tolist()))
        known = np.array([cell in names for cell in map(tuple, found.cells.tolist())], bool)
        return ControlPoints(found.cells[known], found.places[known], found.sigma[known])

    def _straightened(self, places: Shaped[ndarray, "n 2"]) -> Shaped[ndarray, "n 2"]:
        return self.skin.straightened(places) if self._lens is None else self._lens.undistorted(places)

    def _on_skin(self, points: ControlPoints) -> ControlPoints:
        half = np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
        flat = np.stack([self._straightened(points.places + step) for step in half])
        (xx, xy), (yx, yy) = (flat[1] - flat[2]).T, (flat[3] - flat[4]).T
        places = (flat[0] - self._middle) * FLIPPED / self.px_per_unit
        seen = np.isfinite(flat).all(axis=(0, 2))
        sigma = points.sigma * np.sqrt(np.abs(xx * yy - xy * yx)) / self.px_per_unit
        return ControlPoints(points.cells[seen], places[seen], sigma[seen], self.unit)


def _pitch(cells: Shaped[ndarray, "n 2"], places: Shaped[ndarray, "n 2"]) -> float:
    """Median distance of neighbors along a row."""
    at = dict(zip(map(tuple, cells.tolist()), places, strict=True))
    steps = [np.hypot(*(at[c + 1, r] - place)) for (c, r), place in at.items() if (c + 1, r) in at]
    return float(np.median(steps))
