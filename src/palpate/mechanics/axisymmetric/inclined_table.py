"""A hemispherical tip pressed along its axis on an inclined cylinder: tables solved at finite strain.

Solved in three dimensions by `tools/inclined_tables.py`, without friction, tip and cylinder at finite
strain as in `tip_table`. Shipped is the tip "base" at 30 degrees on cylinders of 0.035 MPa and stiffer, at
45 degrees on such of 0.2419 MPa and stiffer, up to a rigid plate. On softer ones at 45 degrees the contact
runs off the top. The cells see a contact's edge a little too far in; by how much is taken from presses at 0
degrees, which have a table of their own, and made good.

Between forces they are read as `tip_table` is; between moduli by a smooth curve over the head-on approach at
`COMPARED_N`, along which head-on presses hardly bend (area as its ratio to the head-on one); between tilts
they are not.

The tip's axis is z, upwards to its base; the top's normal leans from z towards -x by the tilt.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources

import numpy as np
from scipy.interpolate import CubicSpline

from palpate.core import Bool, Float, RangeError, ndarray
from palpate.mechanics.axisymmetric.tip_table import FOLDER, ForceColumns, HeadOnPress, TipTable, tip_table

SAME_TILT = 1e-6  # rad
COMPARED_N = 3.0
TINY_M2 = 1e-12  # the contact at no force, of which there is a ratio too

Levels = Float[ndarray, " f"]


@dataclass(frozen=True)
class SidePress(ForceColumns):
    """One tip on one inclined specimen, at the table's forces; SI.

    Attributes:
        force_n: along the tip's axis, from 0 [N].
        approach_m: of the tip's base along its axis since first touch [m].
        area_m2: of the contact, on the top's plane [m^2].
        across_rad, aside_rad: of places on the skin's inside, at (cos b cos a, sin b, -cos b sin a) from the
            dome's centre; a from 0 to pi, b from 0 to pi / 2 [rad].
        moved_m: how far these have moved ``[f a b 3]``: x, y, z, the tip's base at rest [m].
    """

    force_n: Levels
    approach_m: Levels
    area_m2: Levels
    across_rad: Float[ndarray, " a"]
    aside_rad: Float[ndarray, " b"]
    moved_m: Float[ndarray, "f a b 3"]

    columns = ("approach_m", "area_m2", "moved_m")

    def force_at(self, approach_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Force at approaches, 0 before first touch, the greatest beyond the table [N]."""
        return self.force_within(np.clip(approach_m, 0.0, self.approach_m[-1]))


@dataclass(frozen=True)
class InclinedTable:
    """One tip on the specimens of every tilt; see `SidePress` for the columns.

    Attributes:
        head_on: the same tip on the same specimens, upright.
        columns: ``[tilts specimens forces ...]``, NaN of specimens that were not solved at a tilt.
    """

    head_on: TipTable
    tilt_rad: Float[ndarray, " t"]
    specimen_pa: Float[ndarray, " s"]
    force_n: Levels
    across_rad: Float[ndarray, " a"]
    aside_rad: Float[ndarray, " b"]
    columns: dict[str, Float[ndarray, t * n]]

    @cached_property
    def solved(self) -> Bool[ndarray, "t s"]:
        """Which specimens there are at which tilt."""
        return np.isfinite(self.columns["approach_m"][:, :, -1])

    @cached_property
    def softest_pa(self) -> Float[ndarray, " t"]:
        """Young's modulus of the softest specimen at every tilt [Pa]."""
        return np.array([self.specimen_pa[there].min() for there in self.solved])

    def holds(self, specimen_pa: float, tilt_rad: float) -> bool:
        """Whether a press on a specimen, `inf` for a rigid plate [Pa], at a tilt [rad] is in the table."""
        same = np.isclose(self.tilt_rad, tilt_rad, rtol=0, atol=SAME_TILT)
        return bool((same & (specimen_pa >= self.softest_pa * (1 - 1e-9))).any())

    def press(self, specimen_pa: float, tilt_rad: float) -> SidePress:
        """The tip on a specimen of a Young's modulus, `inf` for a rigid plate [Pa], at a tilt [rad]."""
        if not self.holds(specimen_pa, tilt_rad):
            each = zip(self.softest_pa, np.rad2deg(self.tilt_rad).round(6), strict=True)
            raise RangeError(
                f"a specimen of {specimen_pa:g} Pa at {np.rad2deg(tilt_rad):g} degrees; the table holds "
                + ", ".join(f"{pa:g} Pa and stiffer at {tilt:g} degrees" for pa, tilt in each),
                code="outside-table",
            )
        which, upright = int(np.argmin(np.abs(self.tilt_rad - tilt_rad))), self.head_on.press(specimen_pa)
        columns = {name: curve(_place(upright)) for name, curve in self._curves[which].items()}
        columns["area_m2"] *= upright.at("area_m2", self.force_n)
        return SidePress(self.force_n, across_rad=self.across_rad, aside_rad=self.aside_rad, **columns)

    @cached_property
    def _curves(self) -> list[dict[str, CubicSpline]]:
        upright = [self.head_on.press(E) for E in self.specimen_pa]
        places = np.array([_place(one) for one in upright])
        areas = np.stack([np.maximum(one.at("area_m2", self.force_n), TINY_M2) for one in upright])
        columns = self.columns | {"area_m2": np.maximum(self.columns["area_m2"], TINY_M2) / areas}
        curves = []
        for tilt, there in enumerate(self.solved):
            order = np.flatnonzero(there)[np.argsort(places[there])]
            knots = places[order]
            if len(order) == 1:  # one specimen alone, a rigid plate
                knots, order = np.array([knots[0], knots[0] + 1.0]), np.repeat(order, 2)
            curves.append({name: CubicSpline(knots, of[tilt, order]) for name, of in columns.items()})
        return curves


def _place(upright: HeadOnPress) -> float:
    """Head-on approach, by which a specimen has its place among the table's [m]."""
    return float(upright.at("approach_m", np.array([COMPARED_N]))[0])


@cache
def inclined_table(name: str) -> InclinedTable | None:
    """The table of a tip; None where there is none."""
    path = resources.files("palpate.mechanics") / FOLDER / f"inclined-{name}.npz"
    if not path.is_file():
        return None
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        data = {key: arrays[key].astype(np.float64) for key in arrays.files}
    in_si = {
        "approach_m": 1e-3 * data["approach_mm"],
        "area_m2": 1e-6 * data["area_mm2"],
        "moved_m": 1e-3 * data["unit_mm"] * _summed(data["moved_steps"]),
    }
    return InclinedTable(
        tip_table(name), np.deg2rad(data["tilt_deg"]), 1e6 * data["specimen_mpa"],
        np.concatenate([[0.0], data["force_n"]]), data["across_rad"], data["aside_rad"],
        {name: _from_rest(values) for name, values in in_si.items()},
    )  # fmt: skip


def _summed(steps: Float[ndarray, "3 t s f a b"]) -> Float[ndarray, "t s f a b 3"]:
    """Motions from their steps from force to force and from place to place, as which they take less room."""
    for axis in (3, 4, 5):
        steps = np.cumsum(steps, axis=axis)
    return np.moveaxis(steps, 0, -1)


def _from_rest(values: Float[ndarray, "t s f *n"]) -> Float[ndarray, "t s g *n"]:
    """A column with the untouched tip before its first force."""
    return np.concatenate([np.zeros_like(values[:, :, :1]), values], axis=2)
