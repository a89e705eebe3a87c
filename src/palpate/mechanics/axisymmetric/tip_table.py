"""Tables at finite strain of a hemispherical tip pressed head-on on an elastic cylinder.

Tip and specimen are neo-Hookean (nu = 0.48) without friction; equator and base are fixed. Solved by
`tools/tip_tables.py`, with mesh errors of 0.3 % in area and 0.02 % in approach and flattening. Each table has
one tip on nine moduli, the stiffest rigid, at forty forces up to 5.5 N; interpolation is over 1 / (1 + E /
E0) and the cube root of force.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from palpate.core import Float, InputError, RangeError, ndarray
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
