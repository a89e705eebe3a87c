"""A tip with any modulus ratio of skin and gel between the shipped tables, on a rigid plate.

Shapes, and logarithms of force and moduli, are polynomials of the log ratio through all tables at each depth.
Solved by `tools/tip_tables.py --plate`. Interpolation errors: 2 um and 0.5 % of force for ratios from 14 to
45, 3 % at 3.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from palpate.core import Float, RangeError, ndarray
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress, from_rest, loaded, skin_columns, tip_table

PLATE = "plate.npz"


@dataclass(frozen=True)
class TipBetween:
    """A tip on a rigid plate; forces are proportional to the moduli at equal ratio."""

    radius_m: float
    skin_m: float
    skin_pa: float
    gel_pa: float
    press: HeadOnPress


def ratio_range() -> tuple[float, float]:
    """Return the minimum and maximum tabled modulus ratio."""
    logs = _plate().log_ratio
    return math.exp(float(logs.min())), math.exp(float(logs.max()))


@lru_cache(maxsize=256)
def tip_between(log_ratio: float) -> TipBetween:
    """Return the tip of a natural log ratio of skin and gel moduli (cached)."""
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
    """Tips at the same depths, the untouched first; columns of `HeadOnPress` ``[tips d ...]``."""

    approach_m: Float[ndarray, " d"]
    log_ratio: Float[ndarray, " k"]
    gel_pa: Float[ndarray, " k"]
    force_n: Float[ndarray, "k d"]
    columns: dict[str, ndarray]


@cache
def _plate() -> _Plate:
    data = loaded(PLATE)
    columns = skin_columns(data, tip_table("base").press(math.inf).inside_m[0])
    return _Plate(
        np.append(0.0, 1e-3 * data["approach_mm"]),
        np.log(data["skin_mpa"] / data["gel_mpa"]),
        1e6 * data["gel_mpa"],
        from_rest(data["force_n"]),
        columns,
    )


def _weights(knots: Float[ndarray, " k"], at: float) -> Float[ndarray, " k"]:
    away = [np.delete(knots, i) for i in range(len(knots))]
    return np.array(
        [np.prod((at - others) / (knot - others)) for knot, others in zip(knots, away, strict=True)]
    )
