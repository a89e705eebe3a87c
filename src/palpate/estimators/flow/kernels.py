"""The compiled loops of Horn and Schunck's flow; `fast` uses them, nobody else.

One pair of images needs n sweeps over five arrays that do not fit the processor's second cache together. Here
the sweeps run as a wavefront instead: as soon as sweep k has done row r + 1, sweep k + 1 does row r, so that
only three rows of each sweep are ever alive and all of them stay in cache. The result is that of n whole
sweeps, number for number.

Kernels release the interpreter's lock, so that plain threads share the pairs of a sequence.
"""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np

f32 = np.float32
SIDE, CORNER = f32(1 / 6), f32(1 / 12)
FAST = {"nogil": True, "fastmath": {"contract", "nsz"}, "error_model": "numpy", "cache": True}


@numba.njit(**FAST)
@no_type_check
def coefficients(a, b, quarter, alpha2, e):
    """Fill e [3 h w] with E_x, E_y, E_t over sqrt(alpha^2 + E_x^2 + E_y^2).

    Args:
        a, b: the two images [h w] as they are: differences of whole grey levels are exact.
        quarter: a quarter of the brightness of one grey level, since each derivative is a mean of four.
        alpha2: alpha^2.
        e: to be filled.
    """
    h, w = a.shape
    for r in range(h):
        s = min(r + 1, h - 1)
        a0, a1, b0, b1 = a[r], a[s], b[r], b[s]
        for c in range(w):
            d = min(c + 1, w - 1)
            x = (a0[d] - a0[c] + a1[d] - a1[c] + b0[d] - b0[c] + b1[d] - b1[c]) * quarter
            y = (a1[c] - a0[c] + a1[d] - a0[d] + b1[c] - b0[c] + b1[d] - b0[d]) * quarter
            t = (b0[c] - a0[c] + b0[d] - a0[d] + b1[c] - a1[c] + b1[d] - a1[d]) * quarter
            weight = f32(1) / np.sqrt(alpha2 + x * x + y * y)
            e[0, r, c], e[1, r, c], e[2, r, c] = x * weight, y * weight, t * weight


@numba.njit(inline="always", **FAST)
@no_type_check
def _one_row(u0, u1, u2, v0, v1, v2, x, y, t, u, v):
    """One row of one sweep: from three padded rows of the last sweep to the padded row (u, v)."""
    w = x.size
    for c in range(w):
        p = SIDE * (u0[c + 1] + u2[c + 1] + u1[c] + u1[c + 2]) + CORNER * (
            u0[c] + u0[c + 2] + u2[c] + u2[c + 2]
        )
        q = SIDE * (v0[c + 1] + v2[c + 1] + v1[c] + v1[c + 2]) + CORNER * (
            v0[c] + v0[c + 2] + v2[c] + v2[c + 2]
        )
        off = x[c] * p + y[c] * q + t[c]
        u[c + 1] = p - x[c] * off
        v[c + 1] = q - y[c] * off
    u[0], u[w + 1], v[0], v[w + 1] = u[1], u[w], v[1], v[w]


@numba.njit(**FAST)
@no_type_check
def relax(e, n, rows, flow):
    """N sweeps from the flow [2 h w], in place.

    Args:
        e: of `coefficients`.
        n: sweeps.
        rows: workspace [n 2 3 w+2], three rows of every sweep but the last.
        flow: where to start, and the result [px].
    """
    h, w = e.shape[1:]
    last = np.empty((2, w + 2), f32)
    for front in range(h + n):
        if front < h:  # sweep 0 is where the flow starts
            for i in range(2):
                row = rows[0, i, front % 3]
                row[1 : w + 1] = flow[i, front]
                row[0], row[w + 1] = row[1], row[w]
        for k in range(max(1, front - h + 1), min(n, front) + 1):
            r = front - k
            above, below = max(r - 1, 0) % 3, min(r + 1, h - 1) % 3
            u, v = rows[k - 1, 0], rows[k - 1, 1]
            if k < n:
                to_u, to_v = rows[k, 0, r % 3], rows[k, 1, r % 3]
            else:
                to_u, to_v = last[0], last[1]
            _one_row(
                u[above], u[r % 3], u[below], v[above], v[r % 3], v[below],
                e[0, r], e[1, r], e[2, r], to_u, to_v,
            )  # fmt: skip
            if k == n:
                flow[0, r], flow[1, r] = last[0, 1 : w + 1], last[1, 1 : w + 1]


@numba.njit(**FAST)
@no_type_check
def diverge(flow, out):
    """Fill out [h w] with du/dx + dv/dy of the flow [2 h w]; central differences, one-sided on the border."""
    u, v = flow[0], flow[1]
    h, w = out.shape
    half = f32(0.5)
    for r in range(h):
        up, down = max(r - 1, 0), min(r + 1, h - 1)
        per_row = half if down - up == 2 else f32(1)
        for c in range(1, w - 1):
            out[r, c] = half * (u[r, c + 1] - u[r, c - 1]) + per_row * (v[down, c] - v[up, c])
        out[r, 0] = u[r, 1] - u[r, 0] + per_row * (v[down, 0] - v[up, 0])
        out[r, w - 1] = u[r, w - 1] - u[r, w - 2] + per_row * (v[down, w - 1] - v[up, w - 1])
