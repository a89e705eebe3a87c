"""The guard: is this image of the kind the estimator was calibrated on, and has the sensor drifted?

Applicability is judged on a thumbnail of the prepared image. Principal components of the calibration's
thumbnails span what was seen; an image is far when it lies far along them (Hotelling's T²) or off them
(the squared residual Q). See Jackson & Mudholkar, Technometrics 21:341 (1979),
doi:10.1080/00401706.1979.10489779. Both are divided by the limit that a stated share of frames kept out
of the fit stays below, and the larger one counts.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from palpate.core.errors import CertificateError, InputError
from palpate.core.reading import Drift

THUMBNAIL_PX = 32
FLOOR_GREY_LEVELS = 0.5
"""Two averages of one scene never agree better than this, whatever a few references suggest."""

FEW_REFERENCES = 5
DRIFT_LIMIT_OF_FEW = 3.0
"""Fewer no-contact frames than five say little of how far such frames wander: three times their spread."""

Prepared = UInt8[np.ndarray, "h w c"]
Thumbnail = Float32[np.ndarray, " k"]


def thumbnail(prepared: Prepared) -> Thumbnail:
    """Area means of a prepared image, at most 32 px a side, grey levels."""
    height, width, channels = prepared.shape
    size = (min(width, THUMBNAIL_PX), min(height, THUMBNAIL_PX))
    small = cv2.resize(prepared, size, interpolation=cv2.INTER_AREA).reshape(size[1], size[0], channels)
    return small.astype(np.float32).ravel()


def thumbnails(images: Iterable[Prepared]) -> Float32[np.ndarray, "n k"]:
    """Thumbnails of many prepared images."""
    return np.stack([thumbnail(image) for image in images])


@dataclass(frozen=True, slots=True)
class Span:
    """What the calibration's thumbnails span.

    Attributes:
        mean: their mean ``[k]``.
        axes: principal axes ``[m k]``, orthonormal.
        spread: standard deviation along each axis ``[m]``.
    """

    mean: Float32[np.ndarray, " k"]
    axes: Float32[np.ndarray, "m k"]
    spread: Float32[np.ndarray, " m"]

    @classmethod
    def of(cls, thumbs: Float32[np.ndarray, "n k"], kept: float = 0.95) -> Span:
        """Span the axes that carry a share `kept` of the variance, at most a third as many as frames."""
        mean = thumbs.mean(axis=0)
        _, singular, axes = np.linalg.svd(thumbs - mean, full_matrices=False)
        variance = singular**2 / max(len(thumbs) - 1, 1)
        wanted = int(np.searchsorted(np.cumsum(variance), kept * variance.sum())) + 1
        m = max(1, min(wanted, len(thumbs) // 3, len(variance)))
        # An axis without variance says nothing; one grey level is what a camera resolves.
        spread = np.sqrt(np.maximum(variance[:m], 1.0))
        return cls(mean, axes[:m].astype(np.float32), spread.astype(np.float32))

    def distances(self, thumbs: Float32[np.ndarray, "n k"]) -> Float[np.ndarray, "n 2"]:
        """Mean squared T per axis, and mean squared residual per thumbnail pixel, of each thumbnail."""
        centred = thumbs - self.mean
        along = centred @ self.axes.T
        t2 = np.mean((along / self.spread) ** 2, axis=1)
        residual = centred - along @ self.axes
        return np.stack([t2, np.mean(residual**2, axis=1)], axis=1)


@dataclass(frozen=True, slots=True)
class Guard:
    """Judges images against what a calibration saw.

    Attributes:
        span: what was seen.
        limits: the two distances that calibration frames stay below.
        reference: mean thumbnail of the untouched sensor ``[k]``; None where none was recorded.
        reference_spread: how far its own no-contact thumbnails lie from their mean [grey levels, rms].
        drift_limit: the drift statistic above which the calibration is stale.
    """

    span: Span
    limits: Float[np.ndarray, " 2"]
    reference: Float32[np.ndarray, " k"] | None
    reference_spread: float
    drift_limit: float

    def atypicality(self, prepared: Prepared) -> float:
        """How far the image is from what was calibrated on; beyond 1 it should not be trusted."""
        distances = self.span.distances(thumbnail(prepared)[None, :])[0]
        return float(np.sqrt(np.max(distances / self.limits)))

    def drift(self, untouched: Prepared) -> Drift | None:
        """How far the untouched sensor has moved since calibration; None where that had no view of it."""
        if self.reference is None:
            return None
        moved = np.sqrt(np.mean((thumbnail(untouched) - self.reference) ** 2))
        return Drift(float(moved / self.reference_spread), self.drift_limit)

    def save(self, path: Path) -> None:
        """Write the guard as plain arrays."""
        absent = np.empty(0, np.float32)
        np.savez(
            path,
            mean=self.span.mean,
            axes=self.span.axes,
            spread=self.span.spread,
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
            span = Span(parts["mean"], parts["axes"], parts["spread"])
            reference = parts["reference"] if parts["reference"].size else None
            spread, limit = (float(v) for v in parts["drift"])
            guard = cls(span, parts["limits"], reference, spread, limit)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as e:
            raise CertificateError(f"{path} is not a guard that palpate wrote ({e}); calibrate again") from e
        guard._check(path)
        return guard

    def _check(self, path: Path) -> None:
        m, k = self.span.axes.shape if self.span.axes.ndim == 2 else (-1, -1)
        fits = self.span.mean.shape == (k,) and self.span.spread.shape == (m,) and self.limits.shape == (2,)
        if not fits or (self.reference is not None and self.reference.shape != (k,)):
            raise CertificateError(f"{path}: the guard's arrays do not fit each other; calibrate again")


def fit_guard(
    thumbs: Float32[np.ndarray, "n k"],
    folds: Iterable[np.ndarray],
    untouched: Float32[np.ndarray, "r k"],
    *,
    false_alarms: float = 0.01,
    most: int = 4000,
    seed: int = 0,
) -> Guard:
    """Span the thumbnails, and set the limits from frames kept out of the span.

    Args:
        thumbs: of every calibration frame.
        folds: held-out rows of each fold, whole groups together; the limits come from them.
        untouched: thumbnails of the no-contact frames; may be empty.
        false_alarms: share of good frames that either distance may put beyond its limit.
        most: frames a span is computed from, at most.
        seed: of the draw when there are more.

    Raises:
        InputError: fewer than six frames.
    """
    if len(thumbs) < 6:
        raise InputError(f"{len(thumbs)} frames are too few to learn what frames look like; record 6 or more")
    rng = np.random.default_rng(seed)

    def drawn(rows: np.ndarray) -> np.ndarray:
        return rows if len(rows) <= most else rng.choice(rows, most, replace=False)

    every = np.arange(len(thumbs))
    kept_out = np.concatenate(
        [
            Span.of(thumbs[drawn(np.setdiff1d(every, held))]).distances(thumbs[held])
            for held in folds
            if len(held) < len(thumbs)
        ]
    )
    limits = np.quantile(kept_out, 1 - false_alarms, axis=0, method="higher")
    reference, spread, drift_limit = _untouched(untouched)
    return Guard(Span.of(thumbs[drawn(every)]), np.maximum(limits, 1e-3), reference, spread, drift_limit)


def _untouched(untouched: Float32[np.ndarray, "r k"]) -> tuple[np.ndarray | None, float, float]:
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
