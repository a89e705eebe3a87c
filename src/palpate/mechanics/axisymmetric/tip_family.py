"""A tip whose skin and gel are of any stiffness between those of the shipped tables, on a rigid plate.

All shipped tips are of one size, so that a press is told by two numbers: by how far the tip is pushed in, and
by the ratio of the moduli of skin and gel; the force is in proportion to both moduli together. A tip between
the tables has at each depth its shape, and the logarithms of its force and of its moduli, on a polynomial of
the ratio's logarithm through all tables. Solved by `tools/tip_tables.py --plate`, as the tables are, to one
depth. Against tips solved anew at ratios between the tables, from 14 to 45, shapes are off by 2 um and forces
by 0.5 %; between 1 and 10, where no table stands, at 3.5 by 3 % of force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import resources

import numpy as np

from palpate.core import Float, RangeError, ndarray
from palpate.mechanics.axisymmetric.tip_table import FOLDER, HeadOnPress, tip_table

PLATE = "plate.npz"


@dataclass(frozen=True)
class TipBetween:
    """A tip on a rigid plate.

    Attributes:
        radius_m, skin_m: of the dome, and the thickness of its skin [m].
        skin_pa, gel_pa: Young's moduli; any others of the same ratio have the same shapes, and forces in
            proportion [Pa].
        press: of the tip with these moduli on the plate.
    """

    radius_m: float
    skin_m: float
    skin_pa: float
    gel_pa: float
    press: HeadOnPress


def ratio_range() -> tuple[float, float]:
    """Least and greatest ratio of skin's and gel's modulus that there are tables of."""
    logs = _plate().log_ratio
    return math.exp(float(logs.min())), math.exp(float(logs.max()))


@lru_cache(maxsize=256)
def tip_between(log_ratio: float) -> TipBetween:
    """The tip of a ratio of moduli.

    Args:
        log_ratio: natural logarithm of the skin's modulus over the gel's.
    """
    low, high = ratio_range()
    if not low * (1 - 1e-9) <= math.exp(log_ratio) <= high * (1 + 1e-9):
        raise RangeError(
            f"a skin {math.exp(log_ratio):.3g} times as stiff as the gel; there are tables from {low:.3g} to "
            f"{high:.3g} times",
            code="outside-table",
        )
    plate = _plate()
    weights = _weights(plate.log_ratio, log_ratio)
    base = tip_table("base")
    columns = {name: np.tensordot(weights, values, 1) for name, values in plate.columns.items()}
    gel_pa = math.exp(float(weights @ np.log(plate.gel_pa)))
    force_n = gel_pa * np.exp(weights @ np.log(plate.force_n[:, 1:] / plate.gel_pa[:, None]))
    press = HeadOnPress(
        force_n=np.append(0.0, force_n), approach_m=plate.approach_m, polar_rad=base.polar_rad, **columns
    )
    return TipBetween(base.radius_m, base.skin_m, gel_pa * math.exp(log_ratio), gel_pa, press)


@dataclass(frozen=True)
class _Plate:
    """Tips at the same depths, the untouched first; see `HeadOnPress` for the columns ``[tips d ...]``."""

    approach_m: Float[ndarray, " d"]
    log_ratio: Float[ndarray, " k"]
    gel_pa: Float[ndarray, " k"]
    force_n: Float[ndarray, "k d"]
    columns: dict[str, ndarray]


@cache
def _plate() -> _Plate:
    path = resources.files("palpate.mechanics") / FOLDER / PLATE
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        data = {key: arrays[key].astype(np.float64) for key in arrays.files}
    rest = tip_table("base").press(math.inf).inside_m[0]

    def from_rest(values: ndarray, first: ndarray | float = 0.0) -> ndarray:
        start = np.broadcast_to(first, (len(values), 1, *values.shape[2:]))
        return np.concatenate([start, values], axis=1)

    columns = {
        "flattening_m": from_rest(1e-3 * data["flattening_mm"]),
        "radius_m": from_rest(1e-3 * data["radius_mm"]),
        "angle_rad": from_rest(data["angle_rad"]),
        "inside_m": from_rest(1e-3 * data["inside_mm"], rest),
        "energy_pa": from_rest(1e6 * data["energy_mpa"]),
    }
    return _Plate(
        np.append(0.0, 1e-3 * data["approach_mm"]),
        np.log(data["skin_mpa"] / data["gel_mpa"]),
        1e6 * data["gel_mpa"],
        from_rest(data["force_n"]),
        columns,
    )


def _weights(knots: Float[ndarray, " k"], at: float) -> Float[ndarray, " k"]:
    """Lagrange's polynomials through the knots."""
    away = [np.delete(knots, i) for i in range(len(knots))]
    return np.array(
        [np.prod((at - others) / (knot - others)) for knot, others in zip(knots, away, strict=True)]
    )
