"""A rigid sphere pressed deep into a bonded elastomer disc, centred or not: tables solved at finite strain.

The tables hold a nearly incompressible neo-Hookean disc, W = mu/2 (tr C - 3) - mu ln J + lambda/2 (J - 1)^2,
with nu = 0.49, its base bonded, its side and its top around the contact free. Lengths in sphere radii R and
stresses in Young's moduli E make one table serve any R and E. The sphere slides without friction, or with
Coulomb's at one coefficient. Solved by `tools/press_tables.py`; `tools/mesh_study.json` holds what its mesh
costs.

Between depths d the scalars are read as F / d^(3/2), a / d^(1/2) and p / d^(1/2), which start at Hertz's
values and bend little. While the edge of the contact crosses more than a knot between two depths, the fields
are drawn out with it (a similar contact, as under Hertz) before they are mixed.

The ball is in the middle of its disc. Nearer to the free rim the disc gives way more, and pushes the ball
sideways: `edge_correction` holds both, solved in three dimensions by `tools/off_centre.py`, without friction,
at finite strain, for the tables' discs; `tables/off_centre.json` holds the forces.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

from palpate.core import Contact, Float, Float32, InputError, Pose, Probe, RangeError, ndarray
from palpate.mechanics.half_space.hertz import GRID_POINTS, grid_around, positive

DRAWN_TO = 2.0  # contact radii from the centre within which a field follows the contact's edge
SAME = 1e-6  # relative: two lengths or coefficients that differ by rounding only

Knots = Float[ndarray, " n"]


@dataclass(frozen=True)
class TabulatedPress:
    """The disc at one depth; the attributes are those of `SphereTable`, in its units."""

    depth: float
    force: float
    contact_radius: float
    peak_pressure: float
    r: Knots
    zeta: Float[ndarray, " m"]
    surface: Knots
    stress: Float[ndarray, "4 m n"]
    thickness: float
    disc_radius: float

    @cached_property
    def top_load(self) -> Knots:
        """Vertical load on the top per area seen from above [E], positive in compression; sums to the force.

        Without friction this is the pressure, since a surface's tilt lengthens it as it turns the pressure.
        """
        slope = np.gradient(self.surface, self.r)
        return np.asarray(slope * self.stress[3, 0] - self.stress[2, 0]) * (self.r < self.contact_radius)

    @cached_property
    def top_friction(self) -> Knots:
        """Friction of the sphere on the skin along the surface, outwards positive [E]."""
        slope = np.gradient(self.surface, self.r)
        rr, _, zz, rz = self.stress[:, 0]
        along = (slope * (rr - zz) + (slope**2 - 1.0) * rz) / (1.0 + slope**2)
        return np.asarray(along) * (self.r < self.contact_radius)


@dataclass(frozen=True)
class SphereTable:
    """A sphere pressed step by step; lengths in R, stresses in E, forces in E R^2, z into the layer.

    Attributes:
        thickness, disc_radius, poisson_ratio: of the disc.
        friction: Coulomb's coefficient.
        depth: ascending from 0.
        force, contact_radius, peak_pressure: at each depth; the pressure is the greatest -n.s.n of the top.
        r: spatial radius, graded, from 0 to disc_radius.
        zeta: 0 at the deformed top, 1 at the base, graded.
        surface: z of the deformed top at r, positive where pressed in.
        stress: Cauchy stress rr, tt, zz, rz at (r, zeta), where z = surface + zeta (thickness - surface).

    Example:
        >>> table = SphereTable.load("sphere-h2-mu0")
        >>> round(table.at(1.0).force, 2)
        2.51
    """

    thickness: float
    disc_radius: float
    poisson_ratio: float
    friction: float
    depth: Float[ndarray, " d"]
    force: Float[ndarray, " d"]
    contact_radius: Float[ndarray, " d"]
    peak_pressure: Float[ndarray, " d"]
    r: Float[ndarray, " n"]
    zeta: Float[ndarray, " m"]
    surface: Float32[ndarray, "d n"]
    stress: Float32[ndarray, "d 4 m n"]

    @property
    def greatest_depth(self) -> float:
        """The deepest press of the table [R]."""
        return float(self.depth[-1])

    @staticmethod
    @lru_cache
    def load(name: str) -> SphereTable:
        """A shipped table, read once."""
        if name not in shipped():
            raise InputError(f"no press table {name!r} is shipped; give one of {', '.join(shipped())}")
        with resources.as_file(resources.files("palpate.mechanics") / "tables" / f"{name}.npz") as path:
            return SphereTable.open(path)

    @classmethod
    def open(cls, path: Path) -> SphereTable:
        """A table from an .npz file written by `tools/press_tables.py`."""
        with np.load(path, allow_pickle=False) as file:
            values: dict[str, Any] = {key: file[key] if file[key].ndim else float(file[key]) for key in file}
        return cls(**values)

    def at(self, depth: float) -> TabulatedPress:
        """The disc at one depth [R].

        Against solving the depth itself, halfway between the table's: force within 0.03 %, contact radius and
        greatest pressure within 0.1 %, stress within 0.1 % rms and, at the contact's edge, 3 % of the
        greatest.
        """
        if not 0.0 <= depth <= self.greatest_depth * (1.0 + SAME):
            raise RangeError(
                f"depth {depth:g} R lies outside 0 to {self.greatest_depth:g} R, where the table was solved; "
                "press less deeply or use a larger sphere"
            )
        depth = min(depth, self.greatest_depth)
        force, radius, pressure = (
            float(depth**power * ratio(depth))
            for power, ratio in zip((1.5, 0.5, 0.5), self._ratios, strict=True)
        )
        fields = (self.r, self.zeta, *self._fields(depth, force, radius, pressure))
        return TabulatedPress(
            float(depth), force, radius, pressure, *fields, self.thickness, self.disc_radius
        )

    def contact_radius_at(self, depth: float) -> float:
        """The contact's radius at a depth of the table, as `at` gives it [R]."""
        return float(depth**0.5 * self._ratios[1](depth))

    def force_at(self, depth: Knots) -> Knots:
        """Forces at many depths [R], as `at` gives them one by one [E R^2]."""
        if not np.all((depth >= 0.0) & (depth <= self.greatest_depth * (1.0 + SAME))):
            raise RangeError(
                f"depths of {np.min(depth):g} to {np.max(depth):g} R; the table was solved from 0 to "
                f"{self.greatest_depth:g} R"
            )
        depth = np.minimum(depth, self.greatest_depth)
        return np.asarray(depth**1.5 * self._ratios[0](depth))

    @cached_property
    def _ratios(self) -> tuple[PchipInterpolator, PchipInterpolator, PchipInterpolator]:
        """F / d^(3/2), a / d^(1/2), p / d^(1/2) over depth, from Hertz's values at first touch."""
        E = 1.0 / (1.0 - self.poisson_ratio**2)
        d = self.depth[1:]
        first = (4.0 / 3.0 * E, 1.0, 2.0 * E / math.pi)
        rest = (self.force[1:] / d**1.5, self.contact_radius[1:] / d**0.5, self.peak_pressure[1:] / d**0.5)
        force, radius, pressure = (
            PchipInterpolator(self.depth, np.concatenate([[start], values]))
            for start, values in zip(first, rest, strict=True)
        )
        return force, radius, pressure

    def _fields(self, depth: float, F: float, a: float, p: float) -> tuple[Knots, Float[ndarray, "4 m n"]]:
        if depth == 0.0:
            return np.zeros_like(self.r), np.zeros(self.stress.shape[1:])
        k = int(np.clip(np.searchsorted(self.depth, depth), 1, len(self.depth) - 1))
        if k == 1:  # below the first depth every press is like it, only smaller
            return self._stretch(1, depth, F, a, p)
        edges = self.contact_radius[k - 1 : k + 1]
        if edges[1] - edges[0] > np.interp(edges[1], self.r[1:], np.diff(self.r)):
            low, high = (self._stretch(i, depth, F, a, p) for i in (k - 1, k))
        else:
            low, high = ((self.surface[i].astype(float), self.stress[i].astype(float)) for i in (k - 1, k))
        share = (depth - self.depth[k - 1]) / (self.depth[k] - self.depth[k - 1])
        return (1.0 - share) * low[0] + share * high[0], (1.0 - share) * low[1] + share * high[1]

    def _stretch(
        self, k: int, depth: float, F: float, a: float, p: float
    ) -> tuple[Knots, Float[ndarray, "4 m n"]]:
        """Depth k's fields brought to another depth: like the contact near it, like the force afar."""
        away = np.hypot(self.r, self.zeta[:, None] * self.thickness) / (DRAWN_TO * a)
        share = 1.0 / (1.0 + away**4)
        stretch = 1.0 + (self.contact_radius[k] / a - 1.0) * share
        r = np.clip(self.r * stretch, 0.0, self.r[-1])
        zeta = np.clip(self.zeta[:, None] * stretch, 0.0, 1.0)
        field = RegularGridInterpolator((self.zeta, self.r), np.moveaxis(self.stress[k].astype(float), 0, -1))
        scale = share * p / self.peak_pressure[k] + (1.0 - share) * F / self.force[k]
        surface = np.interp(r[0], self.r, self.surface[k])
        factor = share[0] * depth / self.depth[k] + (1.0 - share[0]) * F / self.force[k]
        return surface * factor, np.moveaxis(field((zeta, r)), -1, 0) * scale


