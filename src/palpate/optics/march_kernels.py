"""Compiled inner loops of `compiled_march` and `axisymmetric_march`.

Rays go in tiles that fit the first cache, with vectorized inner loops. cos h and sin(h)/h are polynomials of
h^2; slices beyond |h| = pi/2 use a range reduction in double precision. Kernels release the GIL and take a
range of rays.
"""

import math
from typing import no_type_check

import numba
import numpy as np

from palpate.optics.march import TILE

SHORT = np.float32((math.pi / 2) ** 2)  # maximum h^2 of the polynomials, for an error of 4e-8

f32, f64 = np.float32, np.float64
C2, C4, C6, C8, C10, C12 = (f32((-1) ** i / math.factorial(2 * i)) for i in range(1, 7))
S2, S4, S6, S8, S10 = (f32((-1) ** i / math.factorial(2 * i + 1)) for i in range(1, 6))
ONE, TWO, TINY = f32(1), f32(2), f32(1e-30)

LAX = {"nsz", "arcp", "contract", "afn", "reassoc"}  # fastmath without flags that drop NaN
FAST = {"nogil": True, "fastmath": LAX, "error_model": "numpy", "cache": True}


@numba.njit(inline="always", **FAST)
@no_type_check
def _cos(x):
    return ONE + x * (C2 + x * (C4 + x * (C6 + x * (C8 + x * (C10 + x * C12)))))


@numba.njit(inline="always", **FAST)
@no_type_check
def _sinc(x):
    return ONE + x * (S2 + x * (S4 + x * (S6 + x * (S8 + x * S10))))


@numba.njit(inline="always", **FAST)
@no_type_check
def _add_slice(u, v, n, half_phase, peak, q0, q1, q2, q3):
    """Multiply one slice (u, v) onto the quaternions [k tile] of n rays; u^2 + v^2 is at most `peak`."""
    for k in range(half_phase.size):
        c = half_phase[k]
        c2 = c * c
        p0, p1, p2, p3 = q0[k], q1[k], q2[k], q3[k]
        if c2 * peak <= SHORT:
            for i in range(n):
                x = c2 * (u[i] * u[i] + v[i] * v[i])
                t, s = _cos(x), c * _sinc(x)
                a, b = s * u[i], s * v[i]
                w, d, e, r = p0[i], p1[i], p2[i], p3[i]
                p0[i] = t * w - a * d - b * e
                p1[i] = t * d + a * w - b * r
                p2[i] = t * e + b * w + a * r
                p3[i] = t * r - a * e + b * d
        else:
            for i in range(n):
                h = abs(f64(c)) * math.sqrt(f64(u[i]) * f64(u[i]) + f64(v[i]) * f64(v[i]))
                turns = math.floor(h / math.pi + 0.5)
                y = h - turns * math.pi
                sign = 1.0 - 2.0 * (turns - 2.0 * math.floor(turns / 2))
                x = f32(y * y)
                t = f32(sign) * _cos(x)
                s = c * f32(sign * y / max(h, 1e-30)) * _sinc(x)
                a, b = s * u[i], s * v[i]
                w, d, e, r = p0[i], p1[i], p2[i], p3[i]
                p0[i] = t * w - a * d - b * e
                p1[i] = t * d + a * w - b * r
                p2[i] = t * e + b * w + a * r
                p3[i] = t * r - a * e + b * d


@numba.njit(**FAST)
@no_type_check
def _peak(difference, shear, start, n, room):
    """Maximum u^2 + v^2 of a tile's slices."""
    room[:] = 0
    for s in range(difference.shape[0]):
        u, v = difference[s, start : start + n], shear[s, start : start + n]
        for i in range(n):
            square = u[i] * u[i] + v[i] * v[i]
            room[i] = square if square > room[i] else room[i]
    return room.max()


@numba.njit(**FAST)
@no_type_check
def march_tile(difference, shear, start, n, half_phase, room, q0, q1, q2, q3):
    """Compute the quaternions of rays start to start + n of the slices [s _]."""
    q0[:] = 1
    q1[:] = 0
    q2[:] = 0
    q3[:] = 0
    peak = _peak(difference, shear, start, n, room)
    for s in range(difference.shape[0]):
        u, v = difference[s, start : start + n], shear[s, start : start + n]
        _add_slice(u, v, n, half_phase, peak, q0, q1, q2, q3)


@numba.njit(**FAST)
@no_type_check
def add_light(q0, q1, q2, q3, n, even, real, imag, weight, room, light):
    """Add the bands' transmitted fraction of n rays to light [c n]; `even` rays are doubled first."""
    for k in range(real.shape[0]):
        r0, r1, r2, r3 = real[k]
        i0, i1, i2, i3 = imag[k]
        p0, p1, p2, p3 = q0[k], q1[k], q2[k], q3[k]
        if even:  # (w, d, e, -r) first, then (w, d, e, r)
            for i in range(n):
                w, d, e, r = p0[i], p1[i], p2[i], p3[i]
                p0[i] = w * w - d * d - e * e + r * r
                p1[i] = TWO * (w * d + e * r)
                p2[i] = TWO * (w * e - d * r)
                p3[i] = 0
        for i in range(n):
            w, d, e, r = p0[i], p1[i], p2[i], p3[i]
            one = r0 * w + r1 * d + r2 * e + r3 * r
            two = i0 * w + i1 * d + i2 * e + i3 * r
            room[i] = (one * one + two * two) / (w * w + d * d + e * e + r * r)  # normalized against rounding
        for c in range(weight.shape[1]):
            if weight[k, c] != 0:
                for i in range(n):
                    light[c, i] += weight[k, c] * room[i]


@numba.njit(**FAST)
@no_type_check
def march_stack(first, last, difference, shear, even, half_phase, real, imag, weight, light):
    """March rays first to last of slices [s n] into light [c n], which holds zeros; all float32."""
    bands = half_phase.size
    room = np.empty(TILE, f32)
    q0, q1 = np.empty((bands, TILE), f32), np.empty((bands, TILE), f32)
    q2, q3 = np.empty((bands, TILE), f32), np.empty((bands, TILE), f32)
    for start in range(first, last, TILE):
        n = min(TILE, last - start)
        march_tile(difference, shear, start, n, half_phase, room, q0, q1, q2, q3)
        add_light(q0, q1, q2, q3, n, even, real, imag, weight, room, light[:, start : start + n])
