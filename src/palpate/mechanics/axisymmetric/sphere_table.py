"""Tables at finite strain of a rigid sphere pressed deep into a bonded elastomer disc, and their edge
correction.

Frictionless, or with one coefficient of Coulomb friction. Material, units, and interpolation are those of
`disc_table`. Solved by `tools/press_tables.py`; mesh errors are in `tools/mesh_study.json`. Scalars are
interpolated as F / d^(3/2), a / d^(1/2), and p / d^(1/2), starting at Hertz's values; fields are stretched
with the contact's edge. Near the free rim `edge_correction` holds the loss of force and the lateral push,
from three-dimensional solutions by `tools/off_centre.py`.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

from palpate.core import Contact, Float, InputError, Pose, Probe, RangeError, ndarray
from palpate.mechanics.axisymmetric.disc_table import (
    DiscTable,
    Fields,
    pressed_contact,
)
from palpate.mechanics.half_space.hertz import GRID_POINTS, grid_around, positive

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
    """Press a rigid sphere into a bonded disc, at finite strain; off-centre presses are the centred one
    moved.

    Args:
        probe: Sphere of radius R.
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
    table = SphereTable.of_disc(thickness_m / R, friction, poisson_ratio)
    return pressed_contact(table, probe, pose, E, disc_radius_m, x, y)


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
