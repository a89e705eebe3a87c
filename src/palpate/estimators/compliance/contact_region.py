"""Contact region from the field of pins: ring, flattening, cells, ellipse.

Under the contact the skin lies flat and its pins tilt outward, most near the contact's edge. The ring of
greatest outward motion lies slightly inside the edge (for pins with a length), and the stretch du_r/dr at the
center measures the flattening of the dome. A softer specimen has a larger ring and, at equal force, less
stretch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial import Voronoi

from palpate.core import Float, InputError, RangeError, ndarray
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
    fit, *_ = np.linalg.lstsq(_terms(x), field.moved_px, rcond=None)
    reach = _reach(field, centre)
    points = []
    for angle, far in zip(np.arange(RAYS) * 2 * np.pi / RAYS, reach, strict=True):
        direction = np.array([np.cos(angle), np.sin(angle)])
        r = np.linspace(0.15, 1.0, 120) * far
        away = _terms(r[:, None] * direction / field.radius_px) @ fit @ direction
        best = int(np.argmax(away))
        if 0 < best < len(r) - 1:
            points.append(r[best] * direction)
    if len(points) < RAYS // 3:
        raise InputError(
            f"the ring lies inside the field of pins in {len(points)} of {RAYS} directions; a third is needed"
        )
    return _through(np.array(points), centre, len(points) / RAYS)


def _terms(x: Points) -> Float[ndarray, "p k"]:
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
