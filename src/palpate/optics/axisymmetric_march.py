"""Light through an axisymmetric table of stress, ray by ray.

A ray along y at signed offset s and depth z sees, at r = sqrt(s^2 + y^2) with cos = s / r,

    s_xx - s_zz = (s_rr - s_tt) cos^2 + (s_tt - s_zz),      2 s_xz = 2 s_rz cos.

Slices are equal steps of atan(y / scale); parts above the deformed surface are cut off. The table is bilinear
in (r, zeta), with zeta from the deformed surface to the bottom.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from palpate.core import Complex, Float, Float32, InputError, RangeError, ndarray
from palpate.optics.compiled_march import check_bands, in_threads, kernel_bands

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
