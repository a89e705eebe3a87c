"""Force of a unit's press, and its derivatives by the unit's terms and the press's unknowns."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.sphere_table import SphereTable
from palpate.sensors.palm.copies.palm_copy import AT, TERMS, Local, PalmCopy, harder_at
from palpate.sensors.palm.palm_press import has_table, table_of
from palpate.sensors.palm.palm_rim import rim_by_place
from palpate.sensors.palm.palm_spec import PalmSpec

STEPS = np.array([1e-4, 1e-4, 1e-3])  # finite-difference steps of x, y [m], and ln(depth)
THICKER = 0.03  # step of log thickness between the tables


def log_force(known: PalmCopy, local: Local) -> tuple[float, Float[ndarray, " u"]]:
    """Return the logarithm of a press's force [ln N] and its derivatives by `TERMS` and `LOCAL`."""
    spec, n = known.spec, len(TERMS)
    thicker = float(known.terms[AT["thickness"]] + local[5])
    places = local[:3] + np.concatenate([np.zeros((1, 3)), -np.diag(STEPS), np.diag(STEPS)])
    even, slope = _even(spec, places, thicker)
    J = np.zeros(n + len(local))
    J[n : n + 3] = (even[4:] - even[1:4]) / (2 * STEPS)
    J[[0, n + 4]] = 1.0
    J[[AT["thickness"], n + 5]] = slope
    across, along = AT["harder_across"], AT["harder_along"]
    J[[across, along]] = local[:2] / spec.radius_m
    J[n : n + 2] += known.terms[[across, along]] / spec.radius_m
    return float(even[0] + known.terms[0] + harder_at(known, local)), J


def deepest_m(spec: PalmSpec) -> float:
    """Return the maximum depth of the design's table [m]."""
    return table_of(spec).greatest_depth * spec.indenter_radius_m


def thickness_is_free(spec: PalmSpec) -> bool:
    """Return whether slightly thinner and thicker membranes are tabled."""
    return len(_tables(spec)) == 3


def _even(
    spec: PalmSpec, places: Float[ndarray, "p 3"], thicker: float
) -> tuple[Float[ndarray, " p"], float]:
    """Log force on the design's modulus, and the first one's derivative by log thickness."""
    x, y, log_depth = places.T
    depth, R = np.exp(log_depth), spec.indenter_radius_m
    by_place = rim_by_place(spec)
    ratio = 1.0 if by_place is None else by_place(x, y, depth).ratio
    unit = np.log(spec.youngs_modulus_pa * R**2 * ratio)
    logs = [np.log(one.force_at(np.minimum(depth / R, one.greatest_depth))) for one in _tables(spec)]
    if len(logs) == 1:
        return logs[0] + unit, 0.0
    thin, own, thick = logs
    first, second = (thick - thin) / (2 * THICKER), (thick + thin - 2 * own) / THICKER**2
    return unit + own + thicker * (first + thicker * second / 2), float(first[0] + thicker * second[0])


@lru_cache(maxsize=8)
def _tables(spec: PalmSpec) -> tuple[SphereTable, ...]:
    """Table of the design, between the next thinner and thicker ones if they exist."""
    beside = [replace(spec, thickness_m=spec.thickness_m * math.exp(off)) for off in (-THICKER, THICKER)]
    if not all(has_table(replace(spec, thickness_m=spec.thickness_m * s)) for s in (0.92, 1.09)):
        return (table_of(spec),)
    return table_of(beside[0]), table_of(spec), table_of(beside[1])
