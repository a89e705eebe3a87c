"""Displacement of a stack's surface at grid points under a load on one cell.

Zero padding to twice the size makes the product of Fourier transforms the plain sum over cells. The influence
is that of a half-space of the top layer's material in closed form (Love's and Cerruti's rectangles), plus the
smooth change by the other layers,

    g(r) = 1/(2 pi) int_0^inf [C(k) - C_half(k)] J_n(k r) k dk,   n = 0, and 2 for tangential loads,

averaged over a cell by the factor exp(-k^2 d^2 / 24).

References: A. E. H. Love, Phil. Trans. R. Soc. A 228, 377 (1929), doi:10.1098/rsta.1929.0009; K. L. Johnson,
Contact Mechanics (1985), sec. 3.2 and 3.6, doi:10.1017/CBO9781139171731.

Regular grid on a stack's surface, and loads on it as waves.

The grid is padded and periodic, so a sum over waves approximates an integral. The mean wave is corrected so
that sum and integral agree at the centre of a Gaussian load; the remaining effect of images grows as (r /
period)^2.

Frictionless elastic ball on a stack of bonded layers, exact for small strain.

Compliances of ball and stack add. With the ball as Hertz's paraboloid, 1/E = 1/E_top + 1/E_ball (Young's
moduli over 1 - nu^2), and the stack's compliance C(k),

    C(k) + 2 / (E_ball k) = 2 M(k) / (E k),        M -> 1 at short waves,
    g(t) - (2/pi) int_0^a g(s) int_0^inf [1 - M(k)] cos(k s) cos(k t) dk ds = d - t^2 / R,     g(a) = 0,

as in `bonded_layer`, and F = 2 E int_0^a g dt. The ball takes (E / E_ball) g(0) of the displacement d at the
axis. Layers are laterally unbounded, hence too stiff for a narrow specimen.

Reference: W. C. Hayes et al., J. Biomech. 5 (1972) 541, doi:10.1016/0021-9290(72)90010-3, for one layer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import fft, interpolate, special
from scipy.optimize import brentq

from palpate.core import Complex, Field, Float, InputError, Int, RangeError, ndarray
from palpate.mechanics.half_space.hertz import MAX_SLOPE, Body
from palpate.mechanics.layers.stack import Compliance, Stack, climb, surface_compliance

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


CHANGES_END = 13.0  # k h beyond which the change vanishes (1e-8)
PHASE = 8.0  # maximum k r per panel of 16 Gauss points
PER_LENGTH = 12  # nodes of the radial spline per characteristic length
RADII = 64  # radii integrated at once, which bounds the memory

Spectrum = Float[ndarray, "py half"]
Wavenumbers = Float[ndarray, " k"]
Radii = Float[ndarray, " r"]
Parts = Callable[[Compliance], tuple[Wavenumbers, ...]]


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


def _preconditioner(stack: Stack, grid: Cells, part: Callable[[Compliance], Wavenumbers]) -> Influence:
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


def _hankel(order: int, weighted: Wavenumbers, k: Wavenumbers, r: Radii) -> Radii:
    bessel = special.j0 if order == 0 else (lambda s: special.jv(order, s))
    blocks = np.array_split(r, -(-len(r) // RADII))
    return np.concatenate([bessel(np.outer(block, k)) @ weighted for block in blocks])


def _wavenumbers(stack: Stack, reach_m: float) -> tuple[Wavenumbers, Wavenumbers]:
    """Gauss points and weights in k on panels that grow from the longest waves, then follow J(k r)."""
    h = stack.layers[0].thickness_m
    total = sum(slab.thickness_m for slab in stack.slabs)
    return panels(1e-4 / total, CHANGES_END / h, 80, PHASE / reach_m)


def panels(start: float, end: float, count: int, widest: float) -> tuple[Wavenumbers, Wavenumbers]:
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


class PlaneResponse(NamedTuple):
    """Motion of a plane per wave of load [m/Pa].

    Attributes:
        xx, xy, yy: In plane by shear.
        pressed_x, pressed_y: i times this in plane by pressure.
        lifted_x, lifted_y: -i times this along z by shear.
        zz: Along z by pressure.
    """

    waves: Waves
    xx: Spectrum
    xy: Spectrum
    yy: Spectrum
    pressed_x: Spectrum
    pressed_y: Spectrum
    lifted_x: Spectrum
    lifted_y: Spectrum
    zz: Spectrum


@lru_cache(maxsize=16)
def plane_response(stack: Stack, interface: int, side: int, cell_m: float) -> PlaneResponse:
    """Return the response of the plane below a number of layers, on a square periodic grid (cached)."""
    waves = spread(Cells(side, side, cell_m, cell_m), 0.0)
    in_plane, across = climb(stack.slabs, stack.below, waves.k)
    one, other = in_plane[interface], across[interface]
    CR = one.compliance @ one.transmission / waves.k[:, None, None]
    cr = (other.compliance @ other.transmission)[:, 0, 0] / waves.k
    on, c, s = waves.gather, waves.cos, waves.sin
    along, sideways, coupled = on(CR[:, 0, 0]), on(cr), on(CR[:, 0, 1])
    lifted = on(CR[:, 1, 0])
    xx, yy = c * c * along + s * s * sideways, s * s * along + c * c * sideways
    zz = on(CR[:, 1, 1])
    zz[0, 0] = waves.mean_wave(CR[:, 1, 1])
    xx[0, 0] = yy[0, 0] = waves.mean_wave((CR[:, 0, 0] + cr) / 2)
    fields = (xx, c * s * (along - sideways), yy, c * coupled, s * coupled, c * lifted, s * lifted, zz)
    return PlaneResponse(waves, *fields)


MAX_STRAIN = 0.2  # maximum depth over the stack's thickness
NODES = 48  # nodes over the contact
TOP_END = 25.0  # k h beyond which 1 - M vanishes
STACK_START = 1e-4  # k times the stack's thickness of the first panel

Points = Float[ndarray, " n"]


class BallPress(NamedTuple):
    """Contact radius [m], displacement of ball against floor [m], force [N], and the stack's part [m]."""

    radius_m: float
    approach_m: float
    force_n: float
    sunk_m: float


