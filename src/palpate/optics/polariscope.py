"""Polariscopes: transmission through polariser, sample, and analyser, with or without quarter-wave plates.

The amplitude behind the analyser is linear in the sample's quaternion, c0 q0 + c1 q1 + c2 q2 + c3 q3, with
four complex numbers per polariscope; the light is its squared modulus.

Refraction at the round rim of a disc seen edge-on by a telecentric camera.

The camera looks along -y. At the rim a ray has the angles asin(x/R) outside and asin(x/(nR)) inside, and
turns by their difference. Inside it passes the axis at b = x/n: a cylindrical lens of magnification n that
shows |b| < R/n. The lamp is assumed wide enough for twice the turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Bool, Complex, Float, InputError, RangeError, ndarray
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


Columns = Float[ndarray, " w"]


@dataclass(frozen=True, slots=True)
class ColumnRays:
    """Ray of each image column inside the membrane; 0 and not visible where it misses.

    Attributes:
        impact_m: b, signed distance from the disc's axis, positive to the right of the light's path [m].
        turn_rad: phi; light runs along (sin phi, cos phi) in (x, y).
        half_chord_m: Half the path inside [m].
        transmission: Both walls, averaged over polarisations.
    """

    impact_m: Columns
    turn_rad: Columns
    half_chord_m: Columns
    transmission: Columns
    visible: Bool[ndarray, " w"]

    def about(self, x0_m: float, y0_m: float) -> tuple[Columns, Columns, Columns]:
        """Signed offset from an upright axis at (x0, y0), along (cos phi, -sin phi), and entry and exit from
        the nearest point [m].
        """
        if not np.isfinite(x0_m + y0_m):
            raise InputError(f"the axis at ({x0_m}, {y0_m}) m must be finite numbers")
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        offset = self.impact_m - (x0_m * c - y0_m * s)
        along = x0_m * s + y0_m * c
        return offset, -self.half_chord_m - along, self.half_chord_m - along


def round_rim(x_m: Columns, radius_m: float, index: float) -> ColumnRays:
    """Return rays through the bare round rim of a disc in air.

    Args:
        x_m: Columns from the disc's axis [m].
        radius_m: R [m].
        index: Relative refractive index, at least 1, which disables refraction.
    """
    _check(x_m, radius_m, index)
    visible = abs(x_m) < radius_m
    x = np.where(visible, x_m, 0.0)
    outside, inside = np.arcsin(x / radius_m), np.arcsin(x / (index * radius_m))
    return ColumnRays(
        impact_m=x / index,
        turn_rad=outside - inside,
        half_chord_m=np.where(visible, radius_m * np.cos(inside), 0.0),
        transmission=np.where(visible, _two_walls(outside, inside, index), 0.0),
        visible=visible,
    )


def fresnel(outside_rad: Columns, inside_rad: Columns, index: float) -> tuple[Columns, Columns]:
    """Return the transmission of one wall for s and p polarisation, at angles outside and inside [rad].

    Reference: M. Born and E. Wolf, Principles of Optics, sec. 1.5.2, doi:10.1017/CBO9781139644181.
    """
    o, i = np.cos(outside_rad), np.cos(inside_rad)
    upright = ((o - index * i) / (o + index * i)) ** 2
    level = ((index * o - i) / (index * o + i)) ** 2
    return np.asarray(1 - upright), np.asarray(1 - level)


def _two_walls(outside_rad: Columns, inside_rad: Columns, index: float) -> Columns:
    upright, level = fresnel(outside_rad, inside_rad, index)
    return (upright**2 + level**2) / 2


def _check(x_m: Columns, length_m: float, index: float) -> None:
    if not (length_m > 0 and np.isfinite(length_m)):
        raise RangeError(f"the skin's size {length_m} m must be a positive number of metres")
    if not (index >= 1 and np.isfinite(index)):
        raise RangeError(f"refractive index {index} is below 1; silicones in air have 1.40 to 1.43")
    if not np.isfinite(x_m).all():
        raise RangeError("every column needs a finite x in metres; look for NaN")
