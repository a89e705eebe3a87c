"""Spectra to color: a white LED, three camera channels, and sRGB. The Gaussian spectra are assumed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from palpate.core import Float, Float32, InputError, UInt8, ndarray

Banded = Float[ndarray, "k *n"]
Tone = Literal["srgb", "linear"]

SECOND_RADIATION_M_K = 1.438777e-2
"""c2 = hc/k [m K]."""

MIN_BANDS = 31  # minimum for an intensity error of 0.006 at four fringe orders


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Spectrum of the light as weighted by the camera, in bands of equal width.

    Attributes:
        wavelength_m: Band centres [m].
        weight: Weight of each band in each balanced channel; each channel sums to 1.
        sensitivity: Unbalanced channels over the most sensitive one.
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
    """Return a phosphor white LED seen by a white-balanced RGB camera; all values are assumed.

    Args:
        bands: Number from 400 to 700 nm, at least 31.
        led_peaks_nm, led_widths_nm: Peaks and standard deviations of blue die and phosphor [nm].
        phosphor_share: Phosphor's peak over the die's.
        camera_peaks_nm, camera_widths_nm: Peaks and standard deviations of red, green, and blue [nm].
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
    """Convert the transmitted fraction in each band to linear RGB."""
    return np.asarray(np.einsum("k...,kc->...c", light, spectrum.weight))


def encode_srgb(linear: Float[ndarray, "*n"]) -> UInt8[ndarray, "*n"]:
    """Encode linear 0 to 1 as 8-bit sRGB, clipped (IEC 61966-2-1:1999).

    Example:
        >>> encode_srgb(np.array([0.0, 0.5, 1.0])).tolist()
        [0, 188, 255]
    """
    v = np.clip(linear, 0.0, 1.0)
    curve = np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * curve), dtype=np.uint8)


def linear_light(codes: Float[ndarray, "*n"] | UInt8[ndarray, "*n"], tone: Tone) -> Float[ndarray, "*n"]:
    """Return linear light, 0 to 1, of 8-bit codes: the inverse of `encode_srgb`, or codes as light for
    "linear".
    """
    v = np.asarray(codes / 255)
    if tone == "linear":
        return v
    return np.asarray(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4))


def _bell(nm: Float[ndarray, " k"], peak: float, width: float) -> Float[ndarray, " k"]:
    return np.asarray(np.exp(-((nm - peak) ** 2) / (2 * width**2)))


def lamp_tint(mired: float, spectrum: Spectrum) -> Float32[ndarray, " 3"]:
    """Return each channel's light under a warmer or colder lamp over the balanced one, with green unchanged.

    The spectrum is multiplied by exp(-c2 m / lambda), which moves a black body from T to 1 / (1/T + m)
    (Wien).

    Args:
        mired: m, the change of 1e6 K over the color temperature; positive is warmer.
        spectrum: Lamp and camera.
    """
    filtered = np.exp(-SECOND_RADIATION_M_K * mired * 1e-6 / spectrum.wavelength_m) @ spectrum.weight
    return np.asarray(filtered / filtered[1], dtype=np.float32)
