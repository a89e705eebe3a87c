"""A rigid sphere pressed deep into a bonded disc and pulled laterally, to first order in the pull.

About the frictionless pressed state of `sphere_table` the sphere moves along x at constant depth; the surface
sticks to it, or slips where traction exceeds Coulomb friction. The added fields have one harmonic: rr, tt,
zz, rz, and the surface's depth times cos t, rt and tz times sin t, with t from the pull about the sphere's
present axis. They are proportional to the pull Q, and depend on Q / (mu P) through slip. Against
three-dimensional solutions (`tools/dragged_sphere.py`) the force is accurate to 3 % up to `MAX_SHIFT`. The
table has modes on knots that scale with the contact; made by `tools/pulled_sphere_table.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.optimize import brentq

from palpate.core import Contact, ContactSolution, Float, RangeError, ndarray
from palpate.mechanics.axisymmetric.disc_table import SAME, TabulatedPress

TABLE = resources.files("palpate.mechanics") / "tables" / "pulled_sphere.npz"
STRESSES = ("rr", "tt", "zz", "rz", "rt", "tz")
MAX_SHIFT = 0.45  # maximum shift of the verified first order [R]
FULL = 0.98  # maximum solved fraction of friction
BETWEEN = 2.5  # maximum interpolated thickness [R]
REACHED = 5.4  # last radius [R]
NEAR = np.concatenate([np.linspace(0.0, 0.7, 11), np.arange(15, 27) * 0.05, [1.4, 1.55, 1.75, 2.0]])
FAR, DOWN = 16, 24  # knots beyond two contact radii, and down to the base
FIRST = 0.06  # depth of the first knot, in contact radii


Knots = Float[ndarray, " n"]


def radii_of(contact_radius: float) -> Knots:
    """Return the radii of a contact's fields [R]."""
    far = np.geomspace(2.0 * contact_radius, REACHED, FAR + 1)[1:]
    return np.concatenate([NEAR * contact_radius, far])


def shares_down(contact_radius: float, depth: float, thickness: float) -> Knots:
    """Return the relative depths of a contact's fields."""
    even = np.linspace(0.0, 1.0, DOWN + 1)
    first = 1.0 / (DOWN + (thickness - depth) / (FIRST * contact_radius))
    stretch = brentq(lambda b: np.sinh(b * even[1]) / np.sinh(b) - first, 1e-6, 40.0)
    return np.sinh(stretch * even) / np.sinh(stretch)


class PulledStress(NamedTuple):
    """Fields added by a pull: amplitudes of the harmonic, lengths in R, stresses in E.

    Attributes:
        r: Radius about the sphere's present axis.
        zeta: 0 at the deformed top, 1 at the base.
        stress: `STRESSES` [6 m n].
        surface: Depth of the top.
        shift: Shift of the sphere along the pull.
    """

    r: Knots
    zeta: Knots
    stress: Float[ndarray, "6 m n"]
    surface: Knots
    shift: float


