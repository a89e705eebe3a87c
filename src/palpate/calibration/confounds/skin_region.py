"""Skin region: the part of a picture that changes from one press to the next, and what lies outside it.

Lamp, reflections, and background change slowly, so frames a little apart in order are compared. Large
connected regions that change are the skin, one in each view.

Control model: prediction of the labels from the part of the picture outside the skin. A prediction there
indicates drift of the lamp with ordered labels, or light that a press spreads to the rim.

Map of the pixels that decide a reading: growth of the error where a block is replaced by its mean over
many frames (occlusion: M. D. Zeiler and R. Fergus, ECCV 2014, doi:10.1007/978-3-319-10590-1_53).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import cv2
import numpy as np

from palpate.calibration.confounds.target_functions import Kernels, explained_share
from palpate.core import Bool, Float, Float32, Indices, Int, Progress, Values, new_file, silent
from palpate.core.array_files import MAX_ARRAY_BYTES, read_arrays
from palpate.core.errors import CertificateError
from palpate.core.parsing import parser
from palpate.estimators.networks.model_interface import Fitted, TrainingData

MAP_PX = 40  # cells along the longer side in which change is averaged: gaps between markers close
PAIRS = 300
NEAR = 0.02  # ratio of a session between the frames of a pair
ACTIVE = 0.15  # change of a skin cell, between the quietest (0) and the liveliest (1)
MIN_CONTRAST = 1.5  # liveliest over quietest change, below which all is noise
SMALL_PLACE, SMALL_AT_BORDER = 0.05, 0.15  # area relative to the largest, below which it is no skin
MIN_OUTSIDE = 0.02  # ratio of the picture below which there is no outside


class RegionSource(Enum):
    """How a region was found, in words."""

    GIVEN = "the box that was given"
    CHANGING = "the part of the picture that changes from press to press"
    CHANGING_UNDER_TOUCH = "the part of the picture that changes more under touch than at rest"
    EVERYWHERE = "every part of the picture changes alike"


@dataclass(frozen=True)
class SkinRegion:
    """Skin in prepared pictures.

    Attributes:
        outside, inside: pixels surely outside the skin, and of the skin, with a margin between ``[h w]``.
    """

    outside: Bool[np.ndarray, "h w"]
    inside: Bool[np.ndarray, "h w"]
    source: RegionSource

    @property
    def has_outside(self) -> bool:
        return bool(self.outside.mean() >= MIN_OUTSIDE)

    @property
    def box(self) -> tuple[int, int, int, int]:
        """(x, y, width, height) that just holds the skin [px of the prepared picture]."""
        rows, columns = (np.flatnonzero(self.inside.any(axis=axis)) for axis in (1, 0))
        return int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1


def change_map(
    images: Float32[np.ndarray, "n h w c"],
    units: Int[np.ndarray, " n"],
    seed: int = 0,
    sessions: Int[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "y x"]:
    """Return the mean absolute difference of frames a little apart in order, in cells [grey levels]."""
    n = len(images)
    sessions = np.zeros(n, np.int64) if sessions is None else sessions
    by_session = np.argsort(sessions, kind="stable")
    rng = np.random.default_rng(seed)
    # Beyond the unit a frame belongs to: within a press, frames may differ by noise alone.
    near = round(NEAR * n / len(np.unique(sessions)))
    step = max(1, near, int(np.median(np.bincount(np.unique(units, return_inverse=True)[1]))))
    step = min(step, max(1, n // 2))
    first = np.unique(np.linspace(0, n - 1 - step, min(PAIRS, n - step)).astype(np.int64))
    second = np.minimum(first + step + rng.integers(0, step + 1, len(first)), n - 1)
    first, second = by_session[first], by_session[second]
    if (same := sessions[first] == sessions[second]).any():
        first, second = first[same], second[same]
    height, width = images.shape[1:3]
    scale = MAP_PX / max(height, width)
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    change = np.mean(
        [np.abs(images[a] - images[b]).max(axis=-1) for a, b in zip(first, second, strict=True)], axis=0
    )
    cells = cv2.resize(change.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return cv2.blur(cells, (3, 3), borderType=cv2.BORDER_REPLICATE).astype(np.float64)


def find_skin(
    images: Float32[np.ndarray, "n h w c"],
    units: Int[np.ndarray, " n"],
    untouched: Float32[np.ndarray, "r h w c"] | None = None,
    sessions: Int[np.ndarray, " n"] | None = None,
    rest_sessions: Int[np.ndarray, " r"] | None = None,
) -> SkinRegion:
    """Find the skin by what changes from press to press.

    Args:
        images: prepared frames in temporal order [grey levels].
        units: press of each.
        untouched: no-contact frames in temporal order, which show what changes without touch.
        sessions, rest_sessions: session of each image and no-contact frame; None for one.
    """
    change = change_map(images, units, sessions=sessions)
    quiet = float(np.quantile(change, 0.02))
    source = RegionSource.CHANGING
    if untouched is not None and len(untouched) >= 4:
        rest = change_map(untouched, np.arange(len(untouched)), sessions=rest_sessions)
        change, quiet = np.maximum(change - rest, 0.0), 0.0
        source = RegionSource.CHANGING_UNDER_TOUCH
    lively = float(np.quantile(change, 0.9))
    height, width = images.shape[1:3]
    whole = np.ones((height, width), dtype=bool)
    if lively <= max(MIN_CONTRAST * quiet, 1e-6):
        return SkinRegion(~whole, whole, RegionSource.EVERYWHERE)
    return _region(change > quiet + ACTIVE * (lively - quiet), (height, width), source)


def _region(active: Bool[np.ndarray, "y x"], shape: tuple[int, int], source: RegionSource) -> SkinRegion:
    closed = cv2.morphologyEx(active.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    _, parts, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    x, y, wide, tall, areas = stats[1:].T
    at_border = (np.minimum(x, y) == 0) | (x + wide == active.shape[1]) | (y + tall == active.shape[0])
    least = np.where(at_border, SMALL_AT_BORDER, SMALL_PLACE) * areas.max(initial=1)
    hull = np.zeros(active.shape, np.uint8)
    for part in 1 + np.flatnonzero(areas >= least):
        corners = np.argwhere(parts == part)[:, ::-1].astype(np.int32)
        cv2.fillConvexPoly(hull, cv2.convexHull(corners), 1)
    wide = cv2.dilate(hull, np.ones((3, 3), np.uint8))
    size = shape[::-1]
    inside, near = (cv2.resize(m, size, interpolation=cv2.INTER_NEAREST) > 0 for m in (hull, wide))
    return SkinRegion(~near, inside, source)


def boxed(shape: tuple[int, int], box: tuple[int, int, int, int]) -> SkinRegion:
    """Return the region whose outside lies beyond a box, (x, y, width, height) [px of the picture]."""
    inside = np.zeros(shape, dtype=bool)
    x, y, width, height = box
    inside[max(y, 0) : y + height, max(x, 0) : x + width] = True
    return SkinRegion(~inside, inside, RegionSource.GIVEN)


def outside_shares(
    images: Float32[np.ndarray, "n h w c"], region: SkinRegion, values: Values, *parts: Sequence[Indices]
) -> list[Float[np.ndarray, " t"]]:
    """Return the held-out R² of each label ``[t]`` by regression on the outside, for each set of folds.

    Args:
        images: small pictures [grey levels].
        values: labels ``[n t]``.
        parts: sets of folds, in rows of `images`.
    """
    kernels = Kernels.of(images[:, region.outside].reshape(len(images), -1))
    return [explained_share(values, kernels.held_out(values, folds)) for folds in parts]


MAP_FILE = "deciding-pixels.npy"
MAX_CORNER_BLOCKS = 3  # of the border, which may hold a text or a bar
BLOCKS = 12  # blocks along the picture's longer side
MAX_ROWS = 60  # held-out rows read again, over all folds
MEAN_ROWS = 200  # greatest number of rows in a block's mean


@dataclass(frozen=True)
class DecidingPixels:
    """Growth of the error by occluded block.

    Attributes:
        increase: growth of the mean absolute error in each target's unit ``[t y x]``.
        rows: number of held-out rows averaged.
    """

    increase: Float[np.ndarray, "t y x"]
    rows: int

    @classmethod
    def joined(cls, parts: list[DecidingPixels]) -> DecidingPixels | None:
        """The mean over folds, each by its rows; None where there are none."""
        rows = sum(part.rows for part in parts)
        if not rows:
            return None
        return cls(np.sum([part.increase * part.rows for part in parts], axis=0) / rows, rows)

    def away_from_skin(self, region: SkinRegion) -> Float[np.ndarray, " t"]:
        """Return the ratio of each target's growth ``[t]`` outside the skin.

        A block next to the skin is no outside, since a touch reaches there; falls of the error count against
        growth, so that noise adds up to nothing. A few blocks at the picture's border that hold half of all
        growth are outside: no touch is read in one corner.
        """
        gains = np.clip(self.increase, 0, None)
        whole = np.maximum(gains.sum(axis=(1, 2)), np.finfo(float).tiny)
        down, across = gains.shape[1:]
        cells = cv2.resize(region.outside.astype(np.float32), (across, down), interpolation=cv2.INTER_AREA)
        outside = cv2.erode((cells > 0.5).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        border = np.ones((down, across), bool)
        border[1:-1, 1:-1] = False
        corner = np.sort(gains[:, border], axis=1)[:, -MAX_CORNER_BLOCKS:].sum(axis=1) / whole
        away = (self.increase * outside).sum(axis=(1, 2)) / whole
        return np.maximum(away, np.where(corner > 0.5, corner, 0.0))

    def save(self, path: Path) -> None:
        """Write the map as a NumPy array, float32."""
        with path.open("wb") as file:
            np.save(file, self.increase.astype(np.float32))

    def keep(self, path: Path) -> None:
        path.unlink(missing_ok=True)
        with new_file(path) as file_path, file_path.open("wb") as file:
            np.savez(file, increase=self.increase, rows=self.rows)

    @classmethod
    @parser("saliency map", CertificateError, max_bytes=MAX_ARRAY_BYTES)
    def kept(cls, path: Path) -> DecidingPixels | None:
        """A fold's map as an interrupted run kept it; None where it is missing or damaged."""
        try:
            arrays = read_arrays(path)
            return cls(np.asarray(arrays["increase"], np.float64), int(arrays["rows"]))
        except Exception:  # numpy raises many kinds over damaged bytes
            return None


