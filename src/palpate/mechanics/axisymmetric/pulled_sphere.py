"""A rigid sphere, pressed deep into a bonded disc and pulled aside, to first order in the pull.

The disc, its material and the press without friction are those of `sphere_table`. About the pressed state
the sphere is moved along x at constant depth; skin that touches sticks to it, and slips where its traction
along the surface would exceed Coulomb's coefficient times the pressure. What the pull adds has one
harmonic,

    rr, tt, zz, rz and the surface's depth times cos t,      rt, tz times sin t,

t being the angle from the pull, about the sphere's axis where it is now. It is proportional to the force Q
of the pull, and of its share Q / (mu P) depends how far slip has come in. The tangent is the pressed
state's own, so that depth is not small; the pull is. Against a sphere dragged in three dimensions with
nothing left out (`tools/dragged_sphere.py`) the force is right to 3 % under friction 0.3 and 1, 0.3 to 1.2
R deep, to `MAX_SHIFT`. The stress is of first order.

The table holds modes of these fields on knots that grow with the contact, and how much of each a thickness,
depth and share take. Made by `tools/pulled_sphere_table.py`.
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
MAX_SHIFT = 0.45  # R of the sphere along the skin, to which the first order was held against three dimensions
FULL = 0.98  # of friction: the greatest share that was solved; held to where all slips
BETWEEN = 2.5  # R: up to this thickness those between two solved ones are drawn from all
REACHED = 5.4  # R, the last radius, clear of the rim's corner
NEAR = np.concatenate([np.linspace(0.0, 0.7, 11), np.arange(15, 27) * 0.05, [1.4, 1.55, 1.75, 2.0]])
FAR, DOWN = 16, 24  # knots outside two contact radii, and down to the base
FIRST = 0.06  # contact radii under the top: about the first knot


Knots = Float[ndarray, " n"]


def radii_of(contact_radius: float) -> Knots:
    """Spatial radii at which a contact's fields are held [R]."""
    far = np.geomspace(2.0 * contact_radius, REACHED, FAR + 1)[1:]
    return np.concatenate([NEAR * contact_radius, far])


def shares_down(contact_radius: float, depth: float, thickness: float) -> Knots:
    """Shares of the way from the top to the base at which they are held."""
    even = np.linspace(0.0, 1.0, DOWN + 1)
    first = 1.0 / (DOWN + (thickness - depth) / (FIRST * contact_radius))  # below that of equal steps
    stretch = brentq(lambda b: np.sinh(b * even[1]) / np.sinh(b) - first, 1e-6, 40.0)
    return np.sinh(stretch * even) / np.sinh(stretch)


