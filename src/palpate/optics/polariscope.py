"""Polariscopes: transmission through polariser, sample, and analyser, with or without quarter-wave plates.

The amplitude behind the analyser is linear in the sample's quaternion, c0 q0 + c1 q1 + c2 q2 + c3 q3, with
four complex numbers per polariscope; the light is its squared modulus.
"""

from __future__ import annotations

import numpy as np

from palpate.core import Complex, Float, InputError, RangeError, ndarray
from palpate.optics.march import Retarder

Light = Float[ndarray, "*n"]
Points = Float[ndarray, "..."] | float
Amplitude = Complex[ndarray, "4"]
Jones = Complex[ndarray, "*k 2 2"]

UNITS = np.array([np.eye(2), 1j * np.diag([1, -1]), [[0, 1j], [1j, 0]], [[0, 1], [-1, 0]]])  # of q0 to q3


def single_retarder(order: Light, axis_rad: Light, polariser_rad: float) -> Light:
    """Return sin^2(2 (theta - psi)) sin^2(pi N) of one retarder of order N at axis theta, polariser psi, from
    x towards z [rad].
    """
    return np.asarray(np.sin(2 * (axis_rad - polariser_rad)) ** 2 * np.sin(np.pi * order) ** 2)


def linear_retarder(order: Points, axis_rad: Points) -> Retarder:
    """Return a plate of fringe order N whose axis of larger index lies at `axis_rad` from x towards z."""
    half, twice = np.broadcast_arrays(np.pi * np.asarray(order), 2 * np.asarray(axis_rad))
    s = np.sin(half)
    return Retarder(np.cos(half), s * np.cos(twice), s * np.sin(twice), np.zeros(half.shape))


def dark_field(ray: Retarder, polariser_rad: float) -> Light:
    """Return the transmitted fraction of a marched ray between crossed ideal polarisers."""
    linear = ray.q2 * np.cos(2 * polariser_rad) - ray.q1 * np.sin(2 * polariser_rad)
    return np.asarray(linear**2 + ray.q3**2)


def circular_dark_field(ray: Retarder) -> Light:
    """Return the transmitted fraction between crossed ideal circular polarisers; sin^2(delta/2) for one
    retarder.
    """
    return np.asarray(ray.q1**2 + ray.q2**2)


def plane_amplitude(polariser_rad: float, bands: int, light_field: bool = False) -> Complex[ndarray, "k 4"]:
    """Return the four numbers of a plane polariscope in each band; `light_field` aligns the analyser with the
    polariser.
    """
    if bands < 1 or not np.isfinite(polariser_rad):
        raise InputError(
            f"{bands} bands and polariser at {polariser_rad} rad; give 1 or more, and a finite angle"
        )
    plates = np.broadcast_to(np.eye(2, dtype=complex), (bands, 2, 2))
    return _amplitude(polariser_rad, plates, plates, light_field)


def circular_amplitude(
    wavelength_m: Float[ndarray, " k"],
    quarter_wave_m: float = 550e-9,
    polariser_rad: float = 0.0,
    light_field: bool = False,
    axis_error_rad: float = 0.0,
) -> Complex[ndarray, "k 4"]:
    """Return the four numbers of a circular polariscope in each band.

    Polariser, plate at +45 degrees to it, sample, plate at -45 degrees, analyser. Retardance falls as
    1/lambda.

    Args:
        wavelength_m: Bands [m].
        quarter_wave_m: Wavelength at which the plates are exact [m].
        polariser_rad: From x towards z [rad].
        light_field: Whether the analyser is along the polariser.
        axis_error_rad: Excess rotation of the second plate [rad].
    """
    if not (np.all(wavelength_m > 0) and quarter_wave_m > 0):
        raise RangeError("wavelengths must be positive; give metres, such as 550e-9")
    if not np.isfinite(polariser_rad + axis_error_rad):
        raise RangeError(f"angles {polariser_rad} and {axis_error_rad} rad must be finite numbers")
    order = quarter_wave_m / (4 * wavelength_m)
    first, second = (
        jones(linear_retarder(order, polariser_rad + turn))
        for turn in (np.pi / 4, -np.pi / 4 + axis_error_rad)
    )
    return _amplitude(polariser_rad, first, second, light_field)


def through(ray: Retarder, amplitude: Amplitude) -> Light:
    """Return the transmitted fraction of a marched ray through a polariscope, at one wavelength."""
    return np.asarray(abs(sum(c * q for c, q in zip(amplitude, ray, strict=True))) ** 2)


def jones(ray: Retarder) -> Jones:
    """Return the Jones matrix of a retarder, for the amplitudes along x and z."""
    return np.asarray(np.tensordot(np.stack(ray, axis=-1), UNITS, axes=1))


def mueller(ray: Retarder) -> Float[ndarray, "*k 4 4"]:
    """Return the Mueller matrix of a retarder in the basis I, Q (x against z), U (diagonals), V (Im(E_x* E_z)
    > 0).
    """
    pauli = np.array([np.eye(2), np.diag([1, -1]), [[0, 1], [1, 0]], [[0, -1j], [1j, 0]]])
    J = jones(ray)
    rotated = np.einsum("...ab,jbc,...dc->...jad", J, pauli, J.conj())
    return np.asarray(np.einsum("iab,...jba->...ij", pauli, rotated).real / 2)


def with_leak(light: Light, extinction: float) -> Light:
    """Return the transmitted fraction of imperfect polarisers, e + (1 - e) I, of extinction e from 0 to 1."""
    if not 0.0 <= extinction <= 1.0:
        raise RangeError(f"extinction {extinction} lies outside 0 to 1; film polarisers have 0.0001 to 0.01")
    return extinction + (1 - extinction) * light


def _amplitude(polariser_rad: float, before: Jones, behind: Jones, light_field: bool) -> ndarray:
    direction = np.array([np.cos(polariser_rad), np.sin(polariser_rad)])
    analyser = direction if light_field else np.array([-direction[1], direction[0]])
    return np.asarray(np.einsum("b,kbc,jcd,kde,e->kj", analyser, behind, UNITS, before, direction))
