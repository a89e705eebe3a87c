"""Balanced linear light to a colour camera's raw codes, and raw codes to an 8-bit picture.

Every pixel has all three channels: no mosaic of colour filters is modelled, nor a matrix from the camera's
colours to sRGB's. Both are what a real camera adds to this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError, RangeError
from palpate.core.shapes import Float, UInt8, UInt16
from palpate.optics.colour import encode_srgb
from palpate.optics.noise import electrons, quantise

LinearImage = Float[ndarray, "h w 3"]


@dataclass(frozen=True, slots=True)
class Camera:
    """What turns light into codes; the numbers are assumed, of the order of industrial cameras.

    Attributes:
        full_well_e: electrons of the greatest code [electrons].
        read_noise_e: standard deviation of the read-out [electrons].
        bits: of the converter, 1 to 16.
        exposure: share of the full well that light 1 fills in the most sensitive channel; above 1 clips.
    """

    full_well_e: float = 15_000.0
    read_noise_e: float = 5.0
    bits: int = 12
    exposure: float = 0.9

    def __post_init__(self) -> None:
        if not (0 < self.full_well_e < np.inf and 0 < self.exposure < np.inf):
            raise RangeError(
                f"full well {self.full_well_e} electrons and exposure {self.exposure} must be positive"
            )
        if not (0 <= self.read_noise_e < np.inf and 1 <= self.bits <= 16):
            raise RangeError(
                f"read noise {self.read_noise_e} electrons must not be negative, {self.bits} bits be 1 to 16"
            )


def raw_codes(
    linear: LinearImage, sensitivity: Float[ndarray, " 3"], camera: Camera, rng: np.random.Generator
) -> UInt16[ndarray, "h w 3"]:
    """One noisy exposure as the converter writes it, unbalanced.

    Args:
        linear: balanced light, 1 at white, not negative.
        sensitivity: of the channels; see `Spectrum`.
        camera: its numbers.
        rng: the only source of chance.

    Raises:
        InputError: light that is negative or not a number.
    """
    if not (np.min(linear, initial=0.0) >= 0 and np.isfinite(linear).all()):
        raise InputError("light must be finite and not negative; look for NaN in the stress or the lamp")
    gain = (camera.full_well_e * camera.exposure * sensitivity).astype(np.float32)
    mean = linear.astype(np.float32) * gain
    return quantise(electrons(mean, camera.read_noise_e, rng), camera.full_well_e, camera.bits)


def develop(
    codes: UInt16[ndarray, "h w 3"], sensitivity: Float[ndarray, " 3"], camera: Camera
) -> UInt8[ndarray, "h w 3"]:
    """Raw codes to 8-bit sRGB: balanced, the exposure divided out, clipped at white."""
    white = (2**camera.bits - 1) * camera.exposure * sensitivity
    return encode_srgb(codes / white)
