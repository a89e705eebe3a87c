"""Displacement of a stack's surface at grid points under a load on one cell.

Zero padding to twice the size makes the product of Fourier transforms the plain sum over cells. The influence
is that of a half-space of the top layer's material in closed form (Love's and Cerruti's rectangles), plus the
smooth change by the other layers,

    g(r) = 1/(2 pi) int_0^inf [C(k) - C_half(k)] J_n(k r) k dk,   n = 0, and 2 for tangential loads,

averaged over a cell by the factor exp(-k^2 d^2 / 24).

References: A. E. H. Love, Phil. Trans. R. Soc. A 228, 377 (1929), doi:10.1098/rsta.1929.0009; K. L. Johnson,
Contact Mechanics (1985), sec. 3.2 and 3.6, doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import fft, interpolate, special

from palpate.core import Field, Float, RangeError, ndarray
from palpate.mechanics.layers.stack import Compliance, Stack, surface_compliance
from palpate.mechanics.layers.surface_grid import Cells

CHANGES_END = 13.0  # k h beyond which the change vanishes (1e-8)
PHASE = 8.0  # maximum k r per panel of 16 Gauss points
PER_LENGTH = 12  # nodes of the radial spline per characteristic length
RADII = 64  # radii integrated at once, which bounds the memory

Spectrum = Float[ndarray, "py half"]
Waves = Float[ndarray, " k"]
Radii = Float[ndarray, " r"]
Parts = Callable[[Compliance], tuple[Waves, ...]]


class Influence(NamedTuple):
    """Transforms of the influence on the padded grid [m/Pa], and that grid's shape."""

    spectra: tuple[Spectrum, ...]
    shape: tuple[int, int]

    def apply(self, spectrum: int, load: Field) -> Field:
        """Displacement [m] under a load [Pa]."""
        ny, nx = load.shape
        wave = fft.rfft2(load, self.shape)
        return fft.irfft2(wave * self.spectra[spectrum], self.shape)[:ny, :nx]

    def apply_pair(self, load: Float[ndarray, "2 ny nx"]) -> Float[ndarray, "2 ny nx"]:
        """Displacements along x and y under loads along both, by the spectra xx, yy, xy."""
        xx, yy, xy = self.spectra
        x, y = fft.rfft2(load, self.shape)
        pair = fft.irfft2(np.stack([xx * x + xy * y, xy * x + yy * y]), self.shape)
        return pair[:, : load.shape[1], : load.shape[2]]


@lru_cache(maxsize=8)
def normal_influence(stack: Stack, grid: Cells) -> Influence:
    """Return u_z under pressure: one spectrum."""
    (changes,) = _changes(stack, grid, lambda c: (c.normal,), (0,))
    (over_r,) = _rectangles(grid, lambda x, y, r: (x * np.log(y + r) + y * np.log(x + r),))
    return _transform(grid, over_r / (np.pi * stack.layers[0].reduced_modulus_pa) + changes)


@lru_cache(maxsize=4)
def tangential_influence(stack: Stack, grid: Cells) -> Influence:
    """Return in-plane displacement under in-plane load: spectra of xx, yy, and xy."""
    mu, nu = stack.layers[0].material
    x, y = _offsets(grid)
    turn = 2 * np.arctan2(y, x)
    round_part, lobes = _changes(
        stack, grid, lambda c: ((c.along + c.across) / 2, (c.across - c.along) / 2), (0, 2)
    )
    xx_over_r3, yy_over_r3, xy_over_r3 = _rectangles(
        grid, lambda x, y, r: (y * np.log(x + r), x * np.log(y + r), -r)
    )
    over_r = (1 - nu) * (xx_over_r3 + yy_over_r3)
    return _transform(
        grid,
        (over_r + nu * xx_over_r3) / (2 * np.pi * mu) + round_part + lobes * np.cos(turn),
        (over_r + nu * yy_over_r3) / (2 * np.pi * mu) + round_part - lobes * np.cos(turn),
        nu * xy_over_r3 / (2 * np.pi * mu) + lobes * np.sin(turn),
        odd=(False, False, True),
    )


@lru_cache(maxsize=8)
def normal_preconditioner(stack: Stack, grid: Cells) -> Influence:
    """Return an approximate inverse of the normal influence, 1 / C(k) on the periodic grid."""
    return _preconditioner(stack, grid, lambda c: c.normal)


@lru_cache(maxsize=4)
def tangential_preconditioner(stack: Stack, grid: Cells) -> Influence:
    """Return an approximate inverse of the tangential influence, for each load component."""
    return _preconditioner(stack, grid, lambda c: (c.along + c.across) / 2)


def _preconditioner(stack: Stack, grid: Cells, part: Callable[[Compliance], Waves]) -> Influence:
    k_x, k_y = 2 * np.pi * fft.rfftfreq(grid.nx, grid.dx), 2 * np.pi * fft.fftfreq(grid.ny, grid.dy)
    k = np.hypot(k_x, k_y[:, None])
    k[0, 0] = min(k_x[1], k_y[1]) / 2
    table = np.geomspace(k[0, 0], k.max(), 300)
    return Influence((np.interp(k, table, 1 / part(surface_compliance(stack, table))),), (grid.ny, grid.nx))


