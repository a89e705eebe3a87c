"""The march of `march.py`, compiled in single precision; light differs by less than 1e-5 for fine slices."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from palpate.core import Complex, Float, Float32, InputError, ndarray

PIECES = 4  # pieces per thread, for load balance
TILE = 64  # rays marched together; 31 bands x 4 float32 are 32 kB
MIN_RAYS = 2048  # minimum rays per piece

Slices = Float[ndarray, "s *n"]
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
