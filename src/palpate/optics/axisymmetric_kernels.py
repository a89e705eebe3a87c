"""Compiled loops that sample an axisymmetric table for `axisymmetric_march`.

Lengths are in units of the table's last radius. Graded knots are found through a lookup of equal steps. Rays
that stay in the membrane and the table take a fast loop.
"""

import math
from typing import no_type_check

import numba
import numpy as np

from palpate.optics.march import TILE
from palpate.optics.march_kernels import FAST, ONE, TINY, add_light, f32, march_tile


@numba.njit(inline="always", **FAST)
@no_type_check
def _place(at, knots, start, per_step):
    """Interval and fraction of `at` among graded knots; `start` is the lookup."""
    last = knots.size - 2
    i = start[min(max(int(at * per_step), 0), start.size - 1)]
    while i < last and at >= knots[i + 1]:
        i += 1
    return i, min(max((at - knots[i]) / (knots[i + 1] - knots[i]), f32(0)), ONE)


@numba.njit(inline="always", **FAST)
@no_type_check
def _surface(r, r_knots, r_start, r_per_step, surface):
    i, w = _place(r, r_knots, r_start, r_per_step)
    return surface[i] + w * (surface[i + 1] - surface[i])


@numba.njit(inline="always", **FAST)
@no_type_check
def _read(z, r, table):
    """s_rr - s_tt, s_tt - s_zz, and 2 s_rz at depth z and radius r."""
    r_knots, r_start, r_per_step, z_knots, z_start, z_per_step, surface, thickness, stress = table
    m, w = _place(r, r_knots, r_start, r_per_step)
    top = surface[m] + w * (surface[m + 1] - surface[m])
    n, t = _place((z - top) / (thickness - top), z_knots, z_start, z_per_step)
    lower, upper = stress[m], stress[m + 1]
    a, b, c, d = (ONE - w) * (ONE - t), w * (ONE - t), (ONE - w) * t, w * t
    turning = a * lower[n, 0] + b * upper[n, 0] + c * lower[n + 1, 0] + d * upper[n + 1, 0]
    fixed = a * lower[n, 1] + b * upper[n, 1] + c * lower[n + 1, 1] + d * upper[n + 1, 1]
    sliding = a * lower[n, 2] + b * upper[n, 2] + c * lower[n + 1, 2] + d * upper[n + 1, 2]
    return turning, fixed, sliding


@numba.njit(**FAST)
@no_type_check
def _sample_deep(rays, j, i, slices, table, frozen, difference, shear):
    """Slices of ray j, entirely in the membrane and the table, into column i."""
    offset, scale = rays[0, j], rays[4, j]
    first, last = math.atan(rays[2, j] / scale), math.atan(rays[3, j] / scale)
    step = (last - first) / slices
    c, s = math.cos(first + step / 2), math.sin(first + step / 2)
    turn_c, turn_s = math.cos(step), math.sin(step)
    z, s2, x = f32(rays[1, j]), offset * offset, f32(offset)
    for k in range(slices):
        per_c = 1.0 / c
        y = scale * s * per_c
        dy = f32(scale * step * per_c * per_c)
        c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
        r = math.sqrt(f32(s2 + y * y))
        turning, fixed, sliding = _read(z, r, table)
        cosine = x / max(r, TINY)
        difference[k, i] = dy * (turning * cosine * cosine + fixed)
        shear[k, i] = dy * sliding * cosine
    if frozen[0, j] == 0 and frozen[1, j] == 0:
        return
    c, s = math.cos(first), math.sin(first)
    y_edge = rays[2, j]
    for k in range(slices):
        c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
        y_next = scale * s / c
        difference[k, i] += f32(y_next - y_edge) * frozen[0, j]
        shear[k, i] += f32(y_next - y_edge) * frozen[1, j]
        y_edge = y_next


@numba.njit(**FAST)
@no_type_check
def _sample_any(rays, j, i, slices, table, frozen, difference, shear, inside):
    """Slices of a ray that may cross the surface or leave the table."""
    r_knots, r_start, r_per_step, _, _, _, surface, thickness, _ = table
    offset, scale = rays[0, j], rays[4, j]
    first, last = math.atan(rays[2, j] / scale), math.atan(rays[3, j] / scale)
    step = (last - first) / slices
    c, s = math.cos(first), math.sin(first)
    turn_c, turn_s = math.cos(step / 2), math.sin(step / 2)
    z, s2, x = f32(rays[1, j]), offset * offset, f32(offset)
    y_edge = rays[2, j]
    above = z - _surface(f32(math.sqrt(s2 + y_edge * y_edge)), r_knots, r_start, r_per_step, surface)
    skin, outside = 0.0, 0.0
    for k in range(slices):
        c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
        y, dy = scale * s / c, scale * step / (c * c)
        c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
        y_next = scale * s / c
        below = above
        above = z - _surface(f32(math.sqrt(s2 + y_next * y_next)), r_knots, r_start, r_per_step, surface)
        length, share = y_next - y_edge, ONE
        if z > thickness or (below < 0 and above < 0):
            share = f32(0)
        elif below < 0 or above < 0:  # partly inside, with a straight surface
            share = max(below, above) / abs(above - below)
            y = y_next - length * share / 2 if above > 0 else y_edge + length * share / 2
        length *= share
        y_edge = y_next
        u, v = f32(length) * frozen[0, j], f32(length) * frozen[1, j]
        r = f32(math.sqrt(s2 + y * y))
        skin += length
        if r > ONE:
            outside += length
        elif share > 0:
            turning, fixed, sliding = _read(z, r, table)
            cosine = x / max(r, TINY)
            u += f32(dy) * share * (turning * cosine * cosine + fixed)
            v += f32(dy) * share * sliding * cosine
        difference[k, i] = u
        shear[k, i] = v
    inside[0, j] = skin
    inside[1, j] = outside


@numba.njit(**FAST)
@no_type_check
def _sample_tile(start, n, rays, slices, table, frozen, difference, shear, inside):
    surface, thickness = table[6], table[7]
    deepest = surface.max()
    for i in range(n):
        j = start + i
        y0, y1, z = rays[2, j], rays[3, j], f32(rays[1, j])
        farthest = rays[0, j] * rays[0, j] + max(y0 * y0, y1 * y1)
        if deepest < z <= thickness and farthest < 1:
            _sample_deep(rays, j, i, slices, table, frozen, difference, shear)
            inside[0, j] = y1 - y0
        else:
            _sample_any(rays, j, i, slices, table, frozen, difference, shear, inside)


@numba.njit(**FAST)
@no_type_check
def march_rays(first, last, rays, slices, table, frozen, half_phase, real, imag, weight, light, inside):
    """March rays [5 n] first to last, with frozen stress [2 n], into light [c n] (zeros) and inside [2 n]."""
    bands = half_phase.size
    room = np.empty(TILE, f32)
    difference, shear = np.empty((slices, TILE), f32), np.empty((slices, TILE), f32)
    q0, q1 = np.empty((bands, TILE), f32), np.empty((bands, TILE), f32)
    q2, q3 = np.empty((bands, TILE), f32), np.empty((bands, TILE), f32)
    for start in range(first, last, TILE):
        n = min(TILE, last - start)
        _sample_tile(start, n, rays, slices, table, frozen, difference, shear, inside)
        march_tile(difference, shear, 0, n, half_phase, room, q0, q1, q2, q3)
        add_light(q0, q1, q2, q3, n, False, real, imag, weight, room, light[:, start : start + n])
