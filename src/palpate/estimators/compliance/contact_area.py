"""Contact area of each frame from the motion of the pins, calibrated on references of known area.

log A is a polynomial in a few measures of a frame: ring size and stretch of the center (`contact_region`),
or, if the ring is truncated by the field's edge, the pins' motion along the references' principal directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from palpate.core import Float, InputError, ndarray
from palpate.estimators.compliance.contact_region import Field, ring_px

MOTIONS = 8
SQUARES = 3  # of the first measures
RIDGE = 1e-4  # of the mean square of a measure
MIN_FRAMES, MIN_REFERENCES = 30, 3

Measures = Float[ndarray, "f k"]
AnyMeasures = Float[ndarray, "_ k"]  # of trials, which differ in how many frames they have


@dataclass(frozen=True)
class AreaFit:
    """log A as a polynomial in standardized measures.

    Attributes:
        coefficients: Coefficients of 1, the measures, and the products of the first of them.
        spread: RMS error of log A of the worst left-out reference; NaN for fewer than three references.
        range_m2: Least and greatest reference area [m^2].
    """

    middle: Float[ndarray, " k"]
    scale: Float[ndarray, " k"]
    coefficients: Float[ndarray, " c"]
    spread: float
    range_m2: tuple[float, float]

    def at(self, measures: Measures, coverage: float = 0.9) -> Float[ndarray, "f 3"]:
        """Return the area of every frame with its interval (value, low, high); NaN without measures [m^2]."""
        log_a = _terms((measures - self.middle) / self.scale) @ self.coefficients
        half = stats.norm.ppf((1 + coverage) / 2) * self.spread
        return np.exp(np.stack([log_a, log_a - half, log_a + half], axis=1))


def fit_area(
    measures: Sequence[AnyMeasures], area_m2: Sequence[Float[ndarray, " _"]], reference: Sequence[int]
) -> AreaFit:
    """Fit the area to references.

    Args:
        measures: Measures of each trial's frames.
        area_m2: True area of the same frames; NaN if unknown [m^2].
        reference: Index of each trial's reference.
    """
    masks = [
        np.isfinite(one).all(axis=1) & np.isfinite(a) & (np.nan_to_num(a) > 0)
        for one, a in zip(measures, area_m2, strict=True)
    ]
    if sum(int(one.sum()) for one in masks) < MIN_FRAMES:
        raise InputError(
            f"{sum(int(one.sum()) for one in masks)} reference frames of known area; give {MIN_FRAMES}",
            code="too-few-frames",
        )
    x = [one[good] for one, good in zip(measures, masks, strict=True)]
    y = [np.log(a[good]) for a, good in zip(area_m2, masks, strict=True)]
    everything = np.concatenate(x)
    middle, scale = everything.mean(axis=0), everything.std(axis=0) + 1e-12
    z = [(one - middle) / scale for one in x]
    errors = _left_out(z, y, np.asarray(reference))
    areas = np.exp(np.concatenate(y))
    return AreaFit(middle, scale, _solved(z, y), errors, (float(areas.min()), float(areas.max())))


def _left_out(z: list[AnyMeasures], y: list[ndarray], reference: ndarray) -> float:
    """RMS error of log A of left-out trials, of the worst reference."""
    squares: dict[int, list[float]] = {}
    for i, (own, log_a) in enumerate(zip(z, y, strict=True)):
        others = [j for j in range(len(z)) if j != i]
        c = _solved([z[j] for j in others], [y[j] for j in others])
        squares.setdefault(int(reference[i]), []).append(float(np.mean((_terms(own) @ c - log_a) ** 2)))
    worst = float(np.sqrt(max(np.mean(one) for one in squares.values())))
    return worst if len(squares) >= MIN_REFERENCES else float("nan")


def left_out_areas(
    measures: Sequence[AnyMeasures], area_m2: Sequence[Float[ndarray, " _"]]
) -> list[Float[ndarray, " _"]]:
    """Return the area of every frame of every trial by a fit to all other trials [m^2]."""
    masks = [
        np.isfinite(one).all(axis=1) & (np.nan_to_num(a) > 0)
        for one, a in zip(measures, area_m2, strict=True)
    ]
    everything = np.concatenate([one[good] for one, good in zip(measures, masks, strict=True)])
    middle, scale = everything.mean(axis=0), everything.std(axis=0) + 1e-12
    z = [(one - middle) / scale for one in measures]
    fitted = [one[good] for one, good in zip(z, masks, strict=True)]
    log_a = [np.log(a[good]) for a, good in zip(area_m2, masks, strict=True)]
    return [
        np.exp(_terms(own) @ _solved(fitted[:i] + fitted[i + 1 :], log_a[:i] + log_a[i + 1 :]))
        for i, own in enumerate(z)
    ]


def _solved(z: list[AnyMeasures], y: list[ndarray]) -> Float[ndarray, " c"]:
    X = _terms(np.concatenate(z))
    penalty = np.sqrt(RIDGE * len(X)) * np.eye(X.shape[1])
    penalty[0, 0] = 0.0
    fit, *_ = np.linalg.lstsq(
        np.concatenate([X, penalty]), np.concatenate([*y, np.zeros(X.shape[1])]), rcond=None
    )
    return np.asarray(fit)


def _terms(z: Measures) -> Float[ndarray, "f c"]:
    first = range(min(SQUARES, z.shape[1]))
    products = [z[:, i] * z[:, j] for i in first for j in first if i <= j]
    return np.column_stack([np.ones(len(z)), z, *products])


@dataclass(frozen=True)
class Motions:
    """Mean and principal directions (orthonormal, widest first) of the references' pin motions [px]."""

    middle: Float[ndarray, "p 2"]
    directions: Float[ndarray, "k p 2"]

    def of(self, moved_px: Float[ndarray, "f p 2"]) -> Measures:
        """Return the measures of frames; lost pins (NaN) are omitted."""
        tracked = np.isfinite(moved_px).all(axis=(0, 2)) & np.isfinite(self.middle).all(axis=1)
        off = (moved_px - self.middle)[:, tracked].reshape(len(moved_px), -1)
        measures, *_ = np.linalg.lstsq(
            self.directions[:, tracked].reshape(len(self.directions), -1).T, off.T, rcond=None
        )
        return np.asarray(measures.T)


def fit_motions(moved_px: Sequence[Float[ndarray, "_ p 2"]], count: int = MOTIONS) -> Motions:
    """Fit the principal directions to the references' frames."""
    frames = np.concatenate(moved_px)
    if len(frames) < MIN_FRAMES:
        raise InputError(f"{len(frames)} frames of references; give {MIN_FRAMES}", code="too-few-frames")
    tracked = np.isfinite(frames).all(axis=(0, 2))
    middle = frames.mean(axis=0)
    off = np.where(tracked[:, None], frames - middle, 0.0).reshape(len(frames), -1)
    directions = np.linalg.svd(off, full_matrices=False)[2][:count]
    return Motions(np.where(tracked[:, None], middle, np.nan), directions.reshape(-1, *middle.shape))


def ring_measures(untouched_px: Float[ndarray, "p 2"], moved_px: Float[ndarray, "f p 2"]) -> Measures:
    """Return log ring radius and log stretch of every frame; NaN without a ring."""
    measures = np.full((len(moved_px), 2), np.nan)
    for i, motion in enumerate(moved_px):
        tracked = np.isfinite(motion).all(axis=1)
        field = Field(untouched_px[tracked], motion[tracked])
        ring, stretch = ring_px(field), float(np.trace(field.stretch()))
        if np.isfinite(ring) and stretch > 0:
            measures[i] = np.log([ring, stretch])
    return measures
