"""Regular grid on a stack's surface, and loads on it as waves.

The grid is padded and periodic, so a sum over waves approximates an integral. The mean wave is corrected so
that sum and integral agree at the centre of a Gaussian load; the remaining effect of images grows as (r /
period)^2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import fft

from palpate.core import Complex, Field, Float, InputError, Int, ndarray

UNEVEN = 1e-6  # relative tolerance of grid steps


class Cells(NamedTuple):
    """Number of cells along x and y, and their size [m]."""

    nx: int
    ny: int
    dx: float
    dy: float

    @property
    def area_m2(self) -> float:
        return self.dx * self.dy

    @property
    def diagonal_m(self) -> float:
        return float(np.hypot((self.nx - 1) * self.dx, (self.ny - 1) * self.dy))


def cells(x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"]) -> Cells:
    """Return the cells around grid points (columns and rows in equal rising steps, 3 or more) [m]."""
    return Cells(len(x_m), len(y_m), _step("x_m", x_m), _step("y_m", y_m))


def _step(name: str, axis_m: Float[ndarray, " n"]) -> float:
    steps = np.diff(axis_m)
    mean = float(steps.mean()) if len(axis_m) >= 3 else np.nan
    if not (mean > 0.0 and np.abs(steps - mean).max() <= UNEVEN * mean):
        raise InputError(
            f"{name} is not a regular grid: give 3 or more positions in m that rise in equal steps, as of "
            "np.linspace"
        )
    return mean


BLOCK = 32  # increment of grid parts, so that cached results are shared


def block_span(indices: Int[ndarray, " n"], count: int) -> slice:
    """Return the part of an axis that contains cells, grown to whole blocks."""
    first, last = int(indices.min()), int(indices.max())
    length = min(-(-(last - first + 1) // BLOCK) * BLOCK, count)
    start = min(max((first + last + 1 - length) // 2, 0), count - length)
    return slice(start, start + length)


Places = Float[ndarray, "v u"]


def laid_onto(
    values: Places, x: Places, y: Places, x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"]
) -> Field:
    """Distribute values at points to the four surrounding points of a grid by bilinear weights."""
    onto = np.zeros((len(y_m), len(x_m)))
    loaded = values > 0.0
    column, row = (x[loaded] - x_m[0]) / (x_m[1] - x_m[0]), (y[loaded] - y_m[0]) / (y_m[1] - y_m[0])
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    for name, at, axis in (("x", left, x_m), ("y", top, y_m)):
        if at.size and not (at.min() >= 0 and at.max() < len(axis) - 1):
            raise InputError(
                f"what presses reaches beyond the grid, {axis[0]:g} to {axis[-1]:g} m along {name}; give a "
                "larger grid"
            )
    right_share, low_share = column - left, row - top
    for down in (0, 1):
        for aside in (0, 1):
            share = np.abs(1 - aside - right_share) * np.abs(1 - down - low_share)
            np.add.at(onto, (top + down, left + aside), share * values[loaded])
    return onto


MEAN_WAVE = 1e-6  # mean wave's wavenumber over the smallest
ALIKE = 6  # decimals of (k/dk)^2 that distinguish wavenumbers
GAUSS_WIDTH = 6.0  # width of the Gaussian load's spectrum, in dk
GAUSS_END = 6.0  # end of the spectrum in widths (2e-16)

Wave = Complex[ndarray, "py half"]
Waveform = Float[ndarray, " k"]


class Waves(NamedTuple):
    """Waves of a padded grid.

    Attributes:
        k: Distinct wavenumbers of the grid, then those of the integral [1/m]; the first represents the mean.
        share: Weights that turn values at these k into the mean wave's.
        which: Index of each wave's wavenumber.
        cos, sin: Direction; both 0 for the mean.
        grid, shape: Rows and columns without and with the margin.
    """

    k: Waveform
    share: Waveform
    which: Int[ndarray, "py half"]
    cos: Float[ndarray, "py half"]
    sin: Float[ndarray, "py half"]
    grid: tuple[int, int]
    shape: tuple[int, int]

    def gather(self, values: Waveform) -> Float[ndarray, "py half"]:
        """Distribute values by wavenumber to each wave."""
        return values[self.which]

    def mean_wave(self, values: Waveform) -> float:
        """Value of the mean wave for which sum and integral agree."""
        return float(self.share @ values)

    def forward(self, load: Field) -> Wave:
        return fft.rfft2(load, self.shape)

    def back(self, wave: Wave) -> Field:
        """Sum of waves on the grid without the margin."""
        rows, columns = self.grid
        return fft.irfft(fft.ifft(wave, axis=0)[:rows], self.shape[1], axis=1)[:, :columns]


def spread(grid: Cells, margin_m: float) -> Waves:
    """Return the waves of a grid with a margin, with equal periods along x and y."""
    period = max(grid.nx * grid.dx, grid.ny * grid.dy) + margin_m
    py, px = (fft.next_fast_len(math.ceil(period / d - 1e-9), real=True) for d in (grid.dy, grid.dx))
    k_x, k_y = 2 * np.pi * fft.rfftfreq(px, grid.dx), 2 * np.pi * fft.fftfreq(py, grid.dy)[:, None]
    cell = k_x[1] * k_y[1, 0]
    squares, which = np.unique(np.round((k_x**2 + k_y**2) / cell, ALIKE), return_inverse=True)
    k = np.sqrt(squares * cell)
    direction = np.maximum(k[which], k[1])
    k[0] = MEAN_WAVE * k[1]
    width = min(GAUSS_WIDTH * math.sqrt(cell), min(k_x.max(), k_y.max()) / GAUSS_END)
    more, rings = _rings(GAUSS_END * width)
    twice = np.where((k_x > 0.0) & (np.arange(len(k_x)) * 2 != px), 2.0, 1.0)  # one of each pair is kept
    times = np.bincount(which.ravel(), np.broadcast_to(twice, which.shape).ravel())
    times[0] = 0.0
    every = np.concatenate([k, more])
    share = np.concatenate([-times, rings / cell]) * np.exp(-((every / width) ** 2))
    return Waves(every, share, which, k_x / direction, k_y / direction, (grid.ny, grid.nx), (py, px))


def _rings(end: float) -> tuple[Waveform, Waveform]:
    """Wavenumbers from 0 to an end, dense near 0, and the areas of their rings."""
    edges = np.concatenate([[0.0], np.geomspace(1e-5 * end, end, 31)])
    points, weights = np.polynomial.legendre.leggauss(8)
    low, half = edges[:-1, None], np.diff(edges)[:, None] / 2
    k = (low + half * (1 + points)).ravel()
    return k, 2 * np.pi * k * (half * weights).ravel()
