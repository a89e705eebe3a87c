"""Contact area of each frame from the motion of the pins, calibrated on references of known area.

log A is a polynomial in a few measures of a frame: ring size and stretch of the center (`contact_region`),
or, if the ring is truncated by the field's edge, the pins' motion along the references' principal directions.

Contact region from the field of pins: ring, flattening, cells, ellipse.

Under the contact the skin lies flat and its pins tilt outward, most near the contact's edge. The ring of
greatest outward motion lies slightly inside the edge (for pins with a length), and the stretch du_r/dr at the
center measures the flattening of the dome. A softer specimen has a larger ring and, at equal force, less
stretch.

Middle and edge of the field of reference pins, from the lattice, even if some pins are hidden.

Algorithm 1 of the compliance report takes the circle about the middle pin through the outermost ones. Hidden
pins are placed by a smooth map from layout to image, because one missing pin changes that circle by tens of
percent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats
from scipy.optimize import minimize_scalar
from scipy.spatial import Voronoi

from palpate.core import Float, InputError, Int, RangeError, ndarray
from palpate.estimators.lattice.ring_layout import MAX_RINGS, ring_of, ring_sites
from palpate.estimators.pins import PinTracks

POWERS = (1, 3, 5, 7, 9, 11)  # of the radius: outward motion is odd in it
WITHIN = 0.4  # of the field's radius: the middle whose stretch is taken
MIN_PINS = 12
SURFACE_DEGREE = 6
RAYS = 72

Points = Float[ndarray, "p 2"]


@dataclass(frozen=True)
class Field:
    """Positions of the reference pins, and their motion [px]; only pins that were found."""

    at_px: Points
    moved_px: Points

    @classmethod
    def between(cls, untouched: PinTracks, now: PinTracks) -> Field:
        """Return the motion of the pins found in both frames."""
        both = untouched.found & now.found
        if both.sum() < MIN_PINS:
            raise InputError(
                f"{int(both.sum())} of {len(both)} pins are left; {MIN_PINS} are needed", code="pins-lost"
            )
        return cls(untouched.xy_px[both], (now.xy_px - untouched.xy_px)[both])

    @cached_property
    def middle_px(self) -> Float[ndarray, 2]:
        """Center of the contact, where the field does not move, from a linear fit [px]."""
        centre = self.at_px.mean(axis=0)
        for _ in range(3):
            gradient, shift = self._linear(centre)
            if abs(np.linalg.det(gradient)) < 1e-12:
                break
            step = -np.linalg.solve(gradient, shift)
            size = np.hypot(*step)
            centre = centre + step * min(1.0, 0.3 * self.radius_px / max(size, 1e-12))
        return centre

    @property
    def radius_px(self) -> float:
        return float(np.hypot(*(self.at_px - self.at_px.mean(axis=0)).T).max())

    def stretch(self) -> Float[ndarray, "2 2"]:
        """Return the motion gradient at the center; half its trace is the mean stretch."""
        return self._linear(self.middle_px)[0]

    def _linear(self, centre: Float[ndarray, 2]) -> tuple[Float[ndarray, "2 2"], Float[ndarray, 2]]:
        """Gradient and motion at the center; a cubic term absorbs the curvature."""
        off = self.at_px - centre
        near = np.hypot(*off.T) < WITHIN * self.radius_px
        if near.sum() < MIN_PINS // 2:
            near = np.argsort(np.hypot(*off.T))[:MIN_PINS]
        x = off[near] / self.radius_px
        columns = np.column_stack([np.ones(len(x)), x, x * (x**2).sum(axis=1, keepdims=True)])
        fit, *_ = np.linalg.lstsq(columns, self.moved_px[near], rcond=None)
        return fit[1:3].T / self.radius_px, fit[0]


def outward(field: Field) -> tuple[Float[ndarray, " p"], Float[ndarray, " p"]]:
    """Return the distance of every pin from the center, and its outward motion [px]."""
    off = field.at_px - field.middle_px
    r = np.hypot(*off.T)
    away = np.divide((off * field.moved_px).sum(axis=1), r, out=np.zeros_like(r), where=r > 1e-9)
    return r, away


def ring_px(field: Field) -> float:
    """Return the radius at which an odd polynomial through all pins moves outward most [px], or NaN."""
    r, away = outward(field)
    far = r.max()
    fit, *_ = np.linalg.lstsq((r[:, None] / far) ** np.array(POWERS), away, rcond=None)

    def inward(x: float) -> float:
        return -float(fit @ x ** np.array(POWERS))

    grid = np.linspace(0.05, 1.0, 191)
    best = int(np.argmax(grid[:, None] ** np.array(POWERS) @ fit))
    if best in (0, len(grid) - 1):
        return float("nan")
    optimum = minimize_scalar(inward, bounds=(grid[best - 1], grid[best + 1]), method="bounded")
    return float(optimum.x * far)


@dataclass(frozen=True)
class RigidPlateStretch:
    """Stretch on a rigid plate as a polynomial of the ring radius."""

    coefficients: Float[ndarray, " k"]
    ring_px: tuple[float, float]

    @classmethod
    def fitted(cls, rings: Float[ndarray, " n"], stretches: Float[ndarray, " n"]) -> RigidPlateStretch:
        good = np.isfinite(rings) & np.isfinite(stretches)
        if good.sum() < 6:
            raise InputError(
                f"{int(good.sum())} rings on the rigid plate; 6 are needed", code="too-few-rings"
            )
        return cls(
            np.polyfit(rings[good], stretches[good], 3), (float(rings[good].min()), float(rings[good].max()))
        )

    def ratio(self, ring: float, stretch: float) -> float:
        """Return the stretch over that of a rigid plate with the same ring: 1 for rigid, less for soft."""
        low, high = self.ring_px
        if not 0.98 * low <= ring <= 1.02 * high:
            raise RangeError(
                f"a ring of {ring:.4g} px; known are {low:.4g} to {high:.4g} px", code="ring-outside-range"
            )
        return float(stretch / np.polyval(self.coefficients, ring))


def cell_growth(field: Field) -> Float[ndarray, " p"]:
    """Return the log area ratio of every pin's Voronoi cell to the reference frame; NaN at the border."""
    before, after = (_cell_areas(xy) for xy in (field.at_px, field.at_px + field.moved_px))
    return np.log(after / before)


