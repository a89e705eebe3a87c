"""Table of the stress that a wave of load on one bonded layer makes at a depth, over its wavenumber.

The stresses are those in the wave's own axes: k along it, t across it, z into the skin. Under a given load
they do not depend on the layer's modulus.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from palpate.core import Float, Float32, Int, ndarray
from palpate.mechanics.layers.stack import LONG_WAVE, Material, Slab, climb

STEP = 0.0155  # k z from one entry of a table to the next: 3e-5 off
ENTRIES = 1024  # by which tables grow, so that they are shared

Table = Float32[ndarray, "nz 8 k"]


def transfer(
    z: Float[ndarray, " nz"], thickness: float, nu: float, k: Float[ndarray, "py half"]
) -> Float32[ndarray, "nz 8 py half"]:
    """Stresses that waves of each length make on planes per unit of load, read off a table between entries.

    Args:
        z: of the planes [m].
        thickness: of the layer [m].
        nu: its Poisson's ratio.
        k: wavenumbers [1/m].

    Returns:
        By pressure: kk - zz, tt - zz, and i kz. By shear along the wave: kk - zz and tt - zz, both over i,
        and minus kz. By shear across it: kt over i, and minus tz.
    """
    step = STEP / max(float(z[-1]), 1e-3 * thickness)
    count = -(-(int(k.max() / step) + 2) // ENTRIES) * ENTRIES
    table = _table(tuple(z.tolist()), thickness, nu, step, count)
    at = k / step
    below: Int[ndarray, "py half"] = at.astype(np.int64)
    share = (at - below).astype(np.float32)
    stress = np.empty((*table.shape[:2], *k.shape), np.float32)
    for i, plane in enumerate(table):
        for j, entry in enumerate(plane):
            stress[i, j] = entry[below] + share * (entry[below + 1] - entry[below])
    return stress


def _levels(
    z: Float[ndarray, " nz"], thickness: float, nu: float, k: ndarray
) -> list[tuple[ndarray, ndarray, ndarray, ndarray]]:
    """Transmission to each plane and its motion there, in the plane of the wave and across it."""
    cuts = np.unique([0.0, *z, thickness])
    material = Material(1.0, nu)
    slabs = [Slab(material, float(slab)) for slab in np.diff(cuts)]
    in_plane, across = climb(slabs, None, np.maximum(k, LONG_WAVE / thickness))
    levels = []
    for at in np.searchsorted(cuts, z):
        one, other = in_plane[int(at)], across[int(at)]
        motion = (other.compliance @ other.transmission)[:, 0, 0]
        levels.append(
            (one.transmission, one.compliance @ one.transmission, other.transmission[:, 0, 0], motion)
        )
    return levels


@lru_cache(maxsize=8)
def _table(z: tuple[float, ...], thickness: float, nu: float, step: float, count: int) -> Table:
    """Stresses at evenly spaced wavenumbers, by the formulas of `stack_field`."""
    k = np.arange(count) * step
    n = nu / (1 - nu)
    rows = []
    for R, CR, r, cr in _levels(np.array(z), thickness, nu, k):
        plate, bar = 2 / (1 - nu), 2 * n
        zz, q_zz = -R[:, 1, 1], R[:, 1, 0]
        by_pressure = ((n - 1) * zz - plate * CR[:, 0, 1], (n - 1) * zz - bar * CR[:, 0, 1], R[:, 0, 1])
        by_shear = ((n - 1) * q_zz + plate * CR[:, 0, 0], (n - 1) * q_zz + bar * CR[:, 0, 0], R[:, 0, 0])
        rows.append(np.stack([*by_pressure, *by_shear, cr, r]))
    return np.stack(rows).astype(np.float32)


def mean_transfer(z: Float[ndarray, " nz"], thickness: float, nu: float) -> Float[ndarray, "nz 2"]:
    """Stress by the wave without direction: xx - zz by pressure, and xz by shear along x.

    It takes the mean over all directions, in which what is odd is gone.
    """
    n = nu / (1 - nu)
    rows = []
    for R, CR, r, _ in _levels(z, thickness, nu, np.zeros(1)):
        trace = -2 * n * R[0, 1, 1] - 2 * (1 / (1 - nu) + n) * CR[0, 0, 1]
        rows.append((trace / 2 + R[0, 1, 1], -(R[0, 0, 0] + r[0]) / 2))
    return np.array(rows)
