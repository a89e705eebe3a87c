"""Tables of a hemispherical tip pressed head-on on a domed cylinder or a bonded layer.

The tables hold differences from the flat tables of `tip_table`: of a dome of radius R from the flat cylinder
of equal modulus, and of a layer of thickness h from a rigid plate, with splines over 1/R or log h, and 1 / (1
+ E / E0). Solved by `tools/specimen_tables.py`.

Tables at finite strain of a rigid sphere pressed deep into a bonded elastomer disc, and their edge
correction.

Frictionless, or with one coefficient of Coulomb friction. Material, units, and interpolation are those of
`disc_table`. Solved by `tools/disc_tables.py`; mesh errors are in `tools/mesh_study.json`. Scalars are
interpolated as F / d^(3/2), a / d^(1/2), and p / d^(1/2), starting at Hertz's values; fields are stretched
with the contact's edge. Near the free rim `edge_correction` holds the loss of force and the lateral push,
from three-dimensional solutions by `tools/off_centre.py`.

Tables at finite strain of a rigid upright punch with a rounded edge, pressed into a bonded disc.

The punch has radius R and an edge radius of 0.1 R, without friction. Material, units, and interpolation are
those of `disc_table`. Solved by `tools/disc_tables.py`; mesh errors are in `tools/punch_study.json`. Scalars
are interpolated as F / d, a, and p / d^(2/3). On the punch's upright side the top rises within one knot.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from importlib import resources
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator, RegularGridInterpolator

from palpate.core import Contact, ContactSolution, Float, InputError, Pose, Probe, RangeError, ndarray
from palpate.mechanics.axisymmetric.disc_table import (
    DiscTable,
    Fields,
    Knots,
    TabulatedPress,
    pressed_contact,
)
from palpate.mechanics.axisymmetric.tip_table import (
    HeadOnPress,
    TipTable,
    from_rest,
    loaded,
    softness_share,
    tip_table,
)
from palpate.mechanics.half_space.hertz import GRID_POINTS, grid_around, positive

SCALARS = ("approach_m", "flattening_m", "radius_m", "angle_rad")
FIELDS = ("inside_m", "energy_pa")
TO_SI = {"approach_m": 1e-3, "flattening_m": 1e-3, "radius_m": 1e-3, "inside_m": 1e-3, "energy_pa": 1e6}

Grid = Float[ndarray, "k e f *n"]


@dataclass(frozen=True)
class ShapeGrid:
    """Differences over a family of shapes (1/R [1/m] or log h) and moduli [Pa]: columns ``[shapes moduli
    forces ...]``.
    """

    shape: Float[ndarray, " k"]
    modulus_pa: Float[ndarray, " e"]
    columns: dict[str, Grid]

    def at(self, shape: float, modulus_pa: float) -> dict[str, ndarray]:
        """Differences of one specimen ``[forces ...]``."""
        s = softness_share(modulus_pa)
        return {name: CubicSpline(self.shape, over(s))(shape) for name, over in self._over_softness.items()}

    @cached_property
    def _over_softness(self) -> dict[str, CubicSpline]:
        s = np.array([softness_share(E) for E in self.modulus_pa])
        order = np.argsort(s)
        return {
            name: CubicSpline(s[order], values[:, order], axis=1) for name, values in self.columns.items()
        }


@dataclass(frozen=True)
class ShapeTable:
    """One tip on domes and layers: its flat table, and the differences."""

    flat: TipTable
    domes: ShapeGrid
    layers: ShapeGrid

    @property
    def least_radius_m(self) -> float:
        """Minimum radius of a dome [m]."""
        return float(1 / self.domes.shape[-1])

    @property
    def thickness_m(self) -> tuple[float, float]:
        """Minimum and maximum thickness of a layer [m]."""
        low, high = np.exp(self.layers.shape[[0, -1]])
        return float(low), float(high)

    def dome(self, radius_m: float, modulus_pa: float) -> HeadOnPress:
        """The tip on a domed cylinder of a radius, inf for flat [m], and Young's modulus,
        inf for rigid [Pa].
        """
        if not radius_m >= self.least_radius_m * (1 - 1e-9):
            raise RangeError(
                f"a sphere of {1e3 * radius_m:g} mm; {1e3 * self.least_radius_m:g} mm and larger are solved, "
                "the tip's own size",
                code="radius-outside-table",
            )
        return self._changed(modulus_pa, self.domes.at(1 / radius_m, modulus_pa))

    def layer(self, thickness_m: float, modulus_pa: float) -> HeadOnPress:
        """The tip on a bonded layer of a thickness [m] and Young's modulus [Pa]."""
        low, high = self.thickness_m
        if not low * (1 - 1e-9) <= thickness_m <= high * (1 + 1e-9):
            raise RangeError(
                f"a layer of {1e3 * thickness_m:g} mm; {1e3 * low:g} to {1e3 * high:g} mm are solved: a "
                "thinner one is nearly a rigid plate, a thicker one a cylinder",
                code="thickness-outside-table",
            )
        least = float(self.layers.modulus_pa.min())
        if not modulus_pa >= least * (1 - 1e-9):
            raise RangeError(
                f"a layer of {1e-6 * modulus_pa:g} MPa; {1e-6 * least:g} MPa and stiffer are solved",
                code="modulus-outside-table",
            )
        change = self.layers.at(float(np.log(thickness_m)), modulus_pa)
        return self._changed(np.inf, change)

    def _changed(self, modulus_pa: float, change: dict[str, ndarray]) -> HeadOnPress:
        press = self.flat.press(modulus_pa)
        columns = {name: getattr(press, name) + change[name] for name in (*SCALARS, *FIELDS)}
        return HeadOnPress(force_n=press.force_n, polar_rad=press.polar_rad, **columns)


