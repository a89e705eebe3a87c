"""Spectra to colour: a white LED, a camera's three channels, and sRGB's curve.

The curves are plain Gaussians with named numbers, assumed and not measured: they have the shape of a phosphor
LED and of a colour camera, and belong to no product.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from palpate.core import Float, Float32, InputError, UInt8, ndarray

Banded = Float[ndarray, "k *n"]
Tone = Literal["srgb", "linear"]

SECOND_RADIATION_M_K = 1.438777e-2
"""Planck's c2 = hc/k [m K]."""

MIN_BANDS = 31  # fewer cost more than 0.006 in intensity at four fringe orders


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Spectrum of the light as the camera weighs it, in bands of equal width.

    Attributes:
        wavelength_m: centres of the bands ``[k]`` [m].
        weight: share of each band in each balanced channel ``[k 3]``; each channel sums to 1, so that the
            bare lamp is white.
        sensitivity: what each channel gets of the bare lamp before balancing, over what the most sensitive
            gets ``[3]``; raw codes are as unequal as this.
    """

    wavelength_m: Float[ndarray, " k"]
    weight: Float[ndarray, "k 3"]
    sensitivity: Float[ndarray, " 3"] = field(default_factory=lambda: np.ones(3))


def assumed_camera(
    bands: int = MIN_BANDS,
    led_peaks_nm: tuple[float, float] = (450.0, 560.0),
    led_widths_nm: tuple[float, float] = (10.0, 55.0),
    phosphor_share: float = 0.6,
    camera_peaks_nm: tuple[float, float, float] = (600.0, 540.0, 460.0),
    camera_widths_nm: tuple[float, float, float] = (35.0, 40.0, 30.0),
) -> Spectrum:
    """A phosphor white LED seen by an RGB camera, white-balanced; every number is assumed.

    Args:
        bands: over 400 to 700 nm, at least 31.
        led_peaks_nm: of the blue die and of the phosphor [nm].
        led_widths_nm: their standard deviations [nm].
        phosphor_share: the phosphor's peak over the die's.
        camera_peaks_nm: of red, green and blue [nm].
        camera_widths_nm: their standard deviations [nm].
    """
    if bands < MIN_BANDS:
        raise InputError(f"{bands} bands are too few for interference colours; use {MIN_BANDS} or more")
    edges = np.linspace(400.0, 700.0, bands + 1)
    nm = (edges[1:] + edges[:-1]) / 2
    die, phosphor = (_bell(nm, p, w) for p, w in zip(led_peaks_nm, led_widths_nm, strict=True))
    camera = [_bell(nm, p, w) for p, w in zip(camera_peaks_nm, camera_widths_nm, strict=True)]
    weight = (die + phosphor_share * phosphor)[:, None] * np.stack(camera, axis=1)
    total = weight.sum(axis=0)
    return Spectrum(nm * 1e-9, weight / total, total / total.max())


def spectral_to_linear(light: Banded, spectrum: Spectrum) -> Float[ndarray, "... 3"]:
    """Transmitted fraction in each band to linear RGB, 1 where all light passes."""
    return np.asarray(np.einsum("k...,kc->...c", light, spectrum.weight))


def encode_srgb(linear: Float[ndarray, "*n"]) -> UInt8[ndarray, "*n"]:
    """Linear 0 to 1 to 8-bit sRGB; what lies outside is clipped.

    Reference: IEC 61966-2-1:1999.

    Example:
        >>> encode_srgb(np.array([0.0, 0.5, 1.0])).tolist()
        [0, 188, 255]
    """
    v = np.clip(linear, 0.0, 1.0)
    curve = np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * curve), dtype=np.uint8)


def linear_light(codes: Float[ndarray, "*n"] | UInt8[ndarray, "*n"], tone: Tone) -> Float[ndarray, "*n"]:
    """Linear light, 0 to 1, of 8-bit codes: the inverse of `encode_srgb`; "linear" takes codes as light."""
    v = np.asarray(codes / 255)
    if tone == "linear":
        return v
    return np.asarray(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4))


def _bell(nm: Float[ndarray, " k"], peak: float, width: float) -> Float[ndarray, " k"]:
    return np.asarray(np.exp(-((nm - peak) ** 2) / (2 * width**2)))


def lamp_tint(mired: float, spectrum: Spectrum) -> Float32[ndarray, " 3"]:
    """Each channel's light under a warmer or colder lamp, over that of the lamp the camera is balanced to.

    The lamp's spectrum is multiplied by exp(-c2 m / lambda), which moves a black body of any temperature T to
    1 / (1/T + m), in Wien's approximation. Green is kept, as an exposure set anew would.

    Args:
        mired: m, the change of 1e6 K over the colour temperature; positive is warmer.
        spectrum: of lamp and camera.
    """
    filtered = np.exp(-SECOND_RADIATION_M_K * mired * 1e-6 / spectrum.wavelength_m) @ spectrum.weight
    return np.asarray(filtered / filtered[1], dtype=np.float32)