def shipped() -> tuple[str, ...]:
    """Names of the tables that come with palpate, as "sphere-h2-mu0": thickness 2 R, friction 0."""
    names = (p.name for p in resources.files("palpate.mechanics").joinpath("tables").iterdir())
    tables = (name for name in names if name.startswith("sphere-") and name.endswith(".npz"))
    return tuple(sorted(name.removesuffix(".npz") for name in tables))


def press_finite_strain(
    probe: Probe,
    pose: Pose,
    youngs_modulus_pa: float,
    thickness_m: float,
    disc_radius_m: float,
    friction: float = 0.0,
    poisson_ratio: float = 0.49,
    x_m: Float[ndarray, " nx"] | None = None,
    y_m: Float[ndarray, " ny"] | None = None,
) -> Contact:
    """Press a rigid sphere into a bonded disc, at finite strain.

    An off-centre press is the centred one moved; the rim was 5.7 R away when it was solved.

    Args:
        probe: a sphere and its radius R [m].
        pose: where, over a disc centred on the origin, and how deep [m].
        youngs_modulus_pa: of the disc at small strain [Pa].
        thickness_m: of the disc; a shipped multiple of R [m].
        disc_radius_m: of the disc, 5.7 R or more [m].
        friction: Coulomb's coefficient, one of the shipped.
        poisson_ratio: of the disc; that of the tables, 0.49.
        x_m, y_m: columns and rows of the surface grid [m]; by default 81 points over 1.5 R to each side.

    Returns:
        The contact. Its pressure is the vertical load per area seen from above, so that it sums to the force;
        without friction it is the pressure normal to the skin. Its shear is friction alone.

    Raises:
        InputError: the probe is not a sphere, or the pose is not a finite position.
        RangeError: no table is solved for this thickness, friction or Poisson's ratio, the depth lies beyond
            the table, or the contact would reach over the disc's rim.
    """
    if probe.shape != "sphere":
        raise InputError(
            f"the press tables are of a sphere, got probe shape {probe.shape!r}; use shape 'sphere'"
        )
    R, E = probe.radius_m, youngs_modulus_pa
    positive("the sphere's radius", R, "m")
    positive("Young's modulus", E, "Pa")
    positive("the disc's thickness", thickness_m, "m")
    positive("the disc's radius", disc_radius_m, "m")
    around = np.linspace(-1.5 * R, 1.5 * R, GRID_POINTS)
    x, y, _ = grid_around(pose, around, x_m, y_m)
    table = table_for(thickness_m / R, friction, poisson_ratio)
    _fits(table, pose, R, disc_radius_m)
    at = table.at(min(pose.depth_m / R, table.greatest_depth))
    east, north = (x[None, :] - pose.x_m) / R, (y[:, None] - pose.y_m) / R
    r = np.hypot(east, north)
    inwards = np.interp(r, at.r, at.top_friction) * E / np.maximum(r, SAME)
    return Contact(
        x_m=x,
        y_m=y,
        pressure_pa=np.interp(r, at.r, at.top_load) * E,
        displacement_m=np.interp(r, at.r, at.surface) * R,
        touching=r < at.contact_radius,
        force_n=at.force * E * R**2,
        radius_m=at.contact_radius * R,
        probe=probe,
        pose=pose,
        model=f"finite-strain table: rigid sphere, bonded neo-Hookean disc {table.thickness:g} R thick, "
        f"nu {table.poisson_ratio:g}, friction {table.friction:g}, depth <= {table.greatest_depth:g} R",
        shear_pa=np.stack([inwards * east, inwards * north]) if friction > 0.0 else None,
    )


