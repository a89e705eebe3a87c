"""The TacTip's side on a specimen with an inclined top.

Frictionless contacts with a finite-strain table (`inclined_table`) use it. Others are of linear bodies
(`tilted_tip`), solved over approaches up to the maximum force and interpolated by splines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.interpolate import CubicSpline, NdBSpline, PchipInterpolator, RectBivariateSpline

from palpate.core import Float, RangeError, ndarray
from palpate.mechanics.axisymmetric.tilted_tip import (
    TiltedContact,
    TiltedPress,
    TipModes,
    TopModes,
    tip_modes,
    top_modes,
)
from palpate.mechanics.axisymmetric.tip_table import SidePress, TipTable, inclined_table, tip_table
from palpate.sensors.tactip.tactip_press import LeaningSkin, SkinShape, TabledContact
from palpate.sensors.tactip.tactip_spec import TacTipSpec

MIRROR = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class SideOn(TabledContact):
    """A specimen under the tip's side, by a finite-strain table."""

    press: SidePress
    inner_radius_m: float
    radius_m: float

    def skin(self, approach_m: float, lean_rad: tuple[float, float]) -> SkinShape:
        moved = self.press.at("moved_m", self.press.force_at(np.array([approach_m])))[0]
        dome = BentDome(
            self.inner_radius_m, self.radius_m, self.press.across_rad, self.press.aside_rad, moved
        )
        return LeaningSkin(dome, self.radius_m, lean_rad)


@dataclass(frozen=True)
class BentDome:
    """Inside of a deformed dome, symmetric about the plane y = 0.

    Attributes:
        inner_radius_m: Radius of the dome [m].
        radius_m: Radius of the tip, whose undeformed apex is at z = 0 [m].
        across_rad, aside_rad, moved_m: See `SidePress`, at one force.
    """

    inner_radius_m: float
    radius_m: float
    across_rad: Float[ndarray, " a"]
    aside_rad: Float[ndarray, " b"]
    moved_m: Float[ndarray, "a b 3"]

    def at(self, polar: Float[ndarray, " p"], azimuth: Float[ndarray, " p"]) -> tuple[ndarray, ndarray]:
        x, y, z = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)
        a, b = np.arctan2(-z, x), np.arcsin(np.clip(y, -1.0, 1.0))
        places = self.inner_radius_m * np.stack([x, y, z], axis=-1) + self._moved(a, b)
        along_a = self.inner_radius_m * np.stack([z, 0 * z, -x], axis=-1) + self._moved(a, b, da=1)
        turned = np.stack([-np.sin(b) * np.cos(a), np.cos(b), np.sin(b) * np.sin(a)], axis=-1)
        along_b = self.inner_radius_m * turned + self._moved(a, b, db=1)
        normal = np.cross(along_b, along_a)
        size = np.linalg.norm(normal, axis=-1, keepdims=True)
        return places + np.array([0.0, 0.0, self.radius_m]), normal / size

    def _moved(self, a: Float[ndarray, " p"], b: Float[ndarray, " p"], da: int = 0, db: int = 0) -> ndarray:
        return np.stack([spline.ev(a, b, dx=da, dy=db) for spline in self._splines], axis=-1)

    @cached_property
    def _splines(self) -> list[RectBivariateSpline]:
        both = np.concatenate([-self.aside_rad[:0:-1], self.aside_rad])
        whole = np.concatenate([self.moved_m[:, :0:-1] * MIRROR, self.moved_m], axis=1)
        return [RectBivariateSpline(self.across_rad, both, whole[..., i]) for i in range(3)]


STATES = 22
BEYOND_N = 5.5  # maximum force, slightly above a trial's
FIRST_M, STRIDE = 1e-3, 1.4  # search for the maximum approach
GRID = 61  # points across the skin along x and y
MAX_TILT = np.deg2rad(50.0)


