"""Polarised light through slices of birefringence whose axes rotate along the ray.

Each slice is a linear retarder exp(i (u s3 + v s1)) in Pauli matrices, with u and v half the phase of s_xx -
s_zz and 2 s_xz. The product is a unit quaternion q0 + i (q1 s3 + q2 s1 + q3 s2); for a symmetric ray q3 = 0.

Reference: H. Aben and C. Guillemet, Photoelasticity of Glass, Springer (1993), on integrated photoelasticity.

Light through an axisymmetric table of stress, ray by ray.

A ray along y at signed offset s and depth z sees, at r = sqrt(s^2 + y^2) with cos = s / r,

    s_xx - s_zz = (s_rr - s_tt) cos^2 + (s_tt - s_zz),      2 s_xz = 2 s_rz cos.

Slices are equal steps of atan(y / scale); parts above the deformed surface are cut off. The table is bilinear
in (r, zeta), with zeta from the deformed surface to the bottom.

The march of `march.py`, compiled in single precision; light differs by less than 1e-5 for fine slices.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from palpate.core import Complex, Float, Float32, InputError, RangeError, ndarray

Summed = Float[ndarray, "*n"]
Slices = Float[ndarray, "s *n"]


class Retarder(NamedTuple):
    """The unitary q0 + i (q1 s3 + q2 s1 + q3 s2): `q1` along the axes x and z, `q2` along their diagonals,
    `q3` rotation.
    """

    q0: Summed
    q1: Summed
    q2: Summed
    q3: Summed

    def then(self, after: Retarder) -> Retarder:
        """This retarder first, `after` next."""
        p0, p1, p2, p3 = self
        a0, a1, a2, a3 = after
        return Retarder(
            a0 * p0 - a1 * p1 - a2 * p2 - a3 * p3,
            a0 * p1 + a1 * p0 - a2 * p3 + a3 * p2,
            a0 * p2 + a2 * p0 + a1 * p3 - a3 * p1,
            a0 * p3 + a3 * p0 - a1 * p2 + a2 * p1,
        )

    def backwards(self) -> Retarder:
        """The same slices in the opposite order."""
        return self._replace(q3=-self.q3)


def graded_slices(scale_m: Float[ndarray, "*n"], count: int) -> tuple[ndarray, ndarray]:
    """Return midpoints y > 0 and thicknesses dy of slices on half a ray [m], in equal steps of atan(y /
    scale).
    """
    if count < 1:
        raise InputError(f"{count} slices make no ray; give 1 or more")
    step = np.pi / 2 / count
    angle = ((np.arange(count) + 0.5) * step).reshape(-1, *(1,) * np.ndim(scale_m))
    return scale_m * np.tan(angle), scale_m / np.cos(angle) ** 2 * step


def march(difference: Slices, shear: Slices, per_stress: float) -> Retarder:
    """March polarised light through slices in order; second order in the slices' thickness.

    Args:
        difference: (s_xx - s_zz) dy of each slice [Pa m].
        shear: 2 s_xz dy of each slice [Pa m].
        per_stress: pi C / lambda [1/(Pa m)].
    """
    total = _slice(difference[0], shear[0], per_stress)
    for a, b in zip(difference[1:], shear[1:], strict=True):
        total = total.then(_slice(a, b, per_stress))
    return total


def march_even(difference: Slices, shear: Slices, per_stress: float) -> Retarder:
    """March a whole symmetric ray from its half with y > 0."""
    half = march(difference, shear, per_stress)
    return half.backwards().then(half)


def _slice(a: Summed, b: Summed, per_stress: float) -> Retarder:
    half_phase = per_stress * np.hypot(a, b)
    turn = per_stress * np.sinc(half_phase / np.pi)
    return Retarder(np.cos(half_phase), turn * a, turn * b, np.zeros_like(a))


PIECES = 4  # pieces per thread, for load balance
TILE = 64  # rays marched together; 31 bands x 4 float32 are 32 kB
MIN_RAYS = 2048  # minimum rays per piece

Spectral = Float32[ndarray, "k *n"]


def march_colour(
    difference: Slices,
    shear: Slices,
    half_phase: Float[ndarray, " k"],
    weight: Float[ndarray, "k c"],
    amplitude: Complex[ndarray, "k 4"],
    even: bool = False,
    threads: int | None = None,
) -> Float32[ndarray, "*n c"]:
    """Return the light of each ray through its slices, summed over the bands.

    Args:
        difference: (s_xx - s_zz) dy of each slice [Pa m].
        shear: 2 s_xz dy of each slice [Pa m].
        half_phase: pi C / lambda of each band [1/(Pa m)]; see `StressOpticLaw.half_phase`.
        weight: Weight of each band in each channel, as in `Spectrum.weight`.
        amplitude: Polariscope in each band; see `plane_amplitude`.
        even: Whether slices are the half of a symmetric ray, as in `march_even`.
        threads: Number of threads; None for all processors or NUMBA_NUM_THREADS.
    """
    check_bands(half_phase, weight, amplitude)
    if difference.shape != shear.shape or difference.ndim < 2 or len(difference) < 1:
        raise InputError(
            f"slices of shapes {difference.shape} and {shear.shape}; give two equal ones [slices, rays]",
            code="shape",
        )
    from palpate.optics import march_kernels  # deferred: compiles kernels

    shape = difference.shape[1:]
    u, v = (_rows(part) for part in (difference, shear))
    light = np.zeros((weight.shape[1], u.shape[1]), np.float32)
    optics = kernel_bands(half_phase, weight, amplitude)

    def piece(first: int, last: int) -> None:
        march_kernels.march_stack(first, last, u, v, even, *optics, light)

    in_threads(piece, u.shape[1], threads)
    if not np.isfinite(light).all():
        raise InputError("some slice is not a finite number of Pa m; look for NaN or infinity in the stress")
    return np.ascontiguousarray(light.T).reshape(*shape, -1)


def march_spectral(
    difference: Slices,
    shear: Slices,
    half_phase: Float[ndarray, " k"],
    amplitude: Complex[ndarray, "k 4"],
    even: bool = False,
    threads: int | None = None,
) -> Spectral:
    """Return the light of each ray in each band; arguments as in `march_colour`."""
    each = np.eye(len(half_phase))
    return np.moveaxis(march_colour(difference, shear, half_phase, each, amplitude, even, threads), -1, 0)


def check_bands(
    half_phase: Float[ndarray, " k"], weight: Float[ndarray, "k c"], amplitude: Complex[ndarray, "k 4"]
) -> None:
    """Reject bands that do not fit each other or are not finite."""
    k = len(half_phase)
    if k < 1 or weight.ndim != 2 or len(weight) != k or amplitude.shape != (k, 4):
        raise InputError(
            f"{k} half phases, weights {weight.shape}, amplitudes {amplitude.shape}; give one row a band: "
            "[k], [k c] and [k 4]"
        )
    if not all(np.isfinite(part).all() for part in (half_phase, weight, amplitude)):
        raise InputError("half phases, weights and amplitudes must be finite; look for NaN")


def kernel_bands(half_phase: ndarray, weight: ndarray, amplitude: ndarray) -> tuple[ndarray, ...]:
    """Return the kernels' bands: half phases, parts of the amplitudes, weights."""
    parts = (half_phase, amplitude.real, amplitude.imag, weight)
    return tuple(np.ascontiguousarray(part, dtype=np.float32) for part in parts)


