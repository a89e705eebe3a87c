"""Contact area of each frame from the motion of the pins, calibrated on references of known area.

log A is a polynomial in the pins' motion along the references' principal directions.

Middle and edge of the field of reference pins, from the lattice, even if some pins are hidden.

Algorithm 1 of the compliance report takes the circle about the middle pin through the outermost ones. Hidden
pins are placed by a smooth map from layout to image, because one missing pin changes that circle by tens of
percent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from palpate.core import Float, InputError, Int, ndarray
from palpate.estimators.lattice.ring_layout import MAX_RINGS, ring_of, ring_sites

Points = Float[ndarray, "p 2"]

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


DEGREES = (5, 40), (3, 20), (1, 6)  # of the map, and pins that it needs
ALIKE = 1e-6  # pitches, tolerance of equal distances of the outermost positions


@dataclass(frozen=True)
class PinField:
    """Position of the middle pin and of the outermost ones: six corners of a hexagon, or the last ring."""

    middle: Float[ndarray, 2]
    edge: Float[ndarray, "e 2"]

    @property
    def radius(self) -> float:
        """Radius of the circle: root mean square distance of the outermost pins from the middle."""
        return float(np.sqrt(((self.edge - self.middle) ** 2).sum(axis=1).mean()))

    @property
    def farthest(self) -> float:
        return float(np.hypot(*(self.edge - self.middle).T).max())

    @property
    def area(self) -> float:
        """Area of that circle, in the square of the unit of the places."""
        return np.pi * self.radius**2


def pin_field(places: Points, cells: Int[ndarray, "p 2"]) -> PinField:
    """Return middle and edge of reference pins.

    Args:
        places: Pin positions in any plane; NaN if lost.
        cells: Lattice cells, (0, 0) being the middle (`PinTracks.cells`).
    """
    seen = np.isfinite(places).all(axis=1)
    at, names = places[seen], cells[seen]
    if seen.sum() < DEGREES[-1][1]:
        raise InputError(
            f"{int(seen.sum())} pins are visible; {DEGREES[-1][1]} are needed", code="too-few-pins"
        )
    rings = int(ring_of(names).max())
    if rings > MAX_RINGS:
        raise InputError(f"{rings} rings of pins; up to {MAX_RINGS} are known")
    whole = ring_sites().cells[: ring_sites().upto(rings)]
    planes = {kind: ring_sites(kind).places[: len(whole)] for kind in ("hexagonal", "rings")}
    number = {cell: i for i, cell in enumerate(map(tuple, whole.tolist()))}
    own = np.array([number[cell] for cell in map(tuple, names.tolist())])
    degree = next(degree for degree, least in DEGREES if len(at) >= least)
    fits = {kind: _fit(plane[own], at, degree) for kind, plane in planes.items()}
    kind = min(fits, key=lambda one: fits[one][1])
    expected = _plane_terms(planes[kind], degree) @ fits[kind][0]
    expected[own] = at
    away = np.hypot(*planes[kind].T)
    return PinField(expected[0], expected[away > away.max() - ALIKE])


def _fit(plane: Points, at: Points, degree: int) -> tuple[Float[ndarray, "k 2"], float]:
    """Coefficients of the map from layout to image, and its squared residual."""
    terms = _plane_terms(plane, degree)
    fit, *_ = np.linalg.lstsq(terms, at, rcond=None)
    return fit, float(((terms @ fit - at) ** 2).sum())


def _plane_terms(plane: Points, degree: int) -> Float[ndarray, "p k"]:
    x, y = (plane / MAX_RINGS).T
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)
