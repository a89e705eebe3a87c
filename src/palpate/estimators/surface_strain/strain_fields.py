"""Displacement gradient and strain of a skin's pattern.

Reference and current marks make two surfaces X(u, v) and x(u, v) of one basis. With displacement U = x - X,

    H = dU/dX = (dU/du, dU/dv) (dX/du, dX/dv)^-1,     F = 1 + H.

Small strain is e = (H + H')/2 and rotation (H_yx - H_xy)/2; E = (F'F - 1)/2 and the polar rotation hold for
large ones.

Reference: G. A. Holzapfel, Nonlinear Solid Mechanics (2000), sections 2.2 to 2.5, ISBN 978-0-471-82319-3.

Published measure of touch, the scaled sum of a surface's sample shifts, and baselines.

    gamma = alpha sum_k |s_k - s_k,ref|,     alpha = 1/18000 per px,     F = 3.09 gamma - 1.14 N from 1 to 8 N

("NUSense: Shear Based Robust Optical Tactile Sensor", equation 3.3 and section 4.2). alpha depends on the
number of samples K, taken as 164 x 164, and on the image scale; the mean form, alpha K = 1.494 per px times
the mean shift, does not depend on K.

Direction of an edge: principal axis of the samples that moved most, an angle of period pi.

Its standard error combines redrawn mark noise and the choice of the ratio of samples.

Reference: K. V. Mardia and P. E. Jupp, Directional Statistics (2000), section 1.1 on axial data,
doi:10.1002/9780470316979.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from palpate.core import Field, Float, InputError, Int, Lens, RangeError, ndarray
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.surface_strain.spline_surface import HELD, SAMPLES, SurfaceBasis, surface_basis

Grid = Float[ndarray, "nv nu"]

MIN_AREA = 1e-6  # of the mean: a reference surface folded or torn to less has no gradient
KEPT_SETS = 8  # sets of visible marks whose reference is kept


class PrincipalStrains(NamedTuple):
    """Principal small strains, positive in stretch, and the direction of the greatest, -pi/2 to pi/2."""

    greatest: Grid
    least: Grid
    direction_rad: Grid


@dataclass(frozen=True, slots=True, eq=False)
class StrainFields:
    """Strain of a pattern at the samples of a surface; NaN where marks are missing.

    Attributes:
        basis: Basis of the marks that both frames have.
        at: Resting samples ``[2 nv nu]`` [unit].
        displacement: Along x and y ``[2 nv nu]`` [unit].
        gradient: H, dU_i/dX_j ``[2 2 nv nu]``.
        to_axes: Inverse of dX/d(u, v) ``[2 2 nv nu]`` [1/unit].
        rest, moved: Reference position and shift of each mark ``[n 2]`` [unit].
        variances: Variances of reference and current marks along an axis ``[2 n]`` [unit^2].
    """

    basis: SurfaceBasis
    unit: Literal["px", "m"]
    at: Float[ndarray, "2 nv nu"]
    displacement: Float[ndarray, "2 nv nu"]
    gradient: Float[ndarray, "2 2 nv nu"]
    to_axes: Float[ndarray, "2 2 nv nu"]
    rest: Float[ndarray, "n 2"]
    moved: Float[ndarray, "n 2"]
    variances: Float[ndarray, "2 n"]

    @property
    def shear(self) -> Grid:
        """Engineering shear H_xy + H_yx [rad]."""
        return self.gradient[0, 1] + self.gradient[1, 0]

    @property
    def area_strain(self) -> Grid:
        """Area strain to first order, H_xx + H_yy."""
        return self.gradient[0, 0] + self.gradient[1, 1]

    @property
    def rotation_rad(self) -> Grid:
        """Small rotation from x towards y, (H_yx - H_xy)/2 [rad]."""
        return (self.gradient[1, 0] - self.gradient[0, 1]) / 2

    @property
    def greatest_shear(self) -> Grid:
        """Greatest engineering shear over all directions."""
        xx, yy = self.gradient[0, 0], self.gradient[1, 1]
        return np.hypot(xx - yy, self.shear)

    def principal(self) -> PrincipalStrains:
        xx, yy, shear = self.gradient[0, 0], self.gradient[1, 1], self.shear
        middle, radius = (xx + yy) / 2, np.hypot(xx - yy, shear) / 2
        return PrincipalStrains(middle + radius, middle - radius, np.arctan2(shear, xx - yy) / 2)


class _Rest(NamedTuple):
    """Reference surface on one set of marks."""

    basis: SurfaceBasis
    at: Float[ndarray, "2 nv nu"]
    to_axes: Float[ndarray, "2 2 nv nu"]
    hidden: Float[ndarray, "nv nu"]


class StrainMeter:
    """Strain of later frames relative to a reference; arguments as of `surface_basis`."""

    def __init__(
        self,
        reference: ControlPoints,
        degree: int = 1,
        samples: tuple[int, int] = SAMPLES,
        cells_per_knot: float = 1.0,
        held: float = HELD,
    ) -> None:
        self.reference = reference
        self._settings = (degree, samples, cells_per_knot, held)
        self._low = reference.cells.min(axis=0) if len(reference) else np.zeros(2, int)
        self._span = np.ptp(reference.cells, axis=0) + 1 if len(reference) else np.ones(2, int)
        self._row = np.full(int(self._span.prod()), -1)
        self._row[self._keys(reference.cells)] = np.arange(len(reference))
        self._rests: dict[bytes, _Rest] = {}

    def fields(self, current: ControlPoints) -> StrainFields:
        theirs, ours = self._shared(current)
        rest = self._rest(theirs)
        moved = current.places[ours] - self.reference.places[theirs]
        net = rest.basis.net(moved)
        by_u, by_v = rest.basis.sampled(net, "u"), rest.basis.sampled(net, "v")
        J = rest.to_axes
        gradient = np.empty((2, *by_u.shape))
        for j in range(2):
            gradient[:, j] = by_u * J[0, j] + by_v * J[1, j]
        displacement = rest.basis.sampled(net) + rest.hidden
        variances = np.stack([self.reference.sigma[theirs], current.sigma[ours]]) ** 2
        return StrainFields(
            rest.basis,
            current.unit,
            rest.at,
            displacement,
            gradient,
            rest.to_axes,
            self.reference.places[theirs],
            moved,
            variances,
        )

    def _shared(self, current: ControlPoints) -> tuple[Int[ndarray, " m"], Int[ndarray, " m"]]:
        """Rows of the marks that both have, in the reference and in the frame."""
        if current.unit != self.reference.unit:
            raise InputError(f"control points in {current.unit} and {self.reference.unit}; use one unit")
        inside = ((current.cells >= self._low) & (current.cells < self._low + self._span)).all(axis=1)
        ours = np.nonzero(inside)[0]
        theirs = self._row[self._keys(current.cells[ours])]
        known = theirs >= 0
        ours, theirs = ours[known], theirs[known]
        order = np.argsort(theirs)
        return theirs[order], ours[order]

    def _keys(self, cells: Int[ndarray, "n 2"]) -> Int[ndarray, " n"]:
        column, row = (cells - self._low).T
        return row * self._span[0] + column

    def _rest(self, rows: Int[ndarray, " m"]) -> _Rest:
        key = rows.tobytes()
        if key not in self._rests:
            while len(self._rests) >= KEPT_SETS:
                del self._rests[next(iter(self._rests))]
            self._rests[key] = self._at_rest(rows)
        return self._rests[key]

    def _at_rest(self, rows: Int[ndarray, " m"]) -> _Rest:
        basis = surface_basis(self.reference.cells[rows], *self._settings)
        net = basis.net(self.reference.places[rows])
        (xu, yu), (xv, yv) = basis.sampled(net, "u"), basis.sampled(net, "v")
        area = xu * yv - xv * yu
        seen = area[basis.supported]
        if (seen * np.sign(seen.sum()) <= MIN_AREA * np.abs(seen).mean()).any():
            raise RangeError("the reference's marks fold over one another; find them again")
        hidden = np.where(basis.supported, 0.0, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            to_axes = np.stack([np.stack([yv, -xv]), np.stack([-yu, xu])]) / area + hidden
        return _Rest(basis, basis.sampled(net), to_axes, hidden)


def strain_fields(
    reference: ControlPoints, current: ControlPoints, degree: int = 1, samples: tuple[int, int] = SAMPLES
) -> StrainFields:
    """Return the strain of one frame; use `StrainMeter` for several."""
    return StrainMeter(reference, degree, samples).fields(current)


def on_plane(points: ControlPoints, lens: Lens, distance_m: float) -> ControlPoints:
    """Return marks of an image projected to the plane at a distance across the lens's axis [m].

    x runs with the image's columns and y against its rows; standard errors scale with the geometric mean of
    both axes.
    """
    if points.unit != "px":
        raise InputError("control points in m; give those of an image, in px", code="unit-differs")
    if not 0 < distance_m < np.inf:
        raise RangeError(f"distance of the plane {distance_m} m; give one above 0 m", code="not-positive")
    half = np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    rays = lens.rays(points.places + half[:, None])
    if not (np.isfinite(rays).all() and (rays[..., 2] > 0).all()):
        raise RangeError("a control point lies where the lens sees no plane; leave it out")
    flat = distance_m * rays[..., :2] / rays[..., 2:] * np.array([1.0, -1.0])
    (xx, xy), (yx, yy) = (flat[1] - flat[2]).T, (flat[3] - flat[4]).T
    return ControlPoints(points.cells, flat[0], points.sigma * np.sqrt(np.abs(xx * yy - xy * yx)), "m")


PUBLISHED_ALPHA = 1 / 18_000  # per px
PUBLISHED_SAMPLES = 164 * 164  # K
PUBLISHED_SLOPE_N, PUBLISHED_OFFSET_N = 3.09, -1.14
PUBLISHED_RANGE_N = (1.0, 8.0)


@dataclass(frozen=True, slots=True)
class ShearMeasure:
    """Scaled sum of a surface's sample shifts.

    Attributes:
        alpha: Scale of the sum [1/unit].
        count: K, all samples, including those without marks.
        seen: Samples with marks around them.
        total: Sum of the shifts of those [unit].
    """

    alpha: float
    count: int
    seen: int
    total: float
    unit: Literal["px", "m"]

    @property
    def mean(self) -> float:
        return self.total / self.seen

    @property
    def mean_form(self) -> float:
        """Gamma of K samples with the mean shift of the seen ones."""
        return self.alpha * self.count * self.mean


def shear_measure(fields: StrainFields, alpha: float = PUBLISHED_ALPHA) -> ShearMeasure:
    """Return the published measure; its `alpha` holds for 164 x 164 samples in px of an undistorted image."""
    if not 0 < alpha < math.inf:
        raise InputError(f"alpha {alpha}; give a number above 0 (published: 1/18000)", code="alpha-range")
    if fields.unit != "px" and alpha == PUBLISHED_ALPHA:
        raise InputError("the published alpha is per px; give marks in px", code="unit-differs")
    seen = int(fields.basis.supported.sum())
    shifts = np.hypot(*fields.displacement)
    return ShearMeasure(alpha, fields.basis.count, seen, float(np.nansum(shifts)), fields.unit)


def published_force_n(gamma: float) -> float:
    """Return the force by the published line [N].

    Example:
        >>> round(published_force_n(0.6926), 3), round(published_force_n(2.9579), 3)
        (1.0, 8.0)
    """
    force, (low, high) = PUBLISHED_SLOPE_N * gamma + PUBLISHED_OFFSET_N, PUBLISHED_RANGE_N
    if not low - 0.01 <= force <= high + 0.01:
        raise RangeError(
            f"gamma {gamma:.4g} lies outside {published_gamma(low):.4g} to {published_gamma(high):.4g} (1 "
            "to 8 N)",
            code="gamma-range",
        )
    return force


def published_gamma(force_n: float) -> float:
    """Return gamma of a force by the published line."""
    return (force_n - PUBLISHED_OFFSET_N) / PUBLISHED_SLOPE_N


def shear_from_pressure(
    pressure_pa: Field,
    x_m: Float[ndarray, " nx"],
    y_m: Float[ndarray, " ny"],
    blur_m: float,
    youngs_modulus_pa: float,
    thickness_m: float,
) -> Float[ndarray, "2 ny nx"]:
    """Return baseline (3.1): shear as the slope of the blurred pressure over G, times a thickness.

        gamma_j = t (3/E) d(sigma * phi)/dx_j,     3/E = 1/G of an incompressible skin.

    Args:
        pressure_pa: Pressure on the skin ``[ny nx]`` [Pa].
        x_m, y_m: Columns and rows, in even steps [m].
        blur_m: Standard deviation of the Gaussian phi [m].
        youngs_modulus_pa: Young's modulus of the skin [Pa].
        thickness_m: Thickness over which the shear acts [m].
    """
    steps = [np.diff(axis) for axis in (y_m, x_m)]
    if any(len(d) < 2 or not np.allclose(d, d[0], rtol=1e-6, atol=0) or d[0] <= 0 for d in steps):
        raise InputError("x_m and y_m are 3 or more places that rise in even steps [m]")
    if not (blur_m > 0 and youngs_modulus_pa > 0 and thickness_m > 0):
        raise InputError("the blur, the modulus and the thickness are positive; give them in m, Pa and m")
    dy, dx = (float(d[0]) for d in steps)
    blurred = gaussian_filter(pressure_pa, (blur_m / dy, blur_m / dx), mode="constant")
    by_y, by_x = np.gradient(blurred, dy, dx)
    return np.stack([by_x, by_y]) * (3 * thickness_m / youngs_modulus_pa)


DEFORMED_SHARE = 0.1  # ratio of the samples; assumed, not in the thesis
OTHER_SHARES = (0.7, 1.4)  # multiples of that ratio, for the error
DRAWS = 48
NORMAL_90 = 1.6449  # standard errors of a two-sided 90 % interval
MIN_ELONGATION = 1.6  # length over width of what has moved most: a round contact has up to 1.3
MIN_SHIFT = 5.0  # times the marks' noise
HALF_TURN = math.pi


@dataclass(frozen=True, slots=True)
class EdgeDirection:
    """Direction of an edge, an angle of period pi.

    Attributes:
        angle_rad: Angle from the marks' x axis towards y, 0 to pi.
        error_rad: Standard error.
        half_rad: Half-width of its 90 % interval, at most pi/2.
        elongation: Length over width of the samples that moved most (standard deviations).
        centre: Center of these samples (x, y) [unit of the marks].
    """

    angle_rad: float
    error_rad: float
    half_rad: float
    elongation: float
    centre: tuple[float, float]

    def contains(self, angle_rad: float) -> bool:
        """Return whether an angle, modulo half turns, lies within the 90 % interval."""
        return abs(axial_difference(angle_rad, self.angle_rad)) <= self.half_rad


def axial_difference(one_rad: float, other_rad: float) -> float:
    """Return the shortest turn from the other direction to the one, -pi/2 to pi/2 [rad].

    Example:
        >>> round(axial_difference(math.radians(179), math.radians(1)), 4)
        -0.0349
    """
    return (one_rad - other_rad + HALF_TURN / 2) % HALF_TURN - HALF_TURN / 2


def edge_direction(fields: StrainFields, most_deformed: float = DEFORMED_SHARE) -> EdgeDirection | None:
    """Return the direction of the edge in contact; None without contact or for a round one.

    Args:
        fields: Strain fields of the frame.
        most_deformed: Ratio of the samples, by their shift, that is used; 0.01 to 0.5.
    """
    if not 0.01 <= most_deformed <= 0.5:
        raise InputError(f"a share of {most_deformed} of the samples; give 0.01 to 0.5", code="ratio-range")
    seen = fields.basis.supported
    at, shifts = fields.at[:, seen], fields.displacement[:, seen]
    noise = math.sqrt(float(fields.variances.sum(axis=0).mean()))
    if np.quantile(np.hypot(*shifts), 1 - most_deformed) < MIN_SHIFT * noise:
        return None
    angle, elongation, centre = _axis(at, shifts, most_deformed)
    if elongation < MIN_ELONGATION:
        return None
    rng = np.random.default_rng(0)
    spread = np.sqrt(fields.variances.sum(axis=0))[:, None]
    drawn = []
    for _ in range(DRAWS):
        net = fields.basis.net(spread * rng.standard_normal(fields.rest.shape))
        again = _axis(at, shifts + fields.basis.sampled(net)[:, seen], most_deformed)
        drawn.append(axial_difference(again[0], angle))
    others = [
        axial_difference(_axis(at, shifts, min(0.5, most_deformed * share))[0], angle)
        for share in OTHER_SHARES
    ]
    error = math.hypot(float(np.std(drawn)), math.sqrt(float(np.mean(np.square(others)))))
    half = min(NORMAL_90 * error, HALF_TURN / 2)
    return EdgeDirection(angle % HALF_TURN, error, half, elongation, centre)


def _axis(
    at: Float[ndarray, "2 k"], shifts: Float[ndarray, "2 k"], share: float
) -> tuple[float, float, tuple[float, float]]:
    """Principal axis [rad], length over width, and center of the samples that moved most."""
    size = np.hypot(*shifts)
    count = max(3, int(share * len(size)))
    most = at[:, np.argpartition(size, -count)[-count:]]
    centre = most.mean(axis=1)
    (xx, xy), (_, yy) = np.cov(most)
    half, middle = math.hypot((xx - yy) / 2, xy), (xx + yy) / 2
    elongation = math.sqrt((middle + half) / max(middle - half, 1e-12 * middle))
    return math.atan2(2 * xy, xx - yy) / 2, elongation, (float(centre[0]), float(centre[1]))