def in_threads(piece: Callable[[int, int], None], rays: int, threads: int | None) -> None:
    """Run `piece(first, last)` over all rays, in threads."""
    count = _threads() if threads is None else threads
    if count < 1:
        raise InputError(f"{count} threads cannot work; give 1 or more")
    pieces = min(count * PIECES, rays // MIN_RAYS) if count > 1 else 1
    if pieces < 2:
        piece(0, rays)
        return
    # whole tiles, so that results do not depend on the number of threads
    ends = np.minimum(np.linspace(0, -(-rays // TILE), pieces + 1).astype(int) * TILE, rays).tolist()
    with ThreadPoolExecutor(count) as pool:
        for task in [pool.submit(piece, a, b) for a, b in pairwise(ends)]:
            task.result()


def _threads() -> int:
    if count := os.environ.get("NUMBA_NUM_THREADS"):
        return int(count)
    allowed = getattr(os, "sched_getaffinity", None)  # Linux only
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def _rows(part: ndarray) -> ndarray:
    return np.ascontiguousarray(part, dtype=np.float32).reshape(len(part), -1)


Along = Float[ndarray, "*_"]
Numbers = Float[ndarray, "5 *n"]


@dataclass(frozen=True, slots=True)
class AxisymmetricField:
    """Axisymmetric stress in a pressed layer, in the deformed body.

    Attributes:
        r_m: Radii, ascending from 0 [m].
        zeta: Relative depths from the deformed surface to the bottom, from 0 to 1.
        surface_m: z of the deformed surface at each r, positive in the dimple [m].
        thickness_m: z of the bottom [m].
        stress_pa: Cauchy rr, tt, zz, rz, positive in tension [Pa].
    """

    r_m: Float[ndarray, " n"]
    zeta: Float[ndarray, " m"]
    surface_m: Float[ndarray, " n"]
    thickness_m: float
    stress_pa: Float[ndarray, "4 m n"]

    def __post_init__(self) -> None:
        n, m = len(self.r_m), len(self.zeta)
        if min(n, m) < 2 or self.surface_m.shape != (n,) or self.stress_pa.shape != (4, m, n):
            raise InputError(
                f"{n} radii, {m} depths, surface {self.surface_m.shape}, stress {self.stress_pa.shape}; give "
                "two or more of each, surface [n] and stress [4 m n]"
            )
        if not all(np.isfinite(part).all() for part in (self.r_m, self.zeta, self.surface_m, self.stress_pa)):
            raise InputError("radii, depths, surface and stress must be finite numbers; look for NaN")
        if self.r_m[0] != 0 or (np.diff(self.r_m) <= 0).any():
            raise InputError("the radii must ascend from 0 m")
        if self.zeta[0] != 0 or abs(self.zeta[-1] - 1) > 1e-9 or (np.diff(self.zeta) <= 0).any():
            raise InputError("zeta must ascend from 0 at the surface to 1 at the bottom")
        if not (np.isfinite(self.thickness_m) and self.thickness_m > self.surface_m.max()):
            raise RangeError(
                f"bottom at {self.thickness_m} m, surface down to {self.surface_m.max()} m: no skin is left; "
                "give a bottom below the surface"
            )


@dataclass(frozen=True, slots=True)
class Rays:
    """Straight rays along y; the arrays broadcast to one shape.

    Attributes:
        offset_m: s, the ray's x less the axis's [m].
        depth_m: z; negative above the rest surface [m].
        start_m, end_m: y of entry and exit, 0 being nearest to the axis [m].
        scale_m: Scale of the slices, positive [m].
    """

    offset_m: Along
    depth_m: Along
    start_m: Along
    end_m: Along
    scale_m: Along

    def __post_init__(self) -> None:
        parts = [getattr(self, part.name) for part in fields(self)]
        try:
            np.broadcast_shapes(*(part.shape for part in parts))
        except ValueError as e:
            raise InputError(f"shapes {[p.shape for p in parts]} do not broadcast to one set of rays") from e
        if not all(np.isfinite(part).all() for part in parts):
            raise InputError("every number of a ray must be finite, in metres; look for NaN or infinity")
        if not ((self.scale_m > 0).all() and (self.end_m > self.start_m).all()):
            raise RangeError("each ray needs a positive scale [m] and an end beyond its start [m]")

    @property
    def shape(self) -> tuple[int, ...]:
        return np.broadcast_shapes(*(getattr(self, part.name).shape for part in fields(self)))

    def broadcast(self) -> Numbers:
        return np.stack([np.broadcast_to(getattr(self, part.name), self.shape) for part in fields(self)])


FINEST = 4096  # steps of the lookup of graded knots
Bands = Float[ndarray, " k"]
Weights = Float[ndarray, "k c"]
Amplitudes = Complex[ndarray, "k 4"]


class MarchedRays(NamedTuple):
    """Transmitted fraction in each channel, length inside the membrane [m], and its part beyond the table
    [m].
    """

    light: Float32[ndarray, "*n c"]
    skin_m: Float32[ndarray, "*n"]
    outside_m: Float32[ndarray, "*n"]


def march_axisymmetric(
    field: AxisymmetricField,
    rays: Rays,
    half_phase: Bands,
    weight: Weights,
    amplitude: Amplitudes,
    slices: int = 64,
    frozen_pa: tuple[Along | float, Along | float] = (0.0, 0.0),
    threads: int | None = None,
) -> MarchedRays:
    """March the light of each ray through the table.

    Args:
        field: Table.
        rays: Rays.
        half_phase: pi C / lambda of each band [1/(Pa m)]; see `StressOpticLaw.half_phase`.
        weight: Weight of each band in each channel, as in `Spectrum.weight`.
        amplitude: Polariscope in each band; see `plane_amplitude` and `circular_amplitude`.
        slices: Number per ray; 64 suffice up to 5 fringes below the rest surface, 128 through a bulge.
        frozen_pa: s_xx - s_zz and 2 s_xz of residual birefringence, uniform along each ray; see
            `frozen_stress`.
        threads: Number of threads; None for all processors or NUMBA_NUM_THREADS.
    """
    _check_march(half_phase, weight, amplitude, slices, frozen_pa)
    from palpate.optics import axisymmetric_kernels  # deferred: compiles kernels

    unit = field.r_m[-1]
    paths = rays.broadcast().reshape(5, -1) / unit
    light = np.zeros((weight.shape[1], paths.shape[1]), np.float32)
    inside = np.zeros((2, paths.shape[1]), np.float32)
    table, frozen = _table(field), _each(frozen_pa, rays)
    optics = kernel_bands(half_phase * unit, weight, amplitude)

    def piece(first: int, last: int) -> None:
        axisymmetric_kernels.march_rays(first, last, paths, slices, table, frozen, *optics, light, inside)

    in_threads(piece, paths.shape[1], threads)
    skin, outside = (inside * np.float32(unit)).reshape(2, *rays.shape)
    return MarchedRays(np.ascontiguousarray(light.T).reshape(*rays.shape, -1), skin, outside)


def _each(frozen_pa: tuple[Along | float, Along | float], rays: Rays) -> Float32[ndarray, "2 n"]:
    """Frozen stress of every ray."""
    try:
        each = [np.broadcast_to(np.asarray(part, np.float32), rays.shape) for part in frozen_pa]
    except ValueError as e:
        raise InputError(
            f"frozen stress {[np.shape(part) for part in frozen_pa]} does not broadcast to rays {rays.shape}"
        ) from e
    return np.ascontiguousarray(np.stack(each).reshape(2, -1))


def _table(field: AxisymmetricField) -> tuple[ndarray | np.float32, ...]:
    """The kernel's table: single precision, lengths in the last radius, radius first."""
    unit = field.r_m[-1]
    rr, tt, zz, rz = field.stress_pa
    stress = np.stack([rr - tt, tt - zz, 2 * rz, 0 * rz], axis=-1).swapaxes(0, 1)
    return (
        *_index(field.r_m / unit),
        *_index(field.zeta),
        (field.surface_m / unit).astype(np.float32),
        np.float32(field.thickness_m / unit),
        np.ascontiguousarray(stress, np.float32),
    )


def _index(knots: ndarray) -> tuple[ndarray, ndarray, np.float32]:
    """Knots from 0 to 1, the interval each of FINEST equal steps starts in, and steps per unit."""
    at = np.arange(FINEST) / FINEST
    start = np.searchsorted(knots.astype(np.float32), at.astype(np.float32), side="right") - 1
    return knots.astype(np.float32), np.clip(start, 0, len(knots) - 2).astype(np.int32), np.float32(FINEST)


def _check_march(
    half_phase: Bands, weight: Weights, amplitude: Amplitudes, slices: int,
    frozen_pa: tuple[Along | float, Along | float],
) -> None:  # fmt: skip
    check_bands(half_phase, weight, amplitude)
    if slices < 1:
        raise InputError(f"{slices} slices make no ray; give 1 or more")
    if not all(np.isfinite(part).all() for part in frozen_pa):
        raise InputError(f"frozen stress {frozen_pa} Pa must be finite: two numbers, or two for each ray")
