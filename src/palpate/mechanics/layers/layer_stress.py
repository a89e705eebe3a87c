"""Fast stress in one bonded layer under a surface load: long and short waves separately.

Long waves are summed on a wide, coarse grid, short ones in a window around the load, split by

    w(q) = (1 + q^2 + q^4 / 2) exp(-q^2),    q = k / K.

Deep planes have long waves only. Transfer functions, independent of the modulus, are tabled over wavenumber
in the wave's axes: k along it, t across it, z into the layer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import fft

from palpate.core import Complex64, Field, Float, Float32, InputError, Int, RangeError, ndarray
from palpate.mechanics.layers.influence import block_span, cells
from palpate.mechanics.layers.stack import LONG_WAVE, Material, Slab, climb

STEP = 0.0155  # step of k z in the table, for an error of 3e-5
ENTRIES = 1024  # increment of table sizes, so that tables are shared

Table = Float32[ndarray, "nz 8 k"]


def transfer(
    z: Float[ndarray, " nz"], thickness: float, nu: float, k: Float[ndarray, "py half"]
) -> Float32[ndarray, "nz 8 py half"]:
    """Return stresses per unit load of waves on planes, interpolated in a table.

    Args:
        z: Planes [m].
        thickness: Thickness of the layer [m].
        nu: Poisson's ratio.
        k: Wavenumbers [1/m].

    Returns:
        By pressure: kk - zz, tt - zz, i kz. By shear along the wave: kk - zz and tt - zz over i, minus kz. By
            shear
        across it: kt over i, minus tz.
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
    """Transmission to each plane and its motion, in the plane of the wave and across it."""
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
    """Return the stress by the mean wave, averaged over directions: xx - zz by pressure, and xz by shear
    along x.
    """
    n = nu / (1 - nu)
    rows = []
    for R, CR, r, _ in _levels(z, thickness, nu, np.zeros(1)):
        trace = -2 * n * R[0, 1, 1] - 2 * (1 / (1 - nu) + n) * CR[0, 0, 1]
        rows.append((trace / 2 + R[0, 1, 1], -(R[0, 0, 0] + r[0]) / 2))
    return np.array(rows)


RAY_STRESSES = ("xx-zz", "yy-zz", "xy", "xz", "yz")
COARSE = 20  # cells of the wide grid per thickness
REACH = 5.0  # extent beyond the load, in thicknesses
FADED = 3.7  # q at which w is 1e-4
USED = 0.8  # used fraction of the wide grid's wavenumbers
DYING = 5.0  # reach of the short waves beyond the load, over 1 / K
SHALLOW = 9.0  # k z at which the shortest long wave is 1e-3
TAPS = 8  # points of the wide grid to each side in the interpolation

Stresses = Float32[ndarray, "planes 5 _ _"]


@dataclass(frozen=True, slots=True, eq=False)
class OnGrid:
    """The stresses of `RAY_STRESSES` on planes over a regular grid.

    Attributes:
        first_m: First column and row (x, y) [m].
        cell_m: Steps along x and y [m].
    """

    first_m: tuple[float, float]
    cell_m: tuple[float, float]
    stress_pa: Stresses


def stress_under(
    thickness_m: float,
    poisson_ratio: float,
    depths_m: Float[ndarray, " nz"],
    pressure_pa: Field,
    x_m: Float[ndarray, " nx"],
    y_m: Float[ndarray, " ny"],
    shear_pa: Float[ndarray, "2 ny nx"] | None = None,
) -> tuple[OnGrid, OnGrid]:
    """Return the stress in a window around a load, and on a wide grid for the outside.

    Args:
        thickness_m: Thickness of the layer on a rigid floor [m].
        poisson_ratio: Below 1/2.
        depths_m: Planes, rising from 0 to the thickness [m].
        pressure_pa: Pressure [Pa].
        x_m, y_m: Columns and rows of a regular grid [m].
        shear_pa: Traction of the probe on the surface along x and y [Pa].

    Returns:
        Window and wide grid, which ends five thicknesses beyond the load.
    """
    grid = cells(x_m, y_m)
    if not np.all(np.isfinite(pressure_pa)) or (shear_pa is not None and not np.all(np.isfinite(shear_pa))):
        raise InputError("a load is not finite; look for NaN or infinity in the pressure and the shear")
    if not (0.0 < thickness_m < math.inf and 0.0 <= poisson_ratio < 0.5):
        raise RangeError(
            f"a layer {thickness_m} m thick of Poisson's ratio {poisson_ratio}; give a positive thickness "
            "in m and a ratio from 0 to below 0.5"
        )
    if not (np.all(np.diff(depths_m) > 0.0) and depths_m[0] >= 0.0 and depths_m[-1] <= thickness_m):
        raise RangeError(f"planes {depths_m} m; give depths that rise within 0 to {thickness_m:g} m")
    rows, columns = _loaded(pressure_pa if shear_pa is None else np.abs([pressure_pa, *shear_pa]).max(axis=0))
    key = tuple(float(z) for z in depths_m)
    plan = _plan(
        thickness_m,
        poisson_ratio,
        key,
        (rows.stop - rows.start, columns.stop - columns.start),
        (round(grid.dy, 12), round(grid.dx, 12)),
    )
    shear = np.zeros((2, 1, 1)) if shear_pa is None else shear_pa[:, rows, columns]
    loads = [pressure_pa[rows, columns], *(shear if shear_pa is not None and shear.any() else ())]
    near, far = plan.stresses(loads)
    middle = ((x_m[columns.start] + x_m[columns.stop - 1]) / 2, (y_m[rows.start] + y_m[rows.stop - 1]) / 2)
    return _on_grid(near, middle, plan.near), _on_grid(far, middle, plan.far)


