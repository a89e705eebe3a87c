"""The pressed membrane as the optics want it: the finite-strain table, in metres and pascals."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy import ndarray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from palpate.core.errors import RangeError
from palpate.core.shapes import Float
from palpate.mechanics.axisymmetric.sphere_table import SAME, SphereTable, TabulatedPress, shipped
from palpate.optics.axisymmetric import AxisymmetricField
from palpate.sensors.palm.spec import PalmSpec

FINER = 3  # times as many knots each way: the march reads between them along straight lines
FADED = (0.75, 0.95)
"""Shares of the table's radius from where to where its stress is faded out. Beyond, it is that of the rim of
a membrane pressed in its middle, and would stand where there is no rim under a press elsewhere."""

Knots = Float[ndarray, " n"]


@lru_cache(maxsize=32)
def _table(thickness: float, disc_radius: float, poisson_ratio: float, friction: float) -> SphereTable | None:
    """The shipped table of these proportions (lengths in ball radii); None if there is none."""
    for table in (SphereTable.load(name) for name in shipped()):
        held = np.array([table.thickness, table.poisson_ratio, table.friction])
        fits = np.allclose(held, [thickness, poisson_ratio, friction], rtol=SAME, atol=SAME)
        if fits and table.disc_radius <= disc_radius * (1 + SAME):
            return table
    return None


def has_table(spec: PalmSpec) -> bool:
    """Whether a table was solved for the spec's membrane under its ball."""
    R = spec.indenter_radius_m
    return _table(spec.thickness_m / R, spec.radius_m / R, spec.poisson_ratio, spec.friction) is not None


def table_of(spec: PalmSpec) -> SphereTable:
    """The shipped table whose membrane has the spec's proportions.

    Raises:
        RangeError: none was made for them; the message lists those there are.
    """
    R = spec.indenter_radius_m
    found = _table(spec.thickness_m / R, spec.radius_m / R, spec.poisson_ratio, spec.friction)
    if found is not None:
        return found
    known = "; ".join(
        f"{t.thickness * R * 1e3:g} mm thick, {2 * t.disc_radius * R * 1e3:g} mm wide or more, "
        f"nu {t.poisson_ratio:g}, friction {t.friction:g}"
        for t in map(SphereTable.load, shipped())
    )
    raise RangeError(
        f"no table for a membrane {spec.thickness_m * 1e3:g} mm thick, {spec.diameter_m * 1e3:g} mm wide, nu "
        f"{spec.poisson_ratio:g}, friction {spec.friction:g} under a ball of {2 * R * 1e3:g} mm; with this "
        f"ball there are: {known}"
    )


def pressed(spec: PalmSpec, depth_m: float) -> TabulatedPress:
    """The table at one depth, in sphere radii and moduli."""
    return table_of(spec).at(depth_m / spec.indenter_radius_m)


def depth_of_force(spec: PalmSpec, force_n: float) -> float:
    """How deep the spec's ball goes under a force [m].

    Raises:
        RangeError: a force that is negative, not a number, or beyond the table.
    """
    table, R = table_of(spec), spec.indenter_radius_m
    unit = spec.youngs_modulus_pa * R**2
    greatest = table.at(table.greatest_depth).force * unit
    if not 0 <= force_n <= greatest * (1 + SAME):
        raise RangeError(
            f"a force of {force_n:g} N lies outside 0 to {greatest:g} N, the table's deepest press of this "
            "membrane; press less"
        )
    if force_n == 0:
        return 0.0
    if force_n >= greatest:
        return table.greatest_depth * R
    return R * float(
        brentq(lambda d: table.at(d).force * unit - force_n, 0.0, table.greatest_depth, xtol=1e-13)
    )


def field_of(press: TabulatedPress, spec: PalmSpec, finer: int = FINER) -> AxisymmetricField:
    """The same in SI, on finer knots, without the rim's own stress."""
    R, E = spec.indenter_radius_m, spec.youngs_modulus_pa
    r, zeta = between(press.r, finer), between(press.zeta, finer)
    stress = PchipInterpolator(press.zeta, np.asarray(press.stress, dtype=float), axis=1)(zeta)
    stress = PchipInterpolator(press.r, stress, axis=2)(r)
    start, end = FADED
    share = np.clip((r / press.r[-1] - start) / (end - start), 0, 1)
    return AxisymmetricField(
        r_m=r * R,
        zeta=zeta,
        surface_m=PchipInterpolator(press.r, np.asarray(press.surface, dtype=float))(r) * R,
        thickness_m=press.thickness * R,
        stress_pa=stress * (E * (1 - share**2 * (3 - 2 * share))),
    )


def between(knots: Knots, finer: int) -> Float[ndarray, " m"]:
    """Knots with every interval cut into `finer` equal parts."""
    whole = np.arange(len(knots))
    return np.interp(np.arange(finer * (len(knots) - 1) + 1) / finer, whole, knots)
