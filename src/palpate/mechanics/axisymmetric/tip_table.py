"""Tables at finite strain of a hemispherical tip pressed head-on on an elastic cylinder.

Tip and specimen are neo-Hookean (nu = 0.48) without friction; equator and base are fixed. Solved by
`tools/tip_tables.py`, with mesh errors of 0.3 % in area and 0.02 % in approach and flattening. Each table has
one tip on nine moduli, the stiffest rigid, at forty forces up to 5.5 N; interpolation is over 1 / (1 + E /
E0) and the cube root of force.

A tip with any modulus ratio of skin and gel between the shipped tables, on a rigid plate.

Shapes, and logarithms of force and moduli, are polynomials of the log ratio through all tables at each depth.
Solved by `tools/tip_tables.py`. Interpolation errors: 2 um and 0.5 % of force for ratios from 14 to
45, 3 % at 3.5.

Tables at finite strain of a hemispherical tip pressed along its axis on an inclined cylinder, without
friction.

Solved in three dimensions by `tools/inclined_tables.py`: the tip "base" at 30 degrees on cylinders of 0.035
MPa and stiffer, and at 45 degrees on 0.2419 MPa and stiffer. The edge's mesh error is corrected by head-on
presses. Moduli are interpolated over the head-on approach at `COMPARED_N` (area as a ratio to the head-on
one), tilts are not. The tip's axis is z, up to its base; the top's normal is tilted from z towards -x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from importlib import resources

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from palpate.core import Bool, Float, InputError, RangeError, ndarray
from palpate.mechanics.axisymmetric.disc_table import SAME

TURNING_PA = 6e4  # E0, about the tip's stiffness
FOLDER = "tip_tables"

Levels = Float[ndarray, " f"]


class ForceColumns:
    """Columns of a table over force, interpolated in its cube root; `columns` names them."""

    columns: tuple[str, ...]
    force_n: Levels
    approach_m: Levels

    def at(self, column: str, force_n: Float[ndarray, " k"]) -> Float[ndarray, k * n]:
        """A column at other forces."""
        force = np.asarray(force_n, np.float64)
        if force.size and not (force.min() >= 0 and force.max() <= self.force_n[-1]):
            raise RangeError(
                f"forces of {force.min():g} to {force.max():g} N; "
                f"the table holds 0 to {self.force_n[-1]:g} N",
                code="outside-table",
            )
        return np.asarray(self._curves[column](np.cbrt(force)))

    def force_within(self, approach_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Force at approaches inside the table [N]."""
        force = np.asarray(self._cube_root_of_force(approach_m)) ** 3
        return np.minimum(force, self.force_n[-1])  # against rounding

    @cached_property
    def _curves(self) -> dict[str, PchipInterpolator]:
        root = np.cbrt(self.force_n)
        return {name: PchipInterpolator(root, getattr(self, name)) for name in self.columns}

    @cached_property
    def _cube_root_of_force(self) -> PchipInterpolator:
        return PchipInterpolator(self.approach_m, np.cbrt(self.force_n))