def _loaded(pressure_pa: Field) -> tuple[slice, slice]:
    """Rows and columns that carry load, grown to whole blocks."""
    at = np.nonzero(pressure_pa)
    if not len(at[0]):
        at = tuple(np.array([n // 2]) for n in pressure_pa.shape)
    rows, columns = (block_span(where, count) for where, count in zip(at, pressure_pa.shape, strict=True))
    return rows, columns


class _Grid(NamedTuple):
    """Points around a load's middle: counts and steps along y and x."""

    counts: tuple[int, int]
    cell: tuple[float, float]

    def axis(self, which: int) -> Float[ndarray, " n"]:
        return (np.arange(self.counts[which]) - (self.counts[which] - 1) / 2) * self.cell[which]


def _on_grid(stress: Stresses, middle: tuple[float, float], grid: _Grid) -> OnGrid:
    first = (middle[0] + grid.axis(1)[0], middle[1] + grid.axis(0)[0])
    return OnGrid((float(first[0]), float(first[1])), (grid.cell[1], grid.cell[0]), stress)


class _WavePart(NamedTuple):
    """Waves of one grid: transfer to each plane, direction, and weight."""

    transfer: Float32[ndarray, "nz 8 py half"]
    cos: Float32[ndarray, "py half"]
    sin: Float32[ndarray, "py half"]
    weight: Float32[ndarray, "py half"]


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """Everything that is independent of the load.

    Attributes:
        short, long: Waves of the window (on the `shallow` planes) and of the wide grid.
        shallow: Number of planes that short waves reach.
        mean: Transfer of the mean wave to each plane.
        into_far: Load points to the wide grid's waves, along y and x.
        onto_near: Points of the wide grid `around` the window to the window's, along y and x.
        loaded: Shape of the load.
    """

    near: _Grid
    far: _Grid
    short: _WavePart
    long: _WavePart
    shallow: int
    mean: Float[ndarray, "nz 2"]
    into_far: tuple[Complex64[ndarray, "fy ly"], Complex64[ndarray, "lx half"]]
    onto_near: tuple[Float32[ndarray, "ny ay"], Float32[ndarray, "ax nx"]]
    around: tuple[slice, slice]
    loaded: tuple[int, int]

    def stresses(self, loads: list[Field]) -> tuple[Stresses, Stresses]:
        singles = [np.asarray(load, np.float32) for load in loads]
        wide = [self.into_far[0] @ load @ self.into_far[1] for load in singles]
        window = [np.asarray(fft.rfft2(self._pad(load))) for load in singles]
        near = np.empty((len(self.mean), len(RAY_STRESSES), *self.near.counts), np.float32)
        far = np.empty((len(self.mean), len(RAY_STRESSES), *self.far.counts), np.float32)
        faded = [load * self.long.weight for load in wide]
        rest = [load * self.short.weight for load in window]
        rows, columns = self.around
        for i, mean in enumerate(self.mean):
            waves = _on_plane(self.long, i, faded if i < self.shallow else wide)
            for which, part in ((0, 0), (1, 0), (3, 1), (4, 1)):
                load = 0 if which < 2 else which - 2
                waves[which, 0, 0] = mean[part] * wide[load][0, 0] if load < len(wide) else 0.0
            far[i] = fft.irfft2(waves, self.far.counts)
            near[i] = self.onto_near[0] @ far[i][:, rows, columns] @ self.onto_near[1]
            if i < self.shallow:
                near[i] += fft.irfft2(_on_plane(self.short, i, rest), self.near.counts)
        return near, far

    def _pad(self, load: Float32[ndarray, "ly lx"]) -> Float32[ndarray, "ny nx"]:
        whole = np.zeros(self.near.counts, np.float32)
        top, first = ((n - m) // 2 for n, m in zip(self.near.counts, self.loaded, strict=True))
        whole[top : top + load.shape[0], first : first + load.shape[1]] = load
        return whole


def _on_plane(part: _WavePart, plane: int, loads: list[ndarray]) -> Complex64[ndarray, "5 py half"]:
    """Waves of the five stresses from those of pressure and shear."""
    c, s = part.cos, part.sin
    kk, tt, kz, *rest = part.transfer[plane]
    p = loads[0]
    KK, TT, KZ = kk * p, tt * p, (-1j * kz) * p
    stress = np.empty((len(RAY_STRESSES), *p.shape), np.complex64)
    cc, cs = c * c, c * s
    if len(loads) == 1:
        difference = KK - TT
        stress[0] = TT + cc * difference
        stress[1] = KK - cc * difference
        stress[2] = cs * difference
        stress[3], stress[4] = c * KZ, s * KZ
        return stress
    q_kk, q_tt, q_kz, v, r = rest
    q_k, q_t = c * loads[1] + s * loads[2], c * loads[2] - s * loads[1]
    KK += 1j * (q_kk * q_k)
    TT += 1j * (q_tt * q_k)
    KZ -= q_kz * q_k
    KT, TZ = 1j * (v * q_t), -r * q_t
    difference = KK - TT
    stress[0] = TT + cc * difference - 2 * cs * KT
    stress[1] = KK - cc * difference + 2 * cs * KT
    stress[2] = cs * difference + (2 * cc - 1) * KT
    stress[3], stress[4] = c * KZ - s * TZ, s * KZ + c * TZ
    return stress


@lru_cache(maxsize=4)
def _plan(
    thickness: float, nu: float, depths: tuple[float, ...], loaded: tuple[int, int], cell: tuple[float, float]
) -> _Plan:
    z = np.array(depths)
    coarse = max(thickness / COARSE, *cell)
    K = USED * math.pi / coarse / FADED
    near = _Grid(_counts([n + 2 * DYING / (K * d) for n, d in zip(loaded, cell, strict=True)], loaded), cell)
    wide = [(n * d + 2 * REACH * thickness) / coarse for n, d in zip(loaded, cell, strict=True)]
    far = _Grid(_counts(wide, (0, 0)), (coarse, coarse))
    shallow = int(np.count_nonzero(z < SHALLOW * coarse / (USED * math.pi)))
    k_near, k_far = (_wavenumbers(grid) for grid in (near, far))
    short = _WavePart(
        transfer(z[: max(shallow, 1)], thickness, nu, np.hypot(*k_near)),
        *_directions(k_near),
        _short(np.hypot(*k_near) / K),
    )
    long = _WavePart(
        transfer(z, thickness, nu, np.hypot(*k_far)), *_directions(k_far), 1 - _short(np.hypot(*k_far) / K)
    )
    into = [
        np.exp(-1j * np.outer(k, (np.arange(n) - (n - 1) / 2) * d - far.axis(which)[0]))
        for which, (k, n, d) in enumerate(zip((k_far[1][:, 0], k_far[0][0]), loaded, cell, strict=True))
    ]
    share = cell[0] * cell[1] / coarse**2
    around, onto = zip(*(_read(far.axis(which), near.axis(which), coarse) for which in (0, 1)), strict=True)
    into_far = ((share * into[0]).astype(np.complex64), into[1].T.astype(np.complex64))
    onto_near = (onto[0].astype(np.float32), onto[1].T.astype(np.float32))
    mean = mean_transfer(z, thickness, nu)
    return _Plan(near, far, short, long, shallow, mean, into_far, onto_near, (around[0], around[1]), loaded)


def _counts(least: list[float], like: tuple[int, int]) -> tuple[int, int]:
    """Sizes that transform fast, of the same parity as those they surround."""
    counts = []
    for size, other in zip(least, like, strict=True):
        count = fft.next_fast_len(math.ceil(size), real=True)
        while (count - other) % 2:
            count = fft.next_fast_len(count + 1, real=True)
        counts.append(int(count))
    return counts[0], counts[1]


def _wavenumbers(grid: _Grid) -> tuple[Float[ndarray, "py half"], Float[ndarray, "py half"]]:
    (ny, nx), (dy, dx) = grid.counts, grid.cell
    k_x, k_y = np.meshgrid(2 * np.pi * fft.rfftfreq(nx, dx), 2 * np.pi * fft.fftfreq(ny, dy))
    return k_x, k_y


def _directions(
    k: tuple[ndarray, ndarray],
) -> tuple[Float32[ndarray, "py half"], Float32[ndarray, "py half"]]:
    size = np.maximum(np.hypot(*k), 1e-300)
    return (k[0] / size).astype(np.float32), (k[1] / size).astype(np.float32)


def _short(q: Float[ndarray, "py half"]) -> Float32[ndarray, "py half"]:
    """1 - w."""
    square = np.minimum(q, 20.0) ** 2
    return (1 - (1 + square + square**2 / 2) * np.exp(-square)).astype(np.float32)


def _read(
    far: Float[ndarray, " n"], near: Float[ndarray, " m"], cell: float
) -> tuple[slice, Float[ndarray, "m a"]]:
    """Part of an axis around another, and windowed sinc weights to its points."""
    first = int(np.searchsorted(far, near[0] - TAPS * cell))
    last = int(np.searchsorted(far, near[-1] + TAPS * cell))
    away = (near[:, None] - far[first:last]) / cell
    window = np.where(abs(away) < TAPS, np.i0(8.0 * np.sqrt(np.maximum(1 - (away / TAPS) ** 2, 0))), 0.0)
    weights = np.sinc(away) * window
    return slice(first, last), weights / weights.sum(axis=1, keepdims=True)
