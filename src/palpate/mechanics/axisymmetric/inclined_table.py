"""Tables at finite strain of a hemispherical tip pressed along its axis on an inclined cylinder, without
friction.

Solved in three dimensions by `tools/inclined_tables.py`: the tip "base" at 30 degrees on cylinders of 0.035
MPa and stiffer, and at 45 degrees on 0.2419 MPa and stiffer. The edge's mesh error is corrected by head-on
presses. Moduli are interpolated over the head-on approach at `COMPARED_N` (area as a ratio to the head-on
one), tilts are not. The tip's axis is z, up to its base; the top's normal is tilted from z towards -x.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from palpate.core import Bool, Float, RangeError, ndarray
from palpate.mechanics.axisymmetric.tip_table import (
    ForceColumns,
    HeadOnPress,
    TipTable,
    from_rest,
    loaded,
    tip_table,
)

SAME_TILT = 1e-6  # rad
COMPARED_N = 3.0
TINY_M2 = 1e-12  # the contact at no force, of which there is a ratio too

Levels = Float[ndarray, " f"]


@dataclass(frozen=True)
class SidePress(ForceColumns):
    """One tip on one inclined specimen, at the table's forces; SI.

    Attributes:
        force_n: Force along the tip's axis [N].
        area_m2: Contact area on the top's plane [m^2].
        across_rad, aside_rad: Points of the skin's inside at (cos b cos a, sin b, -cos b sin a); a from 0 to
            pi, b from 0 to pi / 2 [rad].
        moved_m: Displacement of these points ``[f a b 3]`` [m].
    """

    force_n: Levels
    approach_m: Levels
    area_m2: Levels
    across_rad: Float[ndarray, " a"]
    aside_rad: Float[ndarray, " b"]
    moved_m: Float[ndarray, "f a b 3"]

    columns = ("approach_m", "area_m2", "moved_m")

    def force_at(self, approach_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Force at approaches, limited to the table [N]."""
        return self.force_within(np.clip(approach_m, 0.0, self.approach_m[-1]))


@dataclass(frozen=True)
class InclinedTable:
    """One tip on the specimens of every tilt; columns ``[tilts specimens forces ...]`` with NaN for unsolved
    ones.
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
        """Which specimens are solved at which tilt."""
        return np.isfinite(self.columns["approach_m"][:, :, -1])

    @cached_property
    def softest_pa(self) -> Float[ndarray, " t"]:
        """Softest specimen at every tilt [Pa]."""
        return np.array([self.specimen_pa[there].min() for there in self.solved])

    def holds(self, specimen_pa: float, tilt_rad: float) -> bool:
        """Whether a press on a specimen, `inf` for rigid [Pa], at a tilt [rad] is tabled."""
        same = np.isclose(self.tilt_rad, tilt_rad, rtol=0, atol=SAME_TILT)
        return bool((same & (specimen_pa >= self.softest_pa * (1 - 1e-9))).any())

    def press(self, specimen_pa: float, tilt_rad: float) -> SidePress:
        """The tip on a specimen, `inf` for rigid [Pa], at a tilt [rad]."""
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
    """Head-on approach, the coordinate of a specimen in the table [m]."""
    return float(upright.at("approach_m", np.array([COMPARED_N]))[0])


@cache
def inclined_table(name: str) -> InclinedTable | None:
    """Return the table of a tip; None if there is none."""
    data = loaded(f"inclined-{name}.npz")
    if not data:
        return None
    in_si = {
        "approach_m": 1e-3 * data["approach_mm"],
        "area_m2": 1e-6 * data["area_mm2"],
        "moved_m": 1e-3 * data["unit_mm"] * _summed(data["moved_steps"]),
    }
    return InclinedTable(
        tip_table(name), np.deg2rad(data["tilt_deg"]), 1e6 * data["specimen_mpa"],
        np.concatenate([[0.0], data["force_n"]]), data["across_rad"], data["aside_rad"],
        {name: from_rest(values, axis=2) for name, values in in_si.items()},
    )  # fmt: skip


def _summed(steps: Float[ndarray, "3 t s f a b"]) -> Float[ndarray, "t s f a b 3"]:
    """Displacements from their stored differences."""
    for axis in (3, 4, 5):
        steps = np.cumsum(steps, axis=axis)
    return np.moveaxis(steps, 0, -1)
