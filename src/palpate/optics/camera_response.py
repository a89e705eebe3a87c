"""Response of a color camera: vignetting, shot and read noise, raw codes, and 8-bit images; without color
mosaic and matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Float, Float32, InputError, RangeError, UInt8, UInt16, ndarray
from palpate.optics.colour import encode_srgb

LinearImage = Float[ndarray, "h w 3"]


@dataclass(frozen=True, slots=True)
class CameraResponse:
    """Camera parameters, assumed and typical of industrial cameras.

    Attributes:
        full_well_e: Electrons of the maximum code.
        read_noise_e: Standard deviation of the read noise [electrons].
        bits: 1 to 16.
        exposure: Fraction of the full well filled by light 1 in the most sensitive channel.
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


@dataclass(frozen=True, slots=True)
class AutoExposure:
    """Automatic exposure towards a mean light, in whole steps.

    Attributes:
        target: Mean light, 1 being white.
        steps_per_stop: Steps in a factor of 2.
        max_stops: Maximum change, either way.
    """

    target: float
    steps_per_stop: int = 3
    max_stops: float = 2.0

    def __post_init__(self) -> None:
        if not (0 < self.target <= 1 and self.steps_per_stop >= 1 and 0 <= self.max_stops <= 10):
            raise RangeError(
                f"an automatic exposure at a mean of {self.target} in {self.steps_per_stop} steps a stop, to "
                f"{self.max_stops} stops; give a mean above 0, to 1, 1 step or more, and 0 to 10 stops",
                code="exposure-range",
            )

    def gain(self, linear: LinearImage) -> float:
        """Exposure factor for this light, a whole number of steps."""
        mean = float(np.mean(linear))
        stops = np.log2(self.target / mean) if mean > 0 else self.max_stops
        stops = np.clip(stops, -self.max_stops, self.max_stops)
        return float(2.0 ** (np.rint(stops * self.steps_per_stop) / self.steps_per_stop))


def raw_codes(
    linear: LinearImage, sensitivity: Float[ndarray, " 3"], camera: CameraResponse, rng: np.random.Generator
) -> UInt16[ndarray, "h w 3"]:
    """Return one noisy exposure as raw codes, without white balance.

    Args:
        linear: Balanced light, 1 at white, not negative.
        sensitivity: Sensitivity of the channels; see `Spectrum`.
        camera: Camera parameters.
        rng: Source of noise.
    """
    if not (np.min(linear, initial=0.0) >= 0 and np.isfinite(linear).all()):
        raise InputError("light must be finite and not negative; look for NaN in the stress or the lamp")
    gain = (camera.full_well_e * camera.exposure * sensitivity).astype(np.float32)
    mean = linear.astype(np.float32) * gain
    return quantise(electrons(mean, camera.read_noise_e, rng), camera.full_well_e, camera.bits)


def develop(
    codes: UInt16[ndarray, "h w 3"], sensitivity: Float[ndarray, " 3"], camera: CameraResponse
) -> UInt8[ndarray, "h w 3"]:
    """Convert raw codes to 8-bit sRGB: balanced, exposure divided out, clipped at white."""
    white = (2**camera.bits - 1) * camera.exposure * sensitivity
    return encode_srgb(codes / white)


Electrons = Float[ndarray, "*n"]


def uneven_light(
    height: int, width: int, corner_loss: float, centre: tuple[float, float] = (0.5, 0.5)
) -> Float32[ndarray, "h w"]:
    """Return vignetting: 1 at the centre, falling with the square of the distance.

    Args:
        height, width: Image size [px].
        corner_loss: Fraction lost at half the image's diagonal, 0 to 1.
        centre: Centre in fractions of height and width.
    """
    if not 0.0 <= corner_loss <= 1.0:
        raise RangeError(f"corner loss {corner_loss} lies outside 0 to 1")
    rows = np.arange(height) + 0.5 - centre[0] * height
    columns = np.arange(width) + 0.5 - centre[1] * width
    share = (rows[:, None] ** 2 + columns**2) / ((height**2 + width**2) / 4)
    return np.maximum(1 - corner_loss * share, 0).astype(np.float32)


def electrons(mean: Electrons, read_noise_e: float, rng: np.random.Generator) -> Float32[ndarray, "*n"]:
    """Return one exposure of expected electrons: Gaussian noise of variance mean + read^2."""
    spread = np.sqrt(mean + np.float32(read_noise_e**2), dtype=np.float32)
    spread *= rng.standard_normal(mean.shape, dtype=np.float32)
    spread += mean
    return spread


def quantise(counts: Electrons, full_well_e: float, bits: int) -> UInt16[ndarray, "*n"]:
    """Return the converter's codes: 0 at no electrons, 2^bits - 1 at the full well, clipped."""
    top = 2**bits - 1
    return np.clip(np.rint(counts * np.float32(top / full_well_e)), 0, top).astype(np.uint16)