MAX_APART = 1.15  # of two solved thicknesses, between which one is drawn: their ratio
NEAREST = 3  # tables of other thicknesses that one between them is drawn from


def table_for(ratio: float, friction: float, poisson_ratio: float) -> SphereTable:
    """The shipped table of a disc, or one drawn from those of the nearest thicknesses.

    Between thicknesses every number is a parabola through three tables over 1 / thickness, each at the same
    depth, radius and share of the way down.

    Args:
        ratio: thickness over the sphere's radius.
        friction: Coulomb's coefficient.
        poisson_ratio: of the disc.

    Raises:
        RangeError: no table of this friction and Poisson's ratio, or a thickness outside those solved; or
            between them, where fewer than three were.
    """
    near = _solved_near(ratio, friction, poisson_ratio)
    if len(near) == 1:
        return near[0]
    if near:
        return _between(tuple(t.thickness for t in near), ratio, friction, poisson_ratio)
    tables = [SphereTable.load(name) for name in shipped()]
    choices = "; ".join(
        f"{t.thickness:g} R with friction {t.friction:g}, Poisson's ratio {t.poisson_ratio:g}" for t in tables
    )
    raise RangeError(
        f"no table is solved for a disc {ratio:g} R thick with friction {friction:g} and Poisson's ratio "
        f"{poisson_ratio:g}; choose a sphere radius R and a friction among: {choices}"
        f"; or a thickness between two that are within {100 * (MAX_APART - 1):.0f} % of each other"
    )