@cache
def shape_table(name: str) -> ShapeTable:
    """Return the table of a tip on other shapes."""
    flat = tip_table(name)
    data = loaded(f"shapes-{name}.npz")
    if not data:
        raise InputError(
            f"the tip {name!r} has been solved on flat cylinders only; spheres and layers are of "
            "the tip 'base'",
            code="no-table",
        )
    domes = _grid("dome", data, data["dome_curvature_per_mm"] * 1e3)
    return ShapeTable(flat, domes, _grid("layer", data, np.log(1e-3 * data["layer_mm"])))


def _grid(family: str, data: dict[str, ndarray], shape: Float[ndarray, " k"]) -> ShapeGrid:
    columns = {}
    for name in (*SCALARS, *FIELDS):
        values = data[f"{family}_{name}"]
        if name in FIELDS:
            modes = data[f"{name}_modes"]
            values = np.tensordot(values, modes, axes=1)
        columns[name] = TO_SI.get(name, 1.0) * from_rest(values, axis=2)
    return ShapeGrid(shape, 1e6 * data[f"{family}_mpa"], columns)


DRAWN_TO = 2.0  # distance within which fields scale with the contact, in contact radii


@dataclass(frozen=True)
class SphereTable(DiscTable):
    """A sphere pressed step by step; see `DiscTable`.

    Interpolation errors: force 0.03 %, contact radius and maximum pressure 0.1 %, stress 0.1 % rms and 3 % at
    the edge.

    Example:
        >>> table = SphereTable.load("sphere-h2-mu0")
        >>> round(table.at(1.0).force, 2)
        2.51
    """

    INDENTER: ClassVar[str] = "sphere"
    POWERS: ClassVar[tuple[float, float, float]] = (1.5, 0.5, 0.5)

    def _first(self) -> tuple[float, float, float]:
        """Hertz's ratios."""
        E = 1.0 / (1.0 - self.poisson_ratio**2)
        return 4.0 / 3.0 * E, 1.0, 2.0 * E / math.pi

    def _brought(self, k: int, depth: float, F: float, a: float, p: float) -> Fields:
        """Depth k's fields scaled to another depth: like the contact near it, like the force far away."""
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


OFF_CENTRE = resources.files("palpate.mechanics") / "tables" / "off_centre.json"
SLACK = 1e-3  # tolerance for positions in whole millimetres
_FINE = 61  # additional offsets of the smooth curve


class EdgeCorrection(NamedTuple):
    """Force of an off-centre press, and outward push on the ball, over the centred normal force."""

    force_ratio: float
    side_ratio: float


def edge_correction(offset: float, depth: float, thickness: float) -> EdgeCorrection:
    """Return the correction of a centred press near the rim.

    Args:
        offset: Distance of the ball from the disc's axis, to 4.7 R [R].
        depth: 0 to 1 [R].
        thickness: 2 or 4 [R].

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
    """Maximum solved offset from the disc's axis, and depth [R]."""

    offset: float
    depth: float


