"""The guard: is this image of the kind the estimator was calibrated on, and has the sensor drifted?

A thumbnail of the prepared image is held against the nearest one of the calibration. Pixels are weighed by
what they differ between neighbours, so that a corner that never changes counts more than one that always
does. Two distances are judged: the plain one, and its ratio to the neighbour's own distance from the rest
of the calibration, since near the untouched skin images lie closer together than under a deep press (the
idea of the local outlier factor: Breunig et al., SIGMOD 2000, doi:10.1145/335191.335388). Either is too
far beyond the limit that a stated share of calibration frames, each held against other groups, stays below.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from palpate.core.errors import CertificateError, InputError
from palpate.core.reading import Drift

THUMBNAIL_VALUES = 1024
"""A thumbnail holds about this many values, in one channel or in three."""

FLOOR_GREY_LEVELS = 0.5
"""Two averages of one scene never agree better than this, whatever a few references suggest."""

FEW_REFERENCES = 5
DRIFT_LIMIT_OF_FEW = 3.0
"""Fewer no-contact frames than five say little of how far such frames wander: three times their spread."""

Prepared = UInt8[np.ndarray, "h w c"]
Thumbnails = Float32[np.ndarray, "_ k"]
Distances = Float32[np.ndarray, " _"]


def thumbnail(prepared: Prepared) -> Float32[np.ndarray, " k"]:
    """Area means of a prepared image, about as many values whatever its channels, grey levels."""
    height, width, channels = prepared.shape
    side = math.isqrt(THUMBNAIL_VALUES // channels)
    size = (min(width, side), min(height, side))
    return cv2.resize(prepared, size, interpolation=cv2.INTER_AREA).astype(np.float32).ravel()


def thumbnails(images: Iterable[Prepared]) -> Thumbnails:
    """Thumbnails of many prepared images."""
    return np.stack([thumbnail(image) for image in images])


@dataclass(frozen=True)
class Neighbours:
    """The calibration's thumbnails, and the measure of distance between them.

    Attributes:
        thumbs: of the calibration's frames ``[n k]``.
        stray: what each pixel differs by between neighbours, at least a grey level ``[k]``.
        own: each one's distance to the nearest of other groups ``[n]``.
    """

    thumbs: Thumbnails
    stray: Float32[np.ndarray, " k"]
    own: Distances

    def nearest(self, others: Thumbnails) -> tuple[np.ndarray, Distances]:
        """Row and distance of the nearest thumbnail to each of `others`; 1 is usual between neighbours."""
        return self._index.nearest(others / self.stray)

    def strangeness(self, others: Thumbnails) -> Float[np.ndarray, "_ 2"]:
        """Distance to the nearest, and its ratio to that one's own."""
        rows, distance = self.nearest(others)
        return np.stack([distance, distance / self.own[rows]], axis=1).astype(np.float64)

    @cached_property
    def _index(self) -> _Index:
        return _Index(self.thumbs / self.stray)


class _Index:
    """Rows to search for the nearest of, their squares summed once."""

    def __init__(self, rows: Thumbnails) -> None:
        self.rows, self.squares = rows, np.sum(rows**2, axis=1)

    def nearest(self, others: Thumbnails) -> tuple[np.ndarray, Distances]:
        found = np.argmin(self.squares - 2 * others @ self.rows.T, axis=1)
        return found, np.sqrt(np.mean((others - self.rows[found]) ** 2, axis=1))


def neighbours(thumbs: Thumbnails, folds: Sequence[np.ndarray]) -> Neighbours:
    """Learn the measure of distance, and each thumbnail's own distance, across folds only."""
    apart = np.empty_like(thumbs)
    for held, others in _sides(len(thumbs), folds):
        rows, _ = _Index(thumbs[others]).nearest(thumbs[held])
        apart[held] = thumbs[held] - thumbs[others][rows]
    stray = np.maximum(np.sqrt(np.mean(apart**2, axis=0)), 1.0)
    own = np.empty(len(thumbs), np.float32)
    for held, others in _sides(len(thumbs), folds):
        _, own[held] = _Index(thumbs[others] / stray).nearest(thumbs[held] / stray)
    # Grey levels are whole: no frame is nearer to another than rounding leaves it.
    return Neighbours(thumbs, stray, np.maximum(own, np.float32(0.05)))


def _sides(n: int, folds: Sequence[np.ndarray]) -> Iterable[tuple[np.ndarray, np.ndarray]]:
    every = np.arange(n)
    return [(held, np.setdiff1d(every, held)) for held in folds if len(held)]