def is_tabled(ratio: float, friction: float, poisson_ratio: float) -> bool:
    """Whether `table_for` has one; arguments as there."""
    return bool(_solved_near(ratio, friction, poisson_ratio))


def _solved_near(ratio: float, friction: float, poisson_ratio: float) -> list[SphereTable]:
    """The table of a disc, or the three that one between them is drawn from, or none."""
    tables = [SphereTable.load(name) for name in shipped()]
    asked = friction, poisson_ratio
    alike = [t for t in tables if np.allclose((t.friction, t.poisson_ratio), asked, rtol=SAME, atol=SAME)]
    near = sorted(alike, key=lambda t: abs(1 / t.thickness - 1 / ratio))[:NEAREST]
    if near and math.isclose(near[0].thickness, ratio, rel_tol=SAME):
        return near[:1]
    below = max((t.thickness for t in alike if t.thickness < ratio), default=0.0)
    above = min((t.thickness for t in alike if t.thickness > ratio), default=math.inf)
    return near if len(near) == NEAREST and above <= MAX_APART * below else []


@lru_cache(maxsize=6)
def _stress_at_shares_of(
    own: float, other: float, friction: float, poisson_ratio: float
) -> Float[ndarray, "d 4 m n"]:
    """Stress of one solved thickness at another's shares of the way down; of all that is drawn from both."""
    table, at = (table_for(h, friction, poisson_ratio) for h in (own, other))
    return np.asarray(PchipInterpolator(table.zeta, table.stress.astype(float), axis=2)(at.zeta))