def mean_input(data: TrainingData, rows: Indices) -> Float32[np.ndarray, "c h w"]:
    """Return the mean input over some of the rows ``[c h w]``."""
    chosen = rows[np.unique(np.linspace(0, len(rows) - 1, min(MEAN_ROWS, len(rows))).astype(np.int64))]
    total = np.zeros(data.shape, np.float64)
    for _, inputs in data.batches(chosen, 64):
        total += inputs.sum(axis=0, dtype=np.float64)
    return (total / len(chosen)).astype(np.float32)


def rows_of_fold(folds: int, k: int) -> int:
    """Return the rows of fold `k` to read again, so that all `folds` read `MAX_ROWS`."""
    return max(1, MAX_ROWS * (k + 1) // folds - MAX_ROWS * k // folds)


def block_edges(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the limits of the blocks down and across a picture [px]."""
    side = max(shape) / BLOCKS
    counts = [min(max(1, round(length / side)), length) for length in shape]
    return tuple(  # type: ignore[return-value]
        np.linspace(0, length, count + 1).round().astype(int)
        for length, count in zip(shape, counts, strict=True)
    )


def deciding_pixels(
    fitted: Fitted,
    data: TrainingData,
    held_out: Indices,
    nothing: Float32[np.ndarray, "c h w"],
    rows: int,
    progress: Progress = silent,
) -> DecidingPixels:
    """Read held-out rows again, each time with one block of the picture replaced.

    Args:
        fitted: model that has not seen these rows.
        nothing: replacement input ``[c h w]``, see `mean_input`.
        rows: number of rows read, evenly spaced.
    """
    chosen = held_out[np.unique(np.linspace(0, len(held_out) - 1, min(rows, len(held_out))).astype(np.int64))]
    inputs, true = data.fetch(chosen), data.values[chosen]
    down, across = block_edges(inputs.shape[2:])
    whole = np.abs(fitted.predict(inputs) - true).mean(axis=0)
    increase = np.empty((true.shape[1], len(down) - 1, len(across) - 1))
    for i in range(len(down) - 1):
        for j in range(len(across) - 1):
            block = (..., slice(down[i], down[i + 1]), slice(across[j], across[j + 1]))
            kept = inputs[block].copy()
            inputs[block] = nothing[block]
            increase[:, i, j] = np.abs(fitted.predict(inputs) - true).mean(axis=0) - whole
            inputs[block] = kept
        progress("which pixels decide", i + 1, len(down) - 1)
    return DecidingPixels(increase, len(chosen))