@dataclass(frozen=True, slots=True)
class Guard:
    """Judges images against what a calibration saw.

    Attributes:
        seen: the calibration's thumbnails.
        limits: of distance and of its ratio, see `Neighbours.strangeness`.
        reference: mean thumbnail of the untouched sensor ``[k]``; None where none was recorded.
        reference_spread: how far its own no-contact thumbnails lie from their mean [grey levels, rms].
        drift_limit: the drift statistic above which the calibration is stale.
    """

    seen: Neighbours
    limits: Float[np.ndarray, " 2"]
    reference: Float32[np.ndarray, " k"] | None
    reference_spread: float
    drift_limit: float

    def atypicality(self, prepared: Prepared) -> float:
        """How far the image is from all that was calibrated on; beyond 1 it should not be trusted."""
        return float(np.max(self.seen.strangeness(thumbnail(prepared)[None, :])[0] / self.limits))

    def drift(self, untouched: Prepared) -> Drift | None:
        """How far the untouched sensor has moved since calibration; None where that had no view of it."""
        if self.reference is None:
            return None
        moved = np.sqrt(np.mean((thumbnail(untouched) - self.reference) ** 2))
        return Drift(float(moved / self.reference_spread), self.drift_limit)

    def save(self, path: Path) -> None:
        """Write the guard as plain arrays."""
        absent = np.empty(0, np.float32)
        np.savez_compressed(
            path,
            thumbs=np.round(self.seen.thumbs).astype(np.uint8),
            stray=self.seen.stray,
            own=self.seen.own,
            limits=self.limits,
            reference=absent if self.reference is None else self.reference,
            drift=np.array([self.reference_spread, self.drift_limit]),
        )

    @classmethod
    def load(cls, path: Path) -> Guard:
        """Read a guard that `save` wrote.

        Raises:
            CertificateError: the file is not one.
        """
        try:
            # Opened here, since numpy leaves a file that is no archive to the garbage collector.
            with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
                parts = {name: held[name] for name in held.files}
            seen = Neighbours(parts["thumbs"].astype(np.float32), parts["stray"], parts["own"])
            reference = parts["reference"] if parts["reference"].size else None
            spread, limit = (float(v) for v in parts["drift"])
            guard = cls(seen, parts["limits"], reference, spread, limit)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as e:
            raise CertificateError(f"{path} is not a guard that palpate wrote ({e}); calibrate again") from e
        guard._check(path)
        return guard

    def _check(self, path: Path) -> None:
        n, k = self.seen.thumbs.shape if self.seen.thumbs.ndim == 2 else (-1, -1)
        fits = self.seen.stray.shape == (k,) and self.seen.own.shape == (n,) and self.limits.shape == (2,)
        if not fits or (self.reference is not None and self.reference.shape != (k,)):
            raise CertificateError(f"{path}: the guard's arrays do not fit each other; calibrate again")


def fit_guard(
    thumbs: Thumbnails,
    folds: Sequence[np.ndarray],
    untouched: Thumbnails,
    *,
    false_alarms: float = 0.005,
    most: int = 2000,
    seed: int = 0,
) -> Guard:
    """Keep thumbnails, and set the limits from how far frames lie from those of other folds.

    Args:
        thumbs: of every calibration frame.
        folds: held-out rows of each fold, whole groups together.
        untouched: thumbnails of the no-contact frames; may be empty.
        false_alarms: share of good frames that either distance may put beyond its limit.
        most: frames kept, at most.
        seed: of the draw when there are more.

    Raises:
        InputError: fewer than six frames.
    """
    if len(thumbs) < 6:
        raise InputError(f"{len(thumbs)} frames are too few to learn what frames look like; record 6 or more")
    fold = np.empty(len(thumbs), np.int64)
    for k, held in enumerate(folds):
        fold[held] = k
    if len(thumbs) > most:
        drawn = np.sort(np.random.default_rng(seed).choice(len(thumbs), most, replace=False))
        thumbs, fold = thumbs[drawn], fold[drawn]
    parts = [np.flatnonzero(fold == k) for k in np.unique(fold)]
    thumbs = np.round(thumbs)
    seen = neighbours(thumbs, parts)
    held_out = np.empty((len(thumbs), 2))
    for held, others in _sides(len(thumbs), parts):
        held_out[held] = Neighbours(thumbs[others], seen.stray, seen.own[others]).strangeness(thumbs[held])
    limits = np.quantile(held_out, 1 - false_alarms, axis=0, method="higher")
    return Guard(seen, limits, *_untouched(untouched))


def _untouched(untouched: Thumbnails) -> tuple[np.ndarray | None, float, float]:
    """Mean no-contact thumbnail, the spread around it, and the limit: half as far again as the widest."""
    r = len(untouched)
    if r == 0:
        return None, FLOOR_GREY_LEVELS, DRIFT_LIMIT_OF_FEW
    mean = untouched.mean(axis=0)
    # With r frames the mean follows each of them; r / (r - 1) undoes that.
    moved = np.sqrt(np.mean((untouched - mean) ** 2, axis=1)) * (r / (r - 1) if r > 1 else 1.0)
    spread = max(float(np.median(moved)), FLOOR_GREY_LEVELS)
    widest = 1.5 * max(float(moved.max()) / spread, 1.0)
    return mean, spread, widest if r >= FEW_REFERENCES else max(widest, DRIFT_LIMIT_OF_FEW)
