"""Modulus and radius of a touched object from force over displacement and force over contact area.

For a Hertz contact (`hertz_pairs`) P^(2/3) = c (d - d0) and A = k P^(2/3) give, for finger and object in
series,

    R = c k / pi,    E = 3/4 c^(3/2) / sqrt(R)

from which the finger's own values are subtracted. Results are marked invalid if the object accounts for less
than a fifth of the approach, because every error is then magnified more than fivefold.

Modulus and radius of an object from a press at fixed forces: a surface through references.

Measurements of a press form a vector y, which for references of known modulus E and radius R lies on y(s, c),

    s = 1 / (1 + E / E_0)    0 for a rigid object, towards 1 for softer ones,
    c = R_0 / R              0 for a flat one,

a polynomial through the means of their trials (generalized least squares in the small space of
`stiffness_curve`). The interval holds the scatter between trials, the model error from E_0 and the law of c,
and the error of predicting each reference from the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial import Delaunay

from palpate.core import Float, InputError, ndarray
from palpate.estimators.compliance.stiffness_curve import SmallSpace, Vectors, fit_small_space, softness
from palpate.mechanics.half_space.hertz import Body

MIN_SHARE = 0.2
DRAWS = 4000
MIN_SAMPLES = 5
FARTHEST = 20.0  # e-folds that a drawn slope is off at most: Student's tails of two presses have no end
OF_MODULUS, OF_RADIUS = 0.13, 0.25  # relative standard deviations per misfit of the finger
TOO_STIFF = (
    "the object yields {:.0%} of the approach; below {:.0%} its own part cannot be told from the finger's"
)

Samples = Float[ndarray, " _"]


@dataclass(frozen=True)
class PressCurves:
    """Loading samples of one press: force [N], approach from any origin [m], contact area [m^2]."""

    force_n: Samples
    approach_m: Samples
    area_m2: Samples


@dataclass(frozen=True)
class Finger:
    """Finger that touches, with relative standard deviations and its misfit to a Hertz body.

    Attributes:
        body: Its modulus over 1 - nu^2 and its radius.
        misfit: Relative difference of its modulus between lower and upper forces; 0 for a Hertz body.
    """

    body: Body
    modulus_spread: float = 0.0
    radius_spread: float = 0.0
    misfit: float = 0.0


@dataclass(frozen=True)
class TouchedObject:
    """Object by both cues.

    Attributes:
        modulus_pa, radius_m: Estimate, low, and high; the radius of a flat is infinite.
        share: Ratio of the approach that the object yields.
    """

    modulus_pa: tuple[float, float, float]
    radius_m: tuple[float, float, float]
    share: float
    coverage: float
    valid: bool
    why: str


def fit_finger(rigid: Sequence[PressCurves]) -> Finger:
    """Fit the Hertz pair that acts as the finger does in presses on a rigid plate.

    A tip whose skin is stiffer than its gel is no Hertz body. On virtual tips, the reciprocal modulus of an
    object in series has an RMS error of 0.13 times the misfit, which is counted as a standard deviation; the
    radius a quarter.
    """
    if not rigid:
        raise InputError("no press on a rigid plate; give one or more")
    c, k = np.array([_slopes(press) for press in rigid]).T
    E, R = _both(c.mean(), k.mean())
    of_c, of_k = _spread(rigid, c, k)
    misfit = float(np.mean([_misfit(press) for press in rigid]))
    return Finger(
        Body(float(E), float(R)),
        float(np.hypot(np.hypot(of_c, 0.5 * of_k), OF_MODULUS * misfit)),  # E goes with c / sqrt(k)
        float(np.hypot(np.hypot(of_c, of_k), OF_RADIUS * misfit)),
        misfit,
    )


def _misfit(press: PressCurves) -> float:
    """Relative difference of the moduli of the lower and the upper half of the forces."""
    low = press.force_n <= np.median(press.force_n)
    if min(low.sum(), (~low).sum()) < MIN_SAMPLES:
        return 0.0
    halves = [
        _both(*_slopes(PressCurves(press.force_n[half], press.approach_m[half], press.area_m2[half])))[0]
        for half in (low, ~low)
    ]
    return 1.0 - min(halves) / max(halves)


def invert_hertz(
    presses: Sequence[PressCurves], finger: Finger, rng: np.random.Generator, coverage: float = 0.9
) -> TouchedObject:
    """Invert Hertz contact for the object of one or several presses.

    Intervals come from draws of the slopes and of the finger: Student draws of the scatter between presses,
    or for a single press the scatter of its samples.
    """
    if not presses:
        raise InputError("no press; give one or more", code="no-presses")
    c, k = np.array([_slopes(press) for press in presses]).T
    spread = _spread(presses, c, k)
    several, shape = len(presses) > 1, (2, DRAWS)
    drawn = rng.standard_t(len(presses) - 1, shape) if several else rng.standard_normal(shape)
    off = np.clip(spread[:, None] * drawn, -FARTHEST, FARTHEST)
    draws = np.exp(np.log([c.mean(), k.mean()])[:, None] + off)
    E_f = finger.body.modulus_pa * np.exp(finger.modulus_spread * rng.standard_normal(DRAWS))
    R_f = finger.body.radius_m * np.exp(finger.radius_spread * rng.standard_normal(DRAWS))
    E, R = _both(c.mean(), k.mean())
    softness, curvature = 1 / E - 1 / finger.body.modulus_pa, 1 / R - 1 / finger.body.radius_m
    drawn_E, drawn_R = _both(*draws)
    tails = np.array([(1 - coverage) / 2, (1 + coverage) / 2])
    share = softness * E
    return TouchedObject(
        _inverse(softness, np.quantile(1 / drawn_E - 1 / E_f, tails)),
        _inverse(curvature, np.quantile(1 / drawn_R - 1 / R_f, tails)),
        float(share),
        coverage,
        bool(share >= MIN_SHARE),
        "" if share >= MIN_SHARE else TOO_STIFF.format(share, MIN_SHARE),
    )


def _both(c: Any, k: Any) -> tuple[Any, Any]:
    R = c * k / np.pi
    return 0.75 * c**1.5 / np.sqrt(R), R


def _slopes(press: PressCurves) -> tuple[float, float]:
    force, approach, area = (
        np.asarray(x, np.float64) for x in (press.force_n, press.approach_m, press.area_m2)
    )
    if not (force.shape == approach.shape == area.shape) or force.ndim != 1 or len(force) < MIN_SAMPLES:
        raise InputError(
            f"{force.size} forces, {approach.size} approaches, {area.size} areas; give {MIN_SAMPLES}",
            code="too-few-values",
        )
    if not (np.isfinite([force, approach, area]).all() and force.min() > 0 and area.min() > 0):
        raise InputError("forces and areas must be finite and above 0", code="not-positive")
    p = force ** (2 / 3)
    if np.ptp(approach) == 0 or np.ptp(force) == 0:
        raise InputError("neither force nor approach changes; give the loading", code="not-loading")
    c = float(_line(press)[0][0])
    if not c > 0:
        raise InputError("force falls as the approach grows; turn the sign of one of them", code="force-sign")
    return c, float(np.mean(area / p))


def _line(press: PressCurves) -> tuple[Samples, Float[ndarray, "2 2"]]:
    """P^(2/3) over the approach, and its covariance; weighted for even noise of the force."""
    return np.polyfit(press.approach_m, press.force_n ** (2 / 3), 1, w=np.cbrt(press.force_n), cov=True)


def _spread(presses: Sequence[PressCurves], c: Samples, k: Samples) -> Samples:
    """Relative standard errors of the mean slopes."""
    if len(presses) > 1:
        return np.array([x.std(ddof=1) / x.mean() / np.sqrt(len(x)) for x in (c, k)])
    (press,) = presses
    _, cov = _line(press)
    ratio = press.area_m2 / press.force_n ** (2 / 3)
    return np.array([np.sqrt(cov[0, 0]) / c[0], ratio.std(ddof=1) / np.sqrt(len(ratio)) / k[0]])


def _inverse(value: float, tails: Samples) -> tuple[float, float, float]:
    """Estimate, low, and high of the reciprocal; infinite if not positive."""
    mid, high, low = (1 / x if x > 0 else np.inf for x in (value, *tails))
    return float(mid), float(low), float(high)


TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1), (3, 0), (2, 1), (1, 2))  # powers of s and of c
MIN_REFERENCES = (
    1,
    2,
    2,
    2,
    2,
)  # rigid plate; moduli of flats; radii of rigid spheres; moduli, radii of soft spheres
STRAIGHT = (1.0, 0.0)
BENDS = ((0.5, 0.0), (2.0, 0.0), (1.0, 0.5))  # of E_0, and of c as c / (1 + bend c)
BOUNDS = ((-0.1, -0.5), (0.95, 2.0))  # bounds of the search, in s and c
GRID = np.array(
    list(product(np.linspace(-0.05, 0.9, 20), np.linspace(-0.2, 1.6, 19)))
)  # of places to begin at
SINGULAR = 1e-3  # relative singular value below which a term is not identifiable
NEEDS = (
    "to tell modulus and radius, spheres need other references beside them, of known modulus and radius: a "
    "rigid plate, soft flats of 2 moduli, rigid spheres of 2 radii, and soft spheres of 2 moduli and of 2 "
    "radii; there are {}, {}, {}, {} and {} (leave radius_mm empty for Hertz's law)"
)


@dataclass(frozen=True)
class Roundness:
    """Modulus and radius of a specimen.

    Attributes:
        modulus_pa: Modulus over 1 - nu^2, low, and high [Pa].
        radius_m: Radius of curvature, low, and high; inf for a flat [m].
        place, half: Position (s, c) on the surface and half-widths of its intervals.
        distance: Distance from the surface in standard deviations of a reference trial.
    """

    modulus_pa: tuple[float, float, float]
    radius_m: tuple[float, float, float]
    place: tuple[float, float]
    half: tuple[float, float]
    distance: float


@dataclass(frozen=True)
class ShapeSurface:
    """Surface through references in its small space.

    Attributes:
        modulus_pa, radius_m: References, inf for rigid and flat ones [Pa], [m].
        turning_pa, turning_m: E_0 and R_0.
        between: Errors of log E and of c when the other references predict each one; 0 if none lies between
            others.
    """

    modulus_pa: Float[ndarray, " k"]
    radius_m: Float[ndarray, " k"]
    turning_pa: float
    turning_m: float
    space: SmallSpace
    between: tuple[float, float] = (0.0, 0.0)

    def of(self, presses: Vectors, coverage: float = 0.9) -> Roundness:
        """Return modulus and radius of a specimen.

        Args:
            presses: One row for each trial; NaN for missing measurements.
            coverage: Coverage of the intervals.
        """
        rows = np.atleast_2d(presses)
        y = np.mean([self.space.place(press) for press in rows], axis=0)
        at = self.nearest(y)
        weight = np.linalg.inv(self.space.scatter)
        slope = self._slope(at)
        k, freedom = len(self.space.means), self.space.freedom
        spread = np.linalg.inv(slope @ weight @ slope.T) * (1 / len(rows) + k / (freedom + k))
        scatter = stats.t.ppf((1 + coverage) / 2, freedom) * np.sqrt(np.diag(spread))
        bent = np.max([np.abs(self.nearest(y, bend) - at) for bend in BENDS], axis=0)
        s, c = at
        between = self.between[0] * max(s, 0.0) * (1 - s), self.between[1]
        half = np.sqrt(scatter**2 + bent**2 + np.square(between))
        off = y - self.at(at)
        return Roundness(
            (self._modulus(s), self._modulus(s + half[0]), self._modulus(s - half[0])),
            (self._radius(c), self._radius(c + half[1]), self._radius(c - half[1])),
            (float(s), float(c)),
            (float(half[0]), float(half[1])),
            float(np.sqrt(off @ weight @ off / len(off))),
        )

    def at(self, place: Float[ndarray, 2], bend: tuple[float, float] = STRAIGHT) -> Float[ndarray, " q"]:
        """Return the surface at a position (s, c), optionally bent between the references."""
        return np.asarray(
            _monomials(_bent(np.asarray(place)[None], bend), self._powers)[0] @ self._fits[bend]
        )

    def nearest(self, y: Float[ndarray, " q"], bend: tuple[float, float] = STRAIGHT) -> Float[ndarray, 2]:
        root = np.linalg.cholesky(np.linalg.inv(self.space.scatter))
        grid = _monomials(_bent(GRID, bend), self._powers) @ self._fits[bend]
        start = GRID[int(np.argmin((((y - grid) @ root) ** 2).sum(axis=1)))]
        found = least_squares(
            lambda at: (y - self.at(at, bend)) @ root, start, bounds=BOUNDS, x_scale=(0.1, 0.1)
        )
        return np.asarray(found.x)

    @cached_property
    def points(self) -> Float[ndarray, "k 2"]:
        return np.stack([softness(self.modulus_pa, self.turning_pa), self.turning_m / self.radius_m], axis=1)

    @cached_property
    def _powers(self) -> tuple[tuple[int, int], ...]:
        """Terms that the references identify, the lowest first."""
        kept: tuple[tuple[int, int], ...] = ()
        for term in TERMS:
            columns = _monomials(self.points, (*kept, term))
            size = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False)
            if len(size) == len(kept) + 1 and size[-1] > SINGULAR * size[0]:
                kept = (*kept, term)
        return kept

    @cached_property
    def _fits(self) -> dict[tuple[float, float], Float[ndarray, "t q"]]:
        def fit(bend: tuple[float, float]) -> Float[ndarray, "t q"]:
            columns = _monomials(_bent(self.points, bend), self._powers)
            return np.asarray(np.linalg.lstsq(columns, self.space.means, rcond=None)[0])

        return {bend: fit(bend) for bend in (STRAIGHT, *BENDS)}

    @cached_property
    def misses(self) -> Float[ndarray, "m q"]:
        """Offsets of references between others from the surface through these."""
        off = [self.space.means[one] - fewer.at(at) for one, fewer, at in _told_by_others(self)]
        return np.array(off).reshape(-1, self.space.means.shape[1])

    def holds(self, s: float, c: float) -> bool:
        """Return whether a position lies inside the convex hull of the references."""
        return bool(Delaunay(self.points).find_simplex(np.array([[s, c]]), tol=1e-6)[0] >= 0)

    def _slope(self, at: Float[ndarray, 2]) -> Float[ndarray, "2 q"]:
        step = 1e-3
        return np.stack([(self.at(at + step * e) - self.at(at - step * e)) / (2 * step) for e in np.eye(2)])

    def _modulus(self, s: float) -> float:
        return float(self.turning_pa * (1 / min(s, 1.0) - 1)) if s > 0 else float("inf")

    def _radius(self, c: float) -> float:
        return float(self.turning_m / c) if c > 0 else float("inf")


def fit_shape_surface(
    modulus_pa: Sequence[float], radius_m: Sequence[float], trials: Sequence[Float[ndarray, "_ d"]]
) -> ShapeSurface:
    """Fit the surface through references.

    Args:
        modulus_pa: Modulus, inf for a rigid reference [Pa].
        radius_m: Radius, inf for a flat reference [m].
        trials: For each reference two or more trials, one a row.
    """
    E, R = np.asarray(modulus_pa, np.float64), np.asarray(radius_m, np.float64)
    if not (len(E) == len(R) == len(trials) and (E > 0).all() and (R > 0).all()):
        raise InputError(f"moduli {list(E)} Pa and radii {list(R)} m; each above 0, one a reference")
    counts = _counts(E, R)
    if not _enough(counts):
        raise InputError(NEEDS.format(*counts), code="too-few-references")
    turning = float(np.exp(np.log(E[np.isfinite(E)]).mean()))
    surface = ShapeSurface(E, R, turning, float(R[np.isfinite(R)].min()), fit_small_space(trials))
    return replace(surface, between=_between(surface))


def _counts(E: Float[ndarray, " k"], R: Float[ndarray, " k"]) -> tuple[int, ...]:
    """Rigid plates, moduli of soft flats, radii of rigid spheres, moduli and radii of soft spheres."""
    rigid, flat = np.isinf(E), np.isinf(R)
    soft_spheres = ~rigid & ~flat
    found = (E[rigid & flat], E[~rigid & flat], R[rigid & ~flat], E[soft_spheres], R[soft_spheres])
    return tuple(len(np.unique(one)) for one in found)


def _enough(counts: tuple[int, ...]) -> bool:
    return all(count >= least for count, least in zip(counts, MIN_REFERENCES, strict=True))


def _between(surface: ShapeSurface) -> tuple[float, float]:
    """Greatest errors of log E and of c when the other references predict each one."""
    off = [(0.0, 0.0)]
    for one, _, (s, c) in _told_by_others(surface):
        true_s, true_c = surface.points[one]
        of_modulus = abs(s - true_s) / (true_s * (1 - true_s)) if true_s > 0 else 0.0
        off.append((of_modulus, abs(c - true_c)))
    largest = np.max(off, axis=0)
    return float(largest[0]), float(largest[1])


def _told_by_others(surface: ShapeSurface) -> Iterator[tuple[int, ShapeSurface, Float[ndarray, 2]]]:
    """Each reference between others, the surface through these, and its nearest position there."""
    for one in range(len(surface.modulus_pa)):
        others = np.delete(np.arange(len(surface.modulus_pa)), one)
        fewer = replace(
            surface,
            modulus_pa=surface.modulus_pa[others],
            radius_m=surface.radius_m[others],
            space=replace(surface.space, means=surface.space.means[others]),
        )
        if _enough(_counts(fewer.modulus_pa, fewer.radius_m)) and fewer.holds(*surface.points[one]):
            yield one, fewer, fewer.nearest(surface.space.means[one])


def _bent(points: Float[ndarray, "n 2"], bend: tuple[float, float]) -> Float[ndarray, "n 2"]:
    """Positions by another E_0 and another law of c."""
    s, c = points.T
    times, hollow = bend
    return np.stack([s * times / (1 + s * (times - 1)), c / (1 + hollow * np.maximum(c, 0.0))], axis=1)


def _monomials(points: Float[ndarray, "n 2"], powers: Sequence[tuple[int, int]]) -> Float[ndarray, "n t"]:
    s, c = points.T
    return np.stack([s**i * c**j for i, j in powers], axis=1)