def _offsets(grid: Cells) -> tuple[Field, Field]:
    x, y = np.meshgrid(np.arange(grid.nx) * grid.dx, np.arange(grid.ny) * grid.dy)
    return x, y


def _rectangles(grid: Cells, corner: Callable[[Field, Field, Field], tuple[Field, ...]]) -> list[Field]:
    """Integrals over the cell at each offset, from their antiderivative at the corners."""
    x, y = np.meshgrid((np.arange(grid.nx + 1) - 0.5) * grid.dx, (np.arange(grid.ny + 1) - 0.5) * grid.dy)
    return [np.diff(np.diff(F, axis=0), axis=1) for F in corner(x, y, np.hypot(x, y))]


def _changes(stack: Stack, grid: Cells, parts: Parts, orders: tuple[int, ...]) -> list[Field]:
    """Change by the layers below in the influence of one cell, at each offset."""
    h = stack.layers[0].thickness_m
    if len(stack.layers) == 1 and stack.below:
        return [np.zeros((grid.ny, grid.nx)) for _ in orders]
    if max(grid.dx, grid.dy) > h:
        raise RangeError(
            f"cells of {grid.dx:g} x {grid.dy:g} m do not resolve a top layer of {h:g} m; give cells of at "
            "most its thickness, or leave the layer out",
            code="grid-too-coarse",
        )
    k, weights = _wavenumbers(stack, grid.diagonal_m)
    below = Stack((replace(stack.layers[0], thickness_m=np.inf),), "half-space")
    whole, alone = parts(surface_compliance(stack, k)), parts(surface_compliance(below, k))
    cell = grid.area_m2 * np.exp(-(k**2) * (grid.dx**2 + grid.dy**2) / 48)
    r = _radii(stack, grid.diagonal_m)
    at = np.hypot(*_offsets(grid))
    profiles = [
        _hankel(order, (layered - endless) * cell * k * weights / (2 * np.pi), k, r)
        for order, layered, endless in zip(orders, whole, alone, strict=True)
    ]
    return [interpolate.CubicSpline(r, values)(at) for values in profiles]


def _hankel(order: int, weighted: Waves, k: Waves, r: Radii) -> Radii:
    bessel = special.j0 if order == 0 else (lambda s: special.jv(order, s))
    blocks = np.array_split(r, -(-len(r) // RADII))
    return np.concatenate([bessel(np.outer(block, k)) @ weighted for block in blocks])


def _wavenumbers(stack: Stack, reach_m: float) -> tuple[Waves, Waves]:
    """Gauss points and weights in k on panels that grow from the longest waves, then follow J(k r)."""
    h = stack.layers[0].thickness_m
    total = sum(slab.thickness_m for slab in stack.slabs)
    return panels(1e-4 / total, CHANGES_END / h, 80, PHASE / reach_m)


def panels(start: float, end: float, count: int, widest: float) -> tuple[Waves, Waves]:
    """Return Gauss points and weights from 0 to `end`, 16 on each of `count` growing panels from
    `start`, none wider than `widest`.
    """
    growing = np.concatenate([[0.0], np.geomspace(start, end, count)])
    edges = [0.0]
    while edges[-1] < end:
        coming = growing[np.searchsorted(growing, edges[-1], side="right")]
        edges.append(min(float(coming), edges[-1] + widest))
    points, weights = np.polynomial.legendre.leggauss(16)
    low, half = np.array(edges[:-1])[:, None], np.diff(edges)[:, None] / 2
    return (low + half * (1 + points)).ravel(), (half * weights).ravel()


def _radii(stack: Stack, reach_m: float) -> Radii:
    """Nodes in r, a fixed number per length over which the influence changes."""
    h = stack.layers[0].thickness_m
    total = sum(slab.thickness_m for slab in stack.slabs)
    r = [0.0]
    while r[-1] < reach_m:
        r.append(r[-1] + min(max(h, r[-1]), total) / PER_LENGTH)
    return np.array(r)


def _transform(grid: Cells, *quadrants: Field, odd: tuple[bool, ...] = (False,)) -> Influence:
    shape = (fft.next_fast_len(2 * grid.ny - 1, real=True), fft.next_fast_len(2 * grid.nx - 1, real=True))
    spectra = []
    for quadrant, changes_sign in zip(quadrants, odd, strict=True):
        half = _mirror(quadrant, shape[1], changes_sign)
        whole = _mirror(half.T, shape[0], changes_sign).T
        spectra.append(np.ascontiguousarray(fft.rfft2(whole).real))  # even, or odd along both axes: real
        spectra[-1].flags.writeable = False
    return Influence(tuple(spectra), shape)


def _mirror(
    values: Float[ndarray, "rows half"], length: int, changes_sign: bool
) -> Float[ndarray, "rows whole"]:
    n = values.shape[1]
    padded = np.zeros((values.shape[0], length))
    padded[:, :n] = values
    padded[:, length - n + 1 :] = (-1 if changes_sign else 1) * values[:, :0:-1]
    return padded