def _cell_areas(xy: Points) -> Float[ndarray, " p"]:
    cells = Voronoi(xy)
    areas = np.full(len(xy), np.nan)
    low, high = xy.min(axis=0), xy.max(axis=0)
    for i, region in enumerate(cells.point_region):
        corners = cells.regions[region]
        if -1 in corners or not corners:
            continue
        x, y = cells.vertices[corners].T
        if min(x.min() - low[0], y.min() - low[1], high[0] - x.max(), high[1] - y.max()) >= 0:
            areas[i] = abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2
    return areas


@dataclass(frozen=True)
class Ellipse:
    """Ring of an inclined contact.

    Attributes:
        axes_px: Half axes, the larger first [px].
        angle_rad: Angle of the larger axis from x towards y [rad].
        visible_share: Ratio of directions in which the ring lies inside the field of pins.
    """

    centre_px: tuple[float, float]
    axes_px: tuple[float, float]
    angle_rad: float
    visible_share: float


def ring_ellipse(field: Field) -> Ellipse:
    """Return an ellipse through the positions of greatest outward motion, by direction."""
    centre = field.middle_px
    x = (field.at_px - centre) / field.radius_px
    fit, *_ = np.linalg.lstsq(_products(x), field.moved_px, rcond=None)
    reach = _reach(field, centre)
    points = []
    for angle, far in zip(np.arange(RAYS) * 2 * np.pi / RAYS, reach, strict=True):
        direction = np.array([np.cos(angle), np.sin(angle)])
        r = np.linspace(0.15, 1.0, 120) * far
        away = _products(r[:, None] * direction / field.radius_px) @ fit @ direction
        best = int(np.argmax(away))
        if 0 < best < len(r) - 1:
            points.append(r[best] * direction)
    if len(points) < RAYS // 3:
        raise InputError(
            f"the ring lies inside the field of pins in {len(points)} of {RAYS} directions; a third is needed"
        )
    return _through(np.array(points), centre, len(points) / RAYS)


def _products(x: Points) -> Float[ndarray, "p k"]:
    """Products of powers of x and y up to the degree."""
    powers = [(i, j) for i in range(SURFACE_DEGREE + 1) for j in range(SURFACE_DEGREE + 1 - i)]
    return np.stack([x[:, 0] ** i * x[:, 1] ** j for i, j in powers], axis=1)


def _reach(field: Field, centre: Float[ndarray, 2]) -> Float[ndarray, " rays"]:
    """Distance of the outermost pins from the center, by direction."""
    off = field.at_px - centre
    angles = np.arange(RAYS) * 2 * np.pi / RAYS
    along = off @ np.stack([np.cos(angles), np.sin(angles)])
    return along.max(axis=0)


def _through(points: Points, centre: Float[ndarray, 2], visible_share: float) -> Ellipse:
    scale = np.hypot(*points.T).mean()
    x, y = (points / scale).T
    design = np.stack([x * x, x * y, y * y, x, y], axis=1)
    (a, b, c, d, e), *_ = np.linalg.lstsq(design, np.ones(len(x)), rcond=None)
    form = np.array([[a, b / 2], [b / 2, c]])
    if not (np.linalg.eigvalsh(form) > 0).all():
        raise InputError("the ring's points lie on no ellipse; too much of it is outside the field of pins")
    middle = -0.5 * np.linalg.solve(form, [d, e])
    level = 1 + middle @ form @ middle
    values, vectors = np.linalg.eigh(form / level)
    axes = scale / np.sqrt(values)
    at = centre + scale * middle
    return Ellipse(
        (float(at[0]), float(at[1])),
        (float(axes[0]), float(axes[1])),
        float(np.arctan2(vectors[1, 0], vectors[0, 0])),
        visible_share,
    )


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
