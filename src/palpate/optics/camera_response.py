"""A colour camera's response: uneven light, photons that come one by one, read-out, raw codes, 8-bit picture.

Every pixel has all three channels: no mosaic of colour filters is modelled, nor a matrix from the camera's
colours to sRGB's. Both are what a real camera adds to this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Float, Float32, InputError, RangeError, UInt8, UInt16, ndarray
from palpate.optics.colour import encode_srgb

LinearImage = Float[ndarray, "h w 3"]


@dataclass(frozen=True, slots=True)
class CameraResponse:
    """Numbers by which light becomes codes; they are assumed, of the order of industrial cameras.

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


@dataclass(frozen=True, slots=True)
class AutoExposure:
    """A camera that chooses each frame's exposure so that its mean light comes near a target, in whole steps.

    Attributes:
        target: mean light over the frame and its channels that it aims at, 1 being white.
        steps_per_stop: of the exposure, in a factor of 2; 3 are thirds of a stop.
        max_stops: by which it changes the exposure at most, either way.
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
        """Factor by which the next frame of this light is exposed longer, a whole number of steps."""
        mean = float(np.mean(linear))
        stops = np.log2(self.target / mean) if mean > 0 else self.max_stops
        stops = np.clip(stops, -self.max_stops, self.max_stops)
        return float(2.0 ** (np.rint(stops * self.steps_per_stop) / self.steps_per_stop))


def raw_codes(
    linear: LinearImage, sensitivity: Float[ndarray, " 3"], camera: CameraResponse, rng: np.random.Generator
) -> UInt16[ndarray, "h w 3"]:
    """One noisy exposure as the converter writes it, unbalanced.

    Args:
        linear: balanced light, 1 at white, not negative.
        sensitivity: of the channels; see `Spectrum`.
        camera: its numbers.
        rng: the only source of chance.
    """
    if not (np.min(linear, initial=0.0) >= 0 and np.isfinite(linear).all()):
        raise InputError("light must be finite and not negative; look for NaN in the stress or the lamp")
    gain = (camera.full_well_e * camera.exposure * sensitivity).astype(np.float32)
    mean = linear.astype(np.float32) * gain
    return quantise(electrons(mean, camera.read_noise_e, rng), camera.full_well_e, camera.bits)


def develop(
    codes: UInt16[ndarray, "h w 3"], sensitivity: Float[ndarray, " 3"], camera: CameraResponse
) -> UInt8[ndarray, "h w 3"]:
    """Raw codes to 8-bit sRGB: balanced, the exposure divided out, clipped at white."""
    white = (2**camera.bits - 1) * camera.exposure * sensitivity
    return encode_srgb(codes / white)


Electrons = Float[ndarray, "*n"]


def uneven_light(
    height: int, width: int, corner_loss: float, centre: tuple[float, float] = (0.5, 0.5)
) -> Float32[ndarray, "h w"]:
    """Light over the image, fixed to the camera: 1 at the centre, falling with the square of the distance.

    Args:
        height, width: of the image [px].
        corner_loss: share of the light lost at half the image's diagonal from the centre, 0 to 1.
        centre: of the light, in shares of the height and of the width.
    """
    if not 0.0 <= corner_loss <= 1.0:
        raise RangeError(f"corner loss {corner_loss} lies outside 0 to 1")
    rows = np.arange(height) + 0.5 - centre[0] * height
    columns = np.arange(width) + 0.5 - centre[1] * width
    share = (rows[:, None] ** 2 + columns**2) / ((height**2 + width**2) / 4)
    return np.maximum(1 - corner_loss * share, 0).astype(np.float32)


def electrons(mean: Electrons, read_noise_e: float, rng: np.random.Generator) -> Float32[ndarray, "*n"]:
    """One exposure: shot and read noise together as one Gaussian of variance mean + read^2.

    The first two moments are exact. The third, which a Gaussian lacks, is mean / (mean + read^2)^1.5 standard
    deviations cubed: below 0.15 from 45 electrons on.

    Args:
        mean: expected electrons, not negative.
        read_noise_e: standard deviation of the read-out [electrons].
        rng: the only source of chance.
    """
    spread = np.sqrt(mean + np.float32(read_noise_e**2), dtype=np.float32)
    spread *= rng.standard_normal(mean.shape, dtype=np.float32)
    spread += mean
    return spread


def quantise(counts: Electrons, full_well_e: float, bits: int) -> UInt16[ndarray, "*n"]:
    """The converter's codes: 0 at no electrons, 2^bits - 1 at the full well, clipped at both ends."""
    top = 2**bits - 1
    return np.clip(np.rint(counts * np.float32(top / full_well_e)), 0, top).astype(np.uint16)