@lru_cache(maxsize=16)
def _between(
    thicknesses: tuple[float, ...], ratio: float, friction: float, poisson_ratio: float
) -> SphereTable:
    """A table of a thickness that was not solved, by Lagrange's polynomial over 1 / thickness."""
    tables = [table_for(h, friction, poisson_ratio) for h in thicknesses]
    inverse = 1 / np.array(thicknesses)
    weights = [
        float(np.prod([(1 / ratio - other) / (own - other) for other in inverse if other != own]))
        for own in inverse
    ]
    first = tables[0]
    depths = min((t.depth for t in tables), key=len)
    n = len(depths)

    def mixed(part: str) -> ndarray:
        return np.asarray(sum(w * getattr(t, part)[:n] for w, t in zip(weights, tables, strict=True)))

    stress = sum(
        w * _stress_at_shares_of(h, first.thickness, friction, poisson_ratio)[:n]
        for w, h in zip(weights, thicknesses, strict=True)
    )
    return SphereTable(
        thickness=ratio,
        disc_radius=first.disc_radius,
        poisson_ratio=poisson_ratio,
        friction=friction,
        depth=depths,
        force=mixed("force"),
        contact_radius=mixed("contact_radius"),
        peak_pressure=mixed("peak_pressure"),
        r=first.r,
        zeta=first.zeta,
        surface=mixed("surface").astype(np.float32),
        stress=np.asarray(stress, np.float32),
    )


def _fits(table: SphereTable, pose: Pose, R: float, disc_radius_m: float) -> None:
    if not 0.0 <= pose.depth_m <= table.greatest_depth * R * (1.0 + SAME):
        raise RangeError(
            f"depth {pose.depth_m * 1e3:g} mm of a sphere of radius {R * 1e3:g} mm lies outside 0 to "
            f"{table.greatest_depth * R * 1e3:g} mm, where its table was solved; press less deeply or use a "
            "larger sphere"
        )
    if disc_radius_m < table.disc_radius * R * (1.0 - SAME):
        raise RangeError(
            f"a disc of radius {disc_radius_m * 1e3:g} mm is smaller than the table's, "
            f"{table.disc_radius * R * 1e3:g} mm ({table.disc_radius:g} R); press a wider disc"
        )
    centre = math.hypot(pose.x_m, pose.y_m)
    reach = table.contact_radius_at(min(pose.depth_m / R, table.greatest_depth)) * R
    if centre + reach > disc_radius_m:
        raise RangeError(
            f"a contact of radius {reach * 1e3:.3g} mm, {centre * 1e3:.4g} mm from the centre, reaches over "
            f"the rim at {disc_radius_m * 1e3:g} mm; press within {(disc_radius_m - reach) * 1e3:.4g} mm of "
            "the centre"
        )


OFF_CENTRE = resources.files("palpate.mechanics") / "tables" / "off_centre.json"
SLACK = 1e-3  # a place named in whole millimetres may lie a hair beyond
_FINE = 61  # offsets, beside the solved ones, at which the smooth curve through these is kept


class EdgeCorrection(NamedTuple):
    """A press off the centre over the same press in the centre.

    Attributes:
        force_ratio: its force over the centred one's.
        side_ratio: the force with which the disc pushes the ball outwards, over the centred press's
            normal force.
    """

    force_ratio: float
    side_ratio: float