@dataclass(frozen=True)
class PulledSphereTable:
    """Pulls of a sphere of radius R on a disc of modulus E; forces in E R^2.

    Attributes:
        thickness, depth, share: Axes: disc [R], press [R], fraction of friction.
        stiffness: Stiffness without slip over Mindlin's 8 a G / (2 - nu).
        shift: Shift over that without slip.
        amount, mode, scale: Factors of stress and surface; `scale` is times a^2 / Q of stress and a / Q of
            the surface.
    """

    thickness: Float[ndarray, " h"]
    depth: Float[ndarray, " d"]
    share: Float[ndarray, " s"]
    stiffness: Float[ndarray, "h d"]
    shift: Float[ndarray, "h d s"]
    amount: Float[ndarray, "h d s k"]
    mode: Float[ndarray, "k v"]
    scale: Float[ndarray, " v"]

    def at(self, press: TabulatedPress, force: float, friction: float) -> PulledStress:
        """Fields added by a pull of a force [E R^2] to a frictionless press."""
        a, most = press.contact_radius, friction * press.force
        share = min(force / most, FULL)
        amount, slack = self._at(press.thickness, press.depth, share)
        values = amount @ self.mode * self.scale
        r, zeta = radii_of(a), shares_down(a, press.depth, press.thickness)
        stress = values[: -len(r)].reshape(6, len(zeta), len(r)) * (force / a**2)
        shift = force / self.stiffness_at(press) * slack
        return PulledStress(r, zeta, stress, values[-len(r) :] * (force / a), shift)

    def stiffness_at(self, press: TabulatedPress) -> float:
        """Stiffness without slip [E R]."""
        ratio = self.stiffness_ratio(np.array([press.depth]), press.thickness)
        return float(ratio[0]) * mindlin_stiffness(press.contact_radius)

    def stiffness_ratio(self, depth: Knots, thickness: float) -> Knots:
        """Stiffness without slip over a half-space's at many depths [R]."""
        over = CubicSpline(np.sqrt(self.depth), self.stiffness[self._row(thickness)], axis=1)
        return self._mixed(over(np.sqrt(np.maximum(depth, self.depth[0]))), thickness)

    def covers(self, thickness: float) -> bool:
        """Whether a disc's thickness [R] is solved or interpolated."""
        return bool(np.isclose(self.thickness, thickness, rtol=SAME).any()) or bool(
            self.thickness[0] <= thickness <= BETWEEN
        )

    def force_of(self, press: TabulatedPress, shift: float, friction: float) -> float:
        """Force of a shift, at most `FULL` of friction [E R^2]."""
        most = FULL * friction * press.force
        if not self.shift_of(press, most, friction) > shift:
            return most
        return float(brentq(lambda f: self.shift_of(press, f, friction) - shift, 0.0, most, xtol=1e-12))

    def shift_of(self, press: TabulatedPress, force: float, friction: float) -> float:
        """Shift of a force [R]."""
        share = min(force / (friction * press.force), FULL)
        return force / self.stiffness_at(press) * self._at(press.thickness, press.depth, share)[1]

    def _row(self, thickness: float) -> ndarray:
        """Rows of the thicknesses in the interpolation."""
        own = np.isclose(self.thickness, thickness, rtol=SAME)
        if own.any():
            return np.flatnonzero(own)
        between = np.flatnonzero(self.thickness <= BETWEEN)
        least, most = self.thickness[between[[0, -1]]]
        if not least <= thickness <= most:
            raise RangeError(
                f"no pull of a sphere on a disc {thickness:g} R thick was solved; solved were {least:g} to "
                f"{most:g} R "
                f"and {', '.join(f'{h:g} R' for h in self.thickness if h > most)}",
                code="no-table",
            )
        return between

    def _mixed(self, values: ndarray, thickness: float) -> ndarray:
        """Lagrange interpolation over 1 / thickness."""
        rows = 1.0 / self.thickness[self._row(thickness)]
        weight = [np.prod([(1 / thickness - o) / (x - o) for o in rows if o != x]) for x in rows]
        return np.tensordot(weight, values, axes=1)

    def _at(self, thickness: float, depth: float, share: float) -> tuple[ndarray, float]:
        """Amounts of the modes, and the shift over that without slip."""
        rows, root = self._row(thickness), math.sqrt(max(depth, self.depth[0]))
        both = np.concatenate([self.amount[rows], self.shift[rows][..., None]], axis=-1)
        by_share = CubicSpline(np.sqrt(self.depth), both, axis=1)(root)
        mixed = self._mixed(PchipInterpolator(self.share, by_share, axis=1)(share), thickness)
        return mixed[:-1], float(mixed[-1])


def mindlin_stiffness(contact_radius: float, poisson_ratio: float = 0.49) -> float:
    """Return 8 a G / (2 - nu) of a half-space [E R]."""
    return 4.0 * contact_radius / ((1.0 + poisson_ratio) * (2.0 - poisson_ratio))


@lru_cache(maxsize=1)
def pulled_sphere_table() -> PulledSphereTable:
    """Return the shipped table (cached)."""
    with resources.as_file(TABLE) as path, np.load(path, allow_pickle=False) as file:
        return PulledSphereTable(**{name: file[name].astype(float) for name in file.files})