def edge_reach(thickness: float) -> EdgeReach:
    """Return the solved range for a disc's thickness of 2 or 4 R."""
    offset, depth = (float(axis[-1]) for axis in _corrections(thickness).grid)
    return EdgeReach(offset, depth)


def edge_correction_held(
    offset: Float[ndarray, " n"], depth: Float[ndarray, " n"], thickness: float
) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    """Return force and push ratios of many presses, those of the nearest solved press beyond `edge_reach`
    [R].
    """
    table, reach = _corrections(thickness), edge_reach(thickness)
    at = np.clip(offset, 0.0, reach.offset), np.clip(depth, 0.0, reach.depth)
    force_ratio, side_ratio = np.moveaxis(table(np.stack(at, axis=-1)), -1, 0)
    return force_ratio, side_ratio


def _corrections(thickness: float) -> RegularGridInterpolator:
    tables = _off_centre()
    if thickness not in tables:
        raise RangeError(
            f"no press off the centre of a disc {thickness:g} R thick was solved; 2 R and 4 R were",
            code="outside-table",
        )
    return tables[thickness]


@lru_cache(maxsize=1)
def _off_centre() -> dict[float, RegularGridInterpolator]:
    """Both ratios over offset and depth, by thickness; at no depth those of the smallest solved one."""
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


EDGE = 0.1  # edge radius [R]


@dataclass(frozen=True)
class PunchedDisc(TabulatedPress):
    """The disc at one depth of a punch, with known contact normals."""

    @cached_property
    def top_load(self) -> Knots:
        """Pressure -n.s.n with the punch's normal, which sums to the force [E]."""
        sine = np.clip((self.r - (1.0 - EDGE)) / EDGE, 0.0, 1.0)
        cosine = np.sqrt(1.0 - sine**2)
        rr, _, zz, rz = self.stress[:, 0]
        pressure = -(sine**2 * rr + 2.0 * sine * cosine * rz + cosine**2 * zz)
        return np.asarray(pressure * (self.r < self.contact_radius))


@dataclass(frozen=True)
class PunchTable(DiscTable):
    """A rounded punch pressed step by step; see `DiscTable`."""

    INDENTER: ClassVar[str] = "punch"
    POWERS: ClassVar[tuple[float, float, float]] = (1.0, 0.0, 2.0 / 3.0)
    PRESSED: ClassVar[type[TabulatedPress]] = PunchedDisc


def is_punched(contact: Contact) -> bool:
    """Return whether a contact is of these tables."""
    return contact.probe.shape == PunchTable.INDENTER and contact.solution is ContactSolution.DISC_TABLE


KINDS: dict[str, type[DiscTable]] = {"sphere": SphereTable, "punch": PunchTable}


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
    """Press a rigid sphere or an upright rounded punch into a bonded disc, at finite strain.

    Off-centre presses are the centred one moved.

    Args:
        probe: Sphere or punch of radius R.
        pose: Position over a disc centred on the origin, and depth [m].
        youngs_modulus_pa: Small-strain modulus [Pa].
        thickness_m: Thickness of the disc [m].
        disc_radius_m: Radius of the disc, at least 5.7 R [m].
        friction: Coulomb coefficient, one of the shipped.
        poisson_ratio: That of the tables, 0.49.
        x_m, y_m: Columns and rows of the grid [m]; by default 81 points over 1.5 R to each side.

    Returns:
        Contact with the vertical load per area seen from above as pressure, and friction as shear.
    """
    kind = KINDS.get(probe.shape)
    if kind is None or (kind is PunchTable and probe.tilt_rad != 0.0):
        raise InputError(
            f"the tables are of a sphere and an upright punch, got probe shape {probe.shape!r}, leaning by "
            f"{probe.tilt_rad:g} rad; use shape 'sphere', or 'punch' upright",
            code="no-table",
        )
    R = probe.radius_m
    positive(f"the {probe.shape}'s radius", R, "m")
    positive("Young's modulus", youngs_modulus_pa, "Pa")
    positive("the disc's thickness", thickness_m, "m")
    positive("the disc's radius", disc_radius_m, "m")
    x, y, _ = grid_around(pose, np.linspace(-1.5 * R, 1.5 * R, GRID_POINTS), x_m, y_m)
    table = kind.of_disc(thickness_m / R, friction, poisson_ratio)
    return pressed_contact(table, probe, pose, youngs_modulus_pa, disc_radius_m, x, y)
