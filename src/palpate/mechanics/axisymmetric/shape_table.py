"""Tables of a hemispherical tip pressed head-on on a domed cylinder or a bonded layer.

The tables hold differences from the flat tables of `tip_table`: of a dome of radius R from the flat cylinder
of equal modulus, and of a layer of thickness h from a rigid plate, with splines over 1/R or log h, and 1 / (1
+ E / E0). Solved by `tools/specimen_tables.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.mechanics.axisymmetric.tip_table import (
    HeadOnPress,
    TipTable,
    from_rest,
    loaded,
    softness_share,
    tip_table,
)

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