@dataclass(frozen=True, slots=True)
class PressCourse:
    """Presses by rising contact radius, the first row at rest: contact radius, approach, force, and depth of
    the stack at the axis.
    """

    radius_m: Points
    approach_m: Points
    force_n: Points
    sunk_m: Points

    @property
    def area_m2(self) -> Points:
        return np.pi * self.radius_m**2


def press_to_radius(stack: Stack, ball: Body, radius_m: float) -> BallPress:
    """Press an elastic ball on a stack to a contact radius, at most half the ball's [m].

    Example:
        >>> from palpate.mechanics.layers.stack import ElasticLayer
        >>> silicone = Stack((ElasticLayer(7e-3, 0.2e6, 0.499), ElasticLayer(7e-3, 0.1e6, 0.499)))
        >>> press = press_to_radius(silicone, Body(66.7e3, 15e-3), 5e-3)
        >>> round(press.force_n, 2), round(press.approach_m * 1e3, 2)
        (0.59, 1.61)
    """
    widest = MAX_SLOPE * ball.radius_m
    if not 0.0 <= radius_m <= widest * (1 + 1e-12):
        raise RangeError(
            f"a contact of {radius_m * 1e3:g} mm lies outside 0 to {widest * 1e3:g} mm, half of the ball's "
            "radius, where Hertz's ball holds; press less, or take a larger ball",
            code="outside-law",
        )
    if radius_m == 0.0:
        return BallPress(0.0, 0.0, 0.0, 0.0)
    top = stack.layers[0].reduced_modulus_pa
    E, a = 1 / (1 / top + 1 / ball.modulus_pa), radius_m
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    t = a * np.concatenate([[0.0], (1 + nodes) / 2, [1.0]])  # axis and rim have no weight
    weights = a * np.concatenate([[0.0], weights / 2, [0.0]])
    k, dk = _waves(stack, a)
    rest = (2 / (top * k) - surface_compliance(stack, k).normal) * E * k / 2  # 1 - M
    waves = np.cos(np.outer(t, k))
    inverse = np.linalg.inv(np.eye(len(t)) - 2 / np.pi * (waves * rest * dk) @ waves.T * weights)
    flat, curved = inverse.sum(axis=1), inverse @ (t**2 / ball.radius_m)
    depth = float(curved[-1] / flat[-1])
    g = depth * flat - curved
    return BallPress(a, depth, float(2 * E * (weights @ g)), depth - float(E / ball.modulus_pa * g[0]))


def press_course(stack: Stack, ball: Body, count: int = 40, until_n: float | None = None) -> PressCourse:
    """Press an elastic ball on a stack in even steps of contact radius.

    Args:
        stack: Layers.
        ball: Ball, possibly rigid.
        count: Presses after rest, 2 or more.
        until_n: Force of the last press [N]; by default the limit of small strain: a contact of half the
            ball's radius, or a fifth of the stack's thickness.
    """
    widest = MAX_SLOPE * ball.radius_m
    deepest = MAX_STRAIN * stack.thickness_m
    if press_to_radius(stack, ball, widest).sunk_m > deepest:
        widest = brentq(
            lambda a: press_to_radius(stack, ball, a).sunk_m - deepest,
            1e-3 * widest,
            widest,
            xtol=1e-300,
            rtol=1e-12,
        )
    if until_n is not None:
        most = press_to_radius(stack, ball, widest).force_n
        if not 0 < until_n <= most * (1 + 1e-9):
            raise RangeError(
                f"a press to {until_n:g} N; above 0 and at most {most:.4g} N are allowed, where the contact "
                "has half of the ball's radius or the stack is pressed in by a fifth of its thickness",
                code="outside-law",
            )
        if until_n < most:
            widest = brentq(
                lambda a: press_to_radius(stack, ball, a).force_n - until_n,
                0.0,
                widest,
                xtol=1e-300,
                rtol=1e-13,
            )
    presses = [press_to_radius(stack, ball, a) for a in np.linspace(0.0, widest, count + 1)]
    return PressCourse(*(np.array(column) for column in zip(*presses, strict=True)))


def _waves(stack: Stack, radius_m: float) -> tuple[Wavenumbers, Wavenumbers]:
    """Gauss points and weights in k on panels that grow from the longest waves, then follow cos(k a)."""
    h = stack.layers[0].thickness_m
    if math.isinf(h):  # a half-space, where 1 - M is 0
        h = radius_m
    total = sum(slab.thickness_m for slab in stack.slabs) or h
    return panels(STACK_START / total, TOP_END / h, 60, PHASE / radius_m)