def edge_correction(offset: float, depth: float, thickness: float) -> EdgeCorrection:
    """Correction of a centred press for a place nearer to the rim.

    Args:
        offset: of the ball from the disc's axis, to 4.7 R: 23.5 mm under a ball of 5 mm [R].
        depth: 0 to 1 R.
        thickness: of the disc: 2 or 4 R.

    Example:
        >>> round(edge_correction(4.2, 1.0, 2.0).force_ratio, 3)
        0.927
    """
    table, greatest = _corrections(thickness), edge_reach(thickness)
    if not (0 <= offset <= greatest.offset * (1 + SLACK) and 0 <= depth <= greatest.depth * (1 + SLACK)):
        raise RangeError(
            f"{offset:g} R from the axis and {depth:g} R deep lies outside 0 to {greatest.offset:g} R and "
            f"0 to {greatest.depth:g} R, where presses were solved"
        )
    at = min(offset, greatest.offset), min(depth, greatest.depth)
    force_ratio, side_ratio = table(at).tolist()
    return EdgeCorrection(force_ratio, side_ratio)


class EdgeReach(NamedTuple):
    """Greatest offset of the ball from the disc's axis and greatest depth that were solved, both in R."""

    offset: float
    depth: float


def edge_reach(thickness: float) -> EdgeReach:
    """How far out and how deep presses off the centre were solved.

    Args:
        thickness: of the disc: 2 or 4 R.

    Raises:
        RangeError: another thickness.
    """
    offset, depth = (float(axis[-1]) for axis in _corrections(thickness).grid)
    return EdgeReach(offset, depth)


def edge_correction_held(
    offset: Float[ndarray, " n"], depth: Float[ndarray, " n"], thickness: float
) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    """Force ratio and side ratio of many presses; beyond `edge_reach` those of the nearest solved press hold.

    Args:
        offset: of the ball from the disc's axis [R].
        depth: of the press; below 0 as at 0 [R].
        thickness: of the disc: 2 or 4 R.

    Raises:
        RangeError: another thickness.
    """
    table, reach = _corrections(thickness), edge_reach(thickness)
    at = np.clip(offset, 0.0, reach.offset), np.clip(depth, 0.0, reach.depth)
    force_ratio, side_ratio = np.moveaxis(table(np.stack(at, axis=-1)), -1, 0)
    return force_ratio, side_ratio


def _corrections(thickness: float) -> RegularGridInterpolator:
    tables = _off_centre()
    if thickness not in tables:
        raise RangeError(
            f"no press off the centre of a disc {thickness:g} R thick was solved; 2 R and 4 R were"
        )
    return tables[thickness]


@lru_cache(maxsize=1)
def _off_centre() -> dict[float, RegularGridInterpolator]:
    """Both ratios over offset and depth, by thickness; at no depth those of the least one solved."""
    rows = json.loads(OFF_CENTRE.read_text(encoding="utf-8"))["presses"]
    return {
        h: _curves([row for row in rows if row["thickness"] == h]) for h in {row["thickness"] for row in rows}
    }


def _curves(rows: list[dict[str, float]]) -> RegularGridInterpolator:
    offsets, depths = (np.array(sorted({row[part] for row in rows})) for part in ("offset", "depth"))
    forces = {(row["offset"], row["depth"]): [row["force"], row["side_force"]] for row in rows}
    force, side = np.moveaxis(np.array([[forces[c, d] for d in depths] for c in offsets]), -1, 0)
    ratios = np.stack([force / force[0], -side / force[0]], axis=-1)
    fine = np.union1d(np.linspace(offsets[0], offsets[-1], _FINE), offsets)
    smooth = PchipInterpolator(offsets, ratios)(fine)
    return RegularGridInterpolator(
        (fine, np.append(0.0, depths)), np.concatenate([smooth[:, :1], smooth], axis=1)
    )