def pulled(
    contact: Contact,
    press: TabulatedPress,
    youngs_modulus_pa: float,
    pull_n: tuple[float, float],
    friction: float,
) -> Contact:
    """Return a pressed contact with a monotonic pull.

    Args:
        contact: Contact of a sphere by the frictionless table, at the sphere's present pose.
        press: The table's press.
        youngs_modulus_pa: Modulus for which the contact's force is the press's [Pa].
        pull_n: Force of the sphere on the surface along x and y [N].
        friction: Coulomb coefficient.

    Returns:
        Contact whose shear is the load added by the pull per area seen from above, scaled to sum to it (a
        factor of 1.03 to 1.09 to 0.8 R deep, up to 1.5 at 1.2 R). Pressure and edge are unchanged.
    """
    Q, most = math.hypot(*pull_n), friction * contact.force_n
    R = contact.probe.radius_m
    if not contact.force_n > 0.0:
        raise RangeError(f"a lateral load of {Q:g} N on a probe that does not press", code="no-normal-force")
    if not most > Q:
        raise RangeError(
            f"a force of {Q:g} N makes the whole contact slip; give less than friction times the normal "
            f"force, {most:g} N",
            code="sliding",
        )
    table, unit = pulled_sphere_table(), youngs_modulus_pa * R**2
    added = table.at(press, Q / unit, friction)
    if added.shift > MAX_SHIFT * (1 + SAME):
        raise RangeError(
            f"a lateral load of {Q:g} N takes the ball {added.shift * R * 1e3:.3g} mm along the skin; to "
            f"{MAX_SHIFT * R * 1e3:g} mm the first order holds: give "
            f"{table.force_of(press, MAX_SHIFT, friction) * unit:.4g} N or less, or press deeper",
            code="displacement-limit",
        )
    x, y = contact.x_m - contact.pose.x_m, contact.y_m[:, None] - contact.pose.y_m
    r, cos, sin = np.hypot(x, y) / R, *angle_from(x, y, pull_n)
    out, around = (
        np.interp(r, added.r, part, right=0.0) * (r < press.contact_radius)
        for part in _top_load(press, added)
    )
    along, aside = out * cos**2 - around * sin**2, (out + around) * sin * cos
    if not along.any():  # contact smaller than a cell
        along = (r < r.min() * (1 + SAME)).astype(float)
    cell = (contact.x_m[1] - contact.x_m[0]) * (contact.y_m[1] - contact.y_m[0])
    # The table smooths the edge's stress, but the sum is known.
    exact = Q / (float(along.sum()) * cell) if Q > 0.0 else 0.0
    e = np.array(pull_n) / (Q or 1.0)
    lean = np.interp(r, added.r, added.surface, right=0.0) * cos * R
    return replace(
        contact,
        displacement_m=contact.displacement_m + lean,
        shear_pa=exact * np.stack([along * e[0] - aside * e[1], along * e[1] + aside * e[0]]),
        lateral_n=(float(pull_n[0]), float(pull_n[1])),
        solution=ContactSolution.PULLED_TABLE,
        model=f"{contact.model}; pulled aside, to first order in the pull, friction {friction:g}",
    )


def angle_from(x: ndarray, y: ndarray, pull: tuple[float, float]) -> tuple[ndarray, ndarray]:
    """Return cosine and sine of the angle of points from a pull, from x to y; 1 and 0 on the axis."""
    away, Q = np.hypot(x, y), math.hypot(*pull) or 1.0
    scale = np.where(away > 0.0, away, 1.0) * Q
    cos, sin = (x * pull[0] + y * pull[1]) / scale, (y * pull[0] - x * pull[1]) / scale
    return np.where(away > 0.0, cos, 1.0), sin


def _top_load(press: TabulatedPress, added: PulledStress) -> tuple[Knots, Knots]:
    """Load on the top per area seen from above that the pull adds: outwards and around [E]."""
    slope = np.interp(added.r, press.r, np.gradient(press.surface.astype(float), press.r))
    rr, _, _, rz, rt, tz = added.stress[:, 0]
    return slope * rr - rz, slope * rt - tz
