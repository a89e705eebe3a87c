"""Unilateral contact with Coulomb friction on any pair of linear bodies, cell by cell until nothing changes.

With C the compliance of the pair, f the forces on cells (normal, two tangential), and the gap and slip of the
cells affine in f, the forces answer to

    f_n >= 0,  g >= 0,  f_n g = 0;    |f_t| <= mu f_n,  slip against f_t where |f_t| = mu f_n, else none

Each cell in turn takes the force that satisfies this while the others stand still; sweeps go on until no
cell's force changes (non-linear block Gauss-Seidel).

Reference: M. Jean, The non-smooth contact dynamics method, Computer Methods in Applied Mechanics and
Engineering 177 (1999) 235, doi:10.1016/S0045-7825(98)00383-1.
"""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np

from palpate.core import Float, RangeError, ndarray

SWEEPS = 4000
CHANGE = 1e-6  # of the greatest force on a cell: less is rest


def solve_friction(
    compliance: Float[ndarray, "n 3 n 3"],
    gap: Float[ndarray, " n"],
    slip: Float[ndarray, "n 2"],
    friction: float,
    start: Float[ndarray, "n 3"],
) -> Float[ndarray, "n 3"]:
    """Forces on the cells (normal, two tangential) [N] for which contact and friction hold.

    Args:
        compliance: displacement that opens the gap and slides, by forces [m/N]; symmetric.
        gap: without any force [m]; negative where the bodies would overlap.
        slip: tangential motion of the cells since they last rested, without any force now [m].
        friction: Coulomb's coefficient; 0 for none.
        start: forces to begin with, e.g. those of the last state [N].

    Raises:
        RangeError: friction below 0, or no rest after many sweeps.
    """
    if not friction >= 0:
        raise RangeError(f"friction is {friction}; Coulomb's coefficient is 0 or more")
    n = len(gap)
    force = np.ascontiguousarray(start, np.float64).copy()
    C = np.ascontiguousarray(compliance, np.float64).reshape(3 * n, 3 * n)
    sweeps = _sweep(C, gap, slip, friction, force, SWEEPS, CHANGE)
    if sweeps >= SWEEPS:
        raise RangeError(f"contact and friction found no rest in {SWEEPS} sweeps; press by smaller steps")
    return force


@numba.njit(cache=True, nogil=True)
@no_type_check
def _sweep(C, gap, slip, friction, force, most, change):
    n = len(gap)
    f = force.reshape(3 * n)
    for sweep in range(most):
        greatest = change_now = 0.0
        for i in range(n):
            row = 3 * i
            opening = gap[i] + np.dot(C[row], f)
            normal = max(0.0, f[row] - opening / C[row, row])
            change_now, f[row] = max(change_now, abs(normal - f[row])), normal
            greatest = max(greatest, normal)
            if friction == 0.0:
                continue
            if normal == 0.0:
                f[row + 1] = f[row + 2] = 0.0
                continue
            stiff = max(C[row + 1, row + 1], C[row + 2, row + 2])
            a = f[row + 1] - (slip[i, 0] + np.dot(C[row + 1], f)) / stiff
            b = f[row + 2] - (slip[i, 1] + np.dot(C[row + 2], f)) / stiff
            size = np.hypot(a, b)
            if size > friction * normal:
                a, b = a * friction * normal / size, b * friction * normal / size
            change_now = max(change_now, abs(a - f[row + 1]), abs(b - f[row + 2]))
            f[row + 1], f[row + 2] = a, b
        if change_now <= change * greatest or greatest == 0.0:
            return sweep
    return most