class PulledStress(NamedTuple):
    """What a pull adds; amplitudes of the harmonic, lengths in R, stresses in E.

    Attributes:
        r: spatial radius about the sphere's axis where it is now.
        zeta: 0 at the deformed top, 1 at the base.
        stress: of `STRESSES` [6 m n].
        surface: depth of the top.
        shift: of the sphere along the pull, from where it was pressed.
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
        thickness, depth, share: axes: of the disc [R], of the press [R], of friction.
        stiffness: force over shift while all sticks, over Mindlin's 8 a G / (2 - nu) ``[h d]``.
        shift: over the same force's without slip ``[h d s]``.
        amount: of every mode ``[h d s k]``.
        mode: of stress and surface, over `scale` ``[k values]``.
        scale: of each value, times a^2 / Q of stress and a / Q of the surface.
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
        """What a pull of a force adds to a press.

        Args:
            press: without friction.
            force: Q, 0 to friction times the press's force [E R^2].
            friction: Coulomb's coefficient.
        """
        a, most = press.contact_radius, friction * press.force
        share = min(force / most, FULL)
        amount, slack = self._at(press.thickness, press.depth, share)
        values = amount @ self.mode * self.scale
        r, zeta = radii_of(a), shares_down(a, press.depth, press.thickness)
        stress = values[: -len(r)].reshape(6, len(zeta), len(r)) * (force / a**2)
        shift = force / self.stiffness_at(press) * slack
        return PulledStress(r, zeta, stress, values[-len(r) :] * (force / a), shift)

    def stiffness_at(self, press: TabulatedPress) -> float:
        """Force over shift while all sticks [E R]."""
        ratio = self.stiffness_ratio(np.array([press.depth]), press.thickness)
        return float(ratio[0]) * mindlin_stiffness(press.contact_radius)

    def stiffness_ratio(self, depth: Knots, thickness: float) -> Knots:
        """The same at many depths [R], over that of a half-space."""
        over = CubicSpline(np.sqrt(self.depth), self.stiffness[self._row(thickness)], axis=1)
        return self._mixed(over(np.sqrt(np.maximum(depth, self.depth[0]))), thickness)

    def covers(self, thickness: float) -> bool:
        """Whether pulls on a disc of a thickness were solved, or are drawn from others [R]."""
        return bool(np.isclose(self.thickness, thickness, rtol=SAME).any()) or bool(
            self.thickness[0] <= thickness <= BETWEEN
        )

    def force_of(self, press: TabulatedPress, shift: float, friction: float) -> float:
        """Force that a shift along the skin builds up, at most `FULL` of friction [E R^2]."""
        most = FULL * friction * press.force
        if not self.shift_of(press, most, friction) > shift:
            return most
        return float(brentq(lambda f: self.shift_of(press, f, friction) - shift, 0.0, most, xtol=1e-12))

    def shift_of(self, press: TabulatedPress, force: float, friction: float) -> float:
        """How far a force takes the sphere along [R]."""
        share = min(force / (friction * press.force), FULL)
        return force / self.stiffness_at(press) * self._at(press.thickness, press.depth, share)[1]

    def _row(self, thickness: float) -> ndarray:
        """Rows of the thicknesses that one is drawn from."""
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
        """By Lagrange's polynomial over 1 / thickness."""
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
    """8 a G / (2 - nu) of a half-space [E R]."""
    return 4.0 * contact_radius / ((1.0 + poisson_ratio) * (2.0 - poisson_ratio))


@lru_cache(maxsize=1)
def pulled_sphere_table() -> PulledSphereTable:
    """The shipped table, read once."""
    with resources.as_file(TABLE) as path, np.load(path, allow_pickle=False) as file:
        return PulledSphereTable(**{name: file[name].astype(float) for name in file.files})


def pulled(
    contact: Contact,
    press: TabulatedPress,
    youngs_modulus_pa: float,
    pull_n: tuple[float, float],
    friction: float,
) -> Contact:
    """A pressed contact with a pull on top, that came in one go.

    Args:
        contact: of a sphere, pressed by the table without friction; its pose is where the sphere is now.
        press: that of the table.
        youngs_modulus_pa: of the disc, by which the contact's force is that of the press [Pa].
        pull_n: force of the sphere on the skin along x and y [N].
        friction: Coulomb's coefficient.

    Returns:
        The contact. Its shear is what the pull adds to the load along x and y per area seen from above,
        friction and turned pressure together. It is made to sum to the pull by one factor, as the table holds
        too little of the edge, which stands upright under a deep press: 1.03 to 1.09 to 0.8 R deep, up to 1.3
        at 1.1 R and 1.5 at 1.2 R, so much too high inside. Its pressure and its edge stay as they were, as
        under Cattaneo and Mindlin; in three dimensions the pressure's centre moves by up to 0.02 R against
        the sphere's.
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
    if not along.any():  # a contact smaller than a cell
        along = (r < r.min() * (1 + SAME)).astype(float)
    cell = (contact.x_m[1] - contact.x_m[0]) * (contact.y_m[1] - contact.y_m[0])
    # The edge's stress is smoothed, and the sum is known.
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
    """Cosine and sine of the angle of places from a pull, in the sense from x to y; 1 and 0 on the axis."""
    away, Q = np.hypot(x, y), math.hypot(*pull) or 1.0
    scale = np.where(away > 0.0, away, 1.0) * Q
    cos, sin = (x * pull[0] + y * pull[1]) / scale, (y * pull[0] - x * pull[1]) / scale
    return np.where(away > 0.0, cos, 1.0), sin


def _top_load(press: TabulatedPress, added: PulledStress) -> tuple[Knots, Knots]:
    """Load on the top per area seen from above that the pull adds: outwards and around [E]."""
    slope = np.interp(added.r, press.r, np.gradient(press.surface.astype(float), press.r))
    rr, _, _, rz, rt, tz = added.stress[:, 0]
    return slope * rr - rz, slope * rt - tz
