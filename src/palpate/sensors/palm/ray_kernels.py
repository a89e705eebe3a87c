"""Compiled loop that reads stress along rays for `fringe_rays`."""

from typing import no_type_check

import numba
import numpy as np

f32 = np.float32


@numba.njit(nogil=True, cache=True, error_model="numpy")
@no_type_check
def read_along(near, far, to_near, to_far, x, y, length, turns, frozen, u, v):
    """Accumulate what the slices of rays add to a march, on every plane.

    Args:
        near, far: Five stresses on planes [nz 5 ny nx]; `far` applies outside `near`.
        to_near, to_far: First column, first row, and inverse cell sizes along x and y.
        x, y, length: Midpoints and lengths of the slices [s w].
        turns: cos^2, sin^2, -2 sin cos, 2 cos, -2 sin of the rays [5 w].
        frozen: Added difference and shear of each plane and ray [2 z w].
        u, v: Output: (s_xx - s_zz) and 2 s_xz times length in the ray's frame [s z w].
    """
    slices, rays = x.shape
    near_ny, near_nx = near.shape[2:]
    far_ny, far_nx = far.shape[2:]
    at = np.empty((slices, rays), np.int32)
    right = np.empty((slices, rays), f32)
    down = np.empty((slices, rays), f32)
    for s in range(slices):
        for w in range(rays):
            i, j = (x[s, w] - to_near[0]) * to_near[2], (y[s, w] - to_near[1]) * to_near[3]
            if i >= 0 and j >= 0 and i < near_nx - 1 and j < near_ny - 1:
                at[s, w] = int(j) * near_nx + int(i)
                right[s, w], down[s, w] = i - int(i), j - int(j)
                continue
            i, j = (x[s, w] - to_far[0]) * to_far[2], (y[s, w] - to_far[1]) * to_far[3]
            if i >= 0 and j >= 0 and i < far_nx - 1 and j < far_ny - 1:
                at[s, w] = -2 - (int(j) * far_nx + int(i))
                right[s, w], down[s, w] = i - int(i), j - int(j)
            else:
                at[s, w] = -1
    for z in range(near.shape[0]):
        here, there = near[z].reshape(5, -1), far[z].reshape(5, -1)
        for s in range(slices):
            for w in range(rays):
                k = at[s, w]
                if k == -1:
                    u[s, z, w] = frozen[0, z, w] * length[s, w]
                    v[s, z, w] = frozen[1, z, w] * length[s, w]
                    continue
                grid, nx = (here, near_nx) if k >= 0 else (there, far_nx)
                k = k if k >= 0 else -2 - k
                a, b = right[s, w], down[s, w]
                one, two, three, four = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
                difference, shear = frozen[0, z, w], frozen[1, z, w]
                for f in range(5):
                    row = grid[f]
                    value = one * row[k] + two * row[k + 1] + three * row[k + nx] + four * row[k + nx + 1]
                    if f < 3:
                        difference += turns[f, w] * value
                    else:
                        shear += turns[f, w] * value
                u[s, z, w], v[s, z, w] = difference * length[s, w], shear * length[s, w]