@dataclass(frozen=True)
class HeadOnPress(ForceColumns):
    """One tip on one specimen, at the table's forces; SI.

    Attributes:
        approach_m: Displacement of the tip's base since first touch [m].
        flattening_m: Displacement of the tip's apex [m].
        radius_m, angle_rad: Contact radius [m], and polar angle of its edge on the tip.
        polar_rad: Points of the skin's inside, from the axis to the equator.
        inside_m: Their (r, z) from the undeformed apex ``[f n 2]`` [m].
        energy_pa: Strain energy density of the skin there [J/m^3].
    """

    force_n: Levels
    approach_m: Levels
    flattening_m: Levels
    radius_m: Levels
    angle_rad: Levels
    polar_rad: Float[ndarray, " n"]
    inside_m: Float[ndarray, "f n 2"]
    energy_pa: Float[ndarray, "f n"]

    columns = ("approach_m", "flattening_m", "radius_m", "angle_rad", "inside_m", "energy_pa", "area_m2")

    @property
    def area_m2(self) -> Levels:
        return np.pi * self.radius_m**2

    def force_at(self, approach_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Force at approaches; 0 before first touch [N]."""
        d, deepest = np.maximum(approach_m, 0.0), float(self.approach_m[-1])
        if d.size and d.max() > deepest * (1 + SAME):
            raise RangeError(
                f"an approach of {1e3 * d.max():.7g} mm; the table ends at {1e3 * deepest:.7g} mm"
            )
        return self.force_within(np.minimum(d, deepest))


@dataclass(frozen=True)
class TipTable:
    """One tip on every specimen; columns of `HeadOnPress` ``[specimens forces ...]``."""

    radius_m: float
    skin_m: float
    skin_pa: float
    gel_pa: float
    poisson_ratio: float
    specimen_radius_m: float
    specimen_height_m: float
    specimen_pa: Float[ndarray, " s"]
    columns: dict[str, Float[ndarray, s * n]]
    force_n: Levels
    polar_rad: Float[ndarray, " n"]

    def press(self, specimen_pa: float) -> HeadOnPress:
        """The tip on a specimen of a Young's modulus, `inf` for rigid [Pa]."""
        if not specimen_pa >= self.specimen_pa[0] * (1 - 1e-9):
            raise RangeError(
                f"a specimen of {specimen_pa:g} Pa; the table holds {self.specimen_pa[0]:g} Pa and stiffer"
            )
        columns = {name: spline(softness_share(specimen_pa)) for name, spline in self._splines.items()}
        return HeadOnPress(force_n=self.force_n, polar_rad=self.polar_rad, **columns)

    @cached_property
    def _splines(self) -> dict[str, CubicSpline]:
        softness = np.array([softness_share(E) for E in self.specimen_pa])
        order = np.argsort(softness)
        return {name: CubicSpline(softness[order], values[order]) for name, values in self.columns.items()}


def softness_share(specimen_pa: float) -> float:
    """Return 1 / (1 + E / E0): 0 for a rigid plate."""
    return 1.0 / (1.0 + specimen_pa / TURNING_PA)


def shipped_tips() -> tuple[str, ...]:
    """Return the names of the tabled tips."""
    folder = resources.files("palpate.mechanics") / FOLDER
    names = (path.name for path in folder.iterdir() if path.name.startswith("tip-"))
    return tuple(sorted(name.removeprefix("tip-").removesuffix(".npz") for name in names))


def loaded(name: str) -> dict[str, ndarray]:
    """Return the arrays of a shipped file; empty without such a file."""
    path = resources.files("palpate.mechanics") / FOLDER / name
    if not path.is_file():
        return {}
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        return {key: arrays[key].astype(np.float64) for key in arrays.files}


def from_rest(values: ndarray, first: ndarray | float = 0.0, axis: int = 1) -> ndarray:
    """Return values with the untouched tip's before the first along an axis."""
    start = np.broadcast_to(first, (*values.shape[:axis], 1, *values.shape[axis + 1 :]))
    return np.concatenate([start, values], axis=axis)


@cache
def tip_table(name: str) -> TipTable:
    """Return the table of a tip (cached)."""
    if name not in shipped_tips():
        raise InputError(f"no tip {name!r}; there are {', '.join(shipped_tips())}", code="unknown-name")
    data = loaded(f"tip-{name}.npz")
    radius_mm, skin_mm, skin_mpa, gel_mpa, nu = data["tip"]
    r_mm, h_mm = data["specimen"]
    return TipTable(
        1e-3 * radius_mm, 1e-3 * skin_mm, 1e6 * skin_mpa, 1e6 * gel_mpa, float(nu), 1e-3 * r_mm, 1e-3 * h_mm,
        1e6 * data["specimen_mpa"],
        _columns(data, 1e-3 * radius_mm, 1e-3 * skin_mm),
        np.concatenate([[0.0], data["force_n"]]),
        data["polar_rad"],
    )  # fmt: skip


def _columns(data: dict[str, ndarray], radius_m: float, skin_m: float) -> dict[str, ndarray]:
    """Columns in SI, with the untouched tip before the first force."""
    phi, inner = data["polar_rad"], radius_m - skin_m
    rest = np.stack([inner * np.sin(phi), radius_m - inner * np.cos(phi)], axis=-1)
    return {"approach_m": from_rest(1e-3 * data["approach_mm"])} | skin_columns(data, rest)


def skin_columns(data: dict[str, ndarray], rest: Float[ndarray, "n 2"]) -> dict[str, ndarray]:
    """Return the columns of contact and skin in SI, with the untouched tip first."""
    return {
        "flattening_m": from_rest(1e-3 * data["flattening_mm"]),
        "radius_m": from_rest(1e-3 * data["radius_mm"]),
        "angle_rad": from_rest(data["angle_rad"]),
        "inside_m": from_rest(1e-3 * data["inside_mm"], rest),
        "energy_pa": from_rest(1e6 * data["energy_mpa"]),
    }


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


SAME_TILT = 1e-6  # rad
COMPARED_N = 3.0
TINY_M2 = 1e-12  # the contact at no force, of which there is a ratio too


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