@dataclass(frozen=True)
class Inclined:
    """A specimen under the tip's side by linear bodies.

    Attributes:
        inner_radius_m: Radius of the skin's inside [m].
        approach_m, lift_n, touched_m2: Approach, vertical force, and contact area of the states.
        moved_m: Displacement of the skin's inside as control points ``[states g g 3]`` of a cubic spline on
            `knots_rad` over (polar angle) x (cosine, sine of azimuth) [m].
    """

    contact: TiltedContact
    inner_radius_m: float
    approach_m: Float[ndarray, " k"]
    lift_n: Float[ndarray, " k"]
    touched_m2: Float[ndarray, " k"]
    knots_rad: Float[ndarray, " n"]
    moved_m: Float[ndarray, "k g g 3"]

    @property
    def law(self) -> str:
        friction = self.contact.friction
        return f"linear bodies, with friction {friction:g}" if friction else "linear bodies, without friction"

    @property
    def deepest_m(self) -> float:
        return float(self.approach_m[-1])

    def force_n(self, approach_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        return np.asarray(self._root(np.maximum(approach_m, 0.0))) ** 1.5

    def area_m2(self, force_n: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Contact area [m^2], smooth where the states count whole cells."""
        return np.polyval(self._area, np.cbrt(force_n)) * np.cbrt(force_n) ** 2

    def skin(self, approach_m: float, lean_rad: tuple[float, float]) -> SkinShape:
        points = np.asarray(self._moved(np.clip(approach_m, 0.0, self.deepest_m)))
        moved = NdBSpline((self.knots_rad, self.knots_rad), points, 3)
        radius = self.contact.tip.radius_m
        return LeaningSkin(MovedDome(self.inner_radius_m, radius, moved), radius, lean_rad)

    @cached_property
    def _root(self) -> PchipInterpolator:
        """Force to the 2/3, nearly linear in the approach."""
        return PchipInterpolator(self.approach_m, np.maximum(self.lift_n, 0.0) ** (2 / 3))

    @cached_property
    def _area(self) -> Float[ndarray, " k"]:
        """A / F^(2/3), constant in Hertz contact, as a quadratic in F^(1/3)."""
        f = np.cbrt(self.lift_n[1:])
        return np.polyfit(f, self.touched_m2[1:] / f**2, 2, w=f**2)

    @cached_property
    def _moved(self) -> CubicSpline:
        return CubicSpline(self.approach_m, self.moved_m)


@dataclass(frozen=True)
class MovedDome:
    """Inside of a dome displaced by `moved_m` over (polar angle) x (cosine, sine of azimuth) [m]."""

    inner_radius_m: float
    radius_m: float
    moved_m: NdBSpline

    def at(self, polar: Float[ndarray, " p"], azimuth: Float[ndarray, " p"]) -> tuple[ndarray, ndarray]:
        ab = np.stack([polar * np.cos(azimuth), polar * np.sin(azimuth)], axis=-1)
        along_a, along_b = (self._tangent(ab, i) for i in range(2))
        normal = np.cross(along_a, along_b)
        return self._dome(ab) + self.moved_m(ab), normal / np.linalg.norm(normal, axis=-1, keepdims=True)

    def _tangent(self, ab: ndarray, axis: int) -> ndarray:
        """Tangent along a or b, of the dome by a central difference."""
        step = 1e-4 * np.eye(2)[axis]
        dome = (self._dome(ab + step) - self._dome(ab - step)) / 2e-4
        return dome + self.moved_m(ab, nu=np.eye(2, dtype=int)[axis])

    def _dome(self, ab: ndarray) -> ndarray:
        phi = np.hypot(*ab.T)
        out = self.inner_radius_m * np.sinc(phi / np.pi)
        return np.stack([*(ab.T * out), self.radius_m - self.inner_radius_m * np.cos(phi)], axis=-1)


def inclined(spec: TacTipSpec, specimen_pa: float, tilt_rad: float) -> Inclined | SideOn:
    """Return the tip on an inclined specimen of Young's modulus `specimen_pa`, `inf` for rigid, tabled if
    possible.
    """
    table = inclined_table(spec.tip)
    if table and has_table(spec, specimen_pa, tilt_rad):
        return SideOn(table.press(specimen_pa, tilt_rad), spec.inner_radius_m, spec.table.radius_m)
    return linear_inclined(spec, specimen_pa, tilt_rad)


def has_table(spec: TacTipSpec, specimen_pa: float, tilt_rad: float) -> bool:
    """Return whether `inclined` uses a table at finite strain."""
    table = inclined_table(spec.tip)
    return spec.friction == 0 and table is not None and table.holds(specimen_pa, tilt_rad)


def linear_inclined(spec: TacTipSpec, specimen_pa: float, tilt_rad: float) -> Inclined:
    """Return the tip on an inclined specimen by linear bodies; solving a new tip takes half a minute."""
    if not (0 <= tilt_rad <= MAX_TILT and specimen_pa > 0):
        raise RangeError(
            f"a specimen of {specimen_pa:g} Pa at {np.rad2deg(tilt_rad):.3g} degrees; above 0 Pa, and 0 to "
            f"{np.rad2deg(MAX_TILT):.0f} degrees",
            code="tilt-range",
        )
    return _inclined(spec.tip, spec.friction, specimen_pa, tilt_rad)


@lru_cache(maxsize=64)
def _inclined(tip: str, friction: float, specimen_pa: float, tilt_rad: float) -> Inclined:
    table, modes = tip_of(tip)
    top = None if np.isinf(specimen_pa) else _top(table, specimen_pa)
    contact = TiltedContact(modes, top, tilt_rad, friction)
    approach, states = _states(contact)
    knots, moved = _splines(modes, np.stack([contact.pins_moved_m(state) for state in states]))
    return Inclined(
        contact,
        table.radius_m - table.skin_m,
        approach,
        np.array([0.0] + [state.lift_n for state in states]),
        np.array([0.0] + [state.area_m2 for state in states]),
        knots,
        np.concatenate([np.zeros_like(moved[:1]), moved]),
    )


def _states(contact: TiltedContact) -> tuple[Float[ndarray, " k"], list[TiltedPress]]:
    """Approaches from 0, and the states up to the maximum force."""
    deep = FIRST_M
    while contact.through(np.array([deep]))[0].lift_n < BEYOND_N:
        deep *= STRIDE
    while True:
        approach = np.linspace(0.0, deep, STATES)
        states = contact.through(approach[1:])
        enough = [i for i, state in enumerate(states) if state.lift_n >= BEYOND_N]
        if enough:
            return approach[: enough[0] + 2], states[: enough[0] + 1]
        deep *= STRIDE  # in steps with stick it is softer than in one step


@lru_cache(maxsize=8)
def tip_of(name: str) -> tuple[TipTable, TipModes]:
    """Return a tip's table and its linear response."""
    table = tip_table(name)
    modes = tip_modes(table.radius_m, table.skin_m, table.skin_pa, table.gel_pa, table.poisson_ratio)
    return table, modes


@lru_cache(maxsize=4)
def _unit_top(radius_m: float, height_m: float, poisson_ratio: float) -> TopModes:
    return top_modes(radius_m, height_m, 1.0, poisson_ratio)


def _top(table: TipTable, specimen_pa: float) -> TopModes:
    """Response of the tables' cylinder, proportional to 1 / E."""
    unit = _unit_top(table.specimen_radius_m, table.specimen_height_m, table.poisson_ratio)
    return TopModes(unit.radii_m, unit.top / specimen_pa)


def _splines(
    modes: TipModes, moved: Float[ndarray, "k places azimuths 3"]
) -> tuple[Float[ndarray, " n"], Float[ndarray, "k g g 3"]]:
    """Knots and control points on a uniform grid, which has no pole."""
    reach = float(modes.pins_rad[-1] / np.sqrt(2))
    at = np.linspace(-reach, reach, GRID)
    a, b = np.meshgrid(at, at, indexing="ij")
    polar, azimuth = np.hypot(a, b), np.arctan2(b, a)
    points = np.empty((len(moved), GRID, GRID, 3))
    for k, state in enumerate(moved):
        phi, theta, across = _all_around(modes, state)
        for i in range(3):
            values = RectBivariateSpline(phi, theta, across[..., i])(polar, azimuth, grid=False)
            spline = RectBivariateSpline(at, at, values)
            points[k, ..., i] = spline.get_coeffs().reshape(GRID, GRID)
    return spline.get_knots()[0], points


def _all_around(
    modes: TipModes, moved: Float[ndarray, "places azimuths 3"]
) -> tuple[Float[ndarray, " p"], Float[ndarray, " a"], Float[ndarray, "p a 3"]]:
    """Displacement along x, y, z through the pole and around, without seam."""
    theta = (np.arange(2 * modes.azimuths) + 0.5) * np.pi / modes.azimuths
    other = moved[:, ::-1] * [1.0, -1.0, 1.0]  # the half y < 0 mirrors the half y > 0
    r, around, z = np.moveaxis(np.concatenate([moved, other], axis=1), -1, 0)
    c, s = np.cos(theta), np.sin(theta)
    ring = np.stack([r * c - around * s, r * s + around * c, z], axis=-1)
    beyond = modes.pins_rad > 1e-9
    across = np.concatenate([np.roll(ring[beyond][::-1], modes.azimuths, axis=1), ring])
    phi = np.concatenate([-modes.pins_rad[beyond][::-1], modes.pins_rad])
    turns = np.concatenate([theta - 2 * np.pi, theta, theta + 2 * np.pi])
    return phi, turns, np.tile(across, (1, 3, 1))
