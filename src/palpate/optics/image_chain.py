"""Lens blur and distortion, applied to light before noise, and JPEG compression; off by default.

Response of a color camera: vignetting, shot and read noise, raw codes, and 8-bit images; without color
mosaic and matrix.

Lamp behind the membrane: a strip of LEDs with a diffuser, and the lens's vignetting.

Normal noise by a table of quantiles, four times as fast as normal draws.

Each draw is 16 random bits that select one of 65,536 normal quantiles, scaled to variance 1. Values beyond
4.325 standard deviations are missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache

import cv2
import numpy as np
from scipy.special import ndtri

from palpate.core import Float, Float32, InputError, RangeError, UInt8, UInt16, ndarray
from palpate.optics.colour import encode_srgb

MAX_BLUR_PX = 20.0
MAX_DISTORTION = 0.3

Light = Float32[ndarray, "h w 3"]
Map = Float32[ndarray, "h w"]


@dataclass(frozen=True, slots=True)
class ImageChain:
    """Lens and compression.

    Attributes:
        blur_px: Standard deviation of the Gaussian point spread [px].
        distortion: Relative radial displacement at the frame's corner; negative for barrel distortion.
        jpeg_quality: 1 to 100, with 4:2:0 color; None for no compression.
    """

    blur_px: float = 0.0
    distortion: float = 0.0
    jpeg_quality: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.blur_px <= MAX_BLUR_PX:
            raise RangeError(f"a blur of {self.blur_px} px; 0 to {MAX_BLUR_PX:g} px")
        if not abs(self.distortion) <= MAX_DISTORTION:
            raise RangeError(
                f"a distortion of {self.distortion} at the corner; within {MAX_DISTORTION:g}, as a share"
            )
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise RangeError(f"a JPEG of quality {self.jpeg_quality}; 1 to 100, or None")


def through_lens(light: Light, chain: ImageChain) -> Light:
    """Return the whole frame's light behind the lens."""
    if chain.distortion:
        across, down = _seen_from(light.shape[1], light.shape[0], chain.distortion)
        light = np.asarray(
            cv2.remap(light, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
        )
    if chain.blur_px:
        light = np.asarray(cv2.GaussianBlur(light, (0, 0), chain.blur_px), np.float32)
    return light


@lru_cache(maxsize=8)
def _seen_from(width: int, height: int, distortion: float) -> tuple[Map, Map]:
    """Positions (x, y) of the undistorted image that each pixel shows [px]."""
    middle = (width - 1) / 2, (height - 1) / 2
    half = math.hypot(*middle)
    x, y = np.meshgrid(np.arange(width) - middle[0], np.arange(height) - middle[1])
    seen = np.hypot(x, y) / half
    r = seen.copy()
    for _ in range(20):
        r -= (r * (1 + distortion * r**2) - seen) / (1 + 3 * distortion * r**2)
    share = np.divide(r, seen, out=np.ones_like(r), where=seen > 0)
    return tuple((axis * share + at).astype(np.float32) for axis, at in zip((x, y), middle, strict=True))


def as_kept(image: UInt8[ndarray, "h w 3"], chain: ImageChain) -> UInt8[ndarray, "h w 3"]:
    """Return the image after compression."""
    if chain.jpeg_quality is None:
        return image
    done, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, chain.jpeg_quality])
    if not done:
        raise InputError(f"a picture of {image.shape} could not be coded as a JPEG")
    again = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert again is not None
    return np.ascontiguousarray(again[..., ::-1], np.uint8)


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


Places = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True)
class LedStrip:
    """Equal LEDs in a row along x behind a diffuser; values are assumed.

    Attributes:
        pitch_m, count: Spacing [m] and number of LEDs, centred on x = 0.
        height_m: z of the row [m].
        distance_m: Distance from the diffuser [m].
        evened: Fraction of light the diffuser spreads evenly, 0 to 1.
        slope_per_m: Relative change of light along x [1/m].
    """

    pitch_m: float = 8e-3
    count: int = 9
    height_m: float = 5e-3
    distance_m: float = 12e-3
    evened: float = 0.7
    slope_per_m: float = 0.0

    def __post_init__(self) -> None:
        if not (self.pitch_m > 0 and self.distance_m > 0 and self.count >= 1):
            raise RangeError(
                f"{self.count} LEDs at {self.pitch_m} m, {self.distance_m} m behind the diffuser: give 1 or "
                "more LEDs and positive lengths in m"
            )
        if not 0.0 <= self.evened <= 1.0:
            raise RangeError(f"evened share {self.evened} lies outside 0 to 1")
        if not (np.isfinite(self.height_m) and np.all(self.gain > 0)):
            raise RangeError(
                f"slope {self.slope_per_m} 1/m leaves some LED of the strip without light, or the height "
                f"{self.height_m} m is not a number; give a smaller slope"
            )

    @property
    def places_m(self) -> Places:
        """Positions of the LEDs along x [m]."""
        return (np.arange(self.count) - (self.count - 1) / 2) * self.pitch_m

    @property
    def gain(self) -> Places:
        """Light of each LED; 1 in the middle."""
        return 1 + self.slope_per_m * self.places_m


def strip_light(
    strip: LedStrip, x_m: Float[ndarray, " w"], z_m: Float[ndarray, " h"]
) -> Float[ndarray, "h w"]:
    """Return the light on the diffuser at columns and rows [m], 1 at its maximum; each LED is Lambertian."""
    rho2 = (x_m[:, None] - strip.places_m) ** 2 + (z_m[:, None, None] - strip.height_m) ** 2
    direct = (1 + rho2 / strip.distance_m**2) ** -2 @ strip.gain
    light = (1 - strip.evened) * direct + strip.evened * direct.mean()
    return np.asarray(light / light.max())


def backlight(
    strip: LedStrip, x_m: Float[ndarray, " w"], z_m: Float[ndarray, " h"], corner_loss: float = 0.0
) -> Float32[ndarray, "h w"]:
    """Return the lamp as the camera sees it, with vignetting; see `uneven_light`."""
    lens = uneven_light(len(z_m), len(x_m), corner_loss)
    return (strip_light(strip, x_m, z_m) * lens).astype(np.float32)


VALUES = 2**16
DRAWS_A_WORD = 4


@cache
def normal_table() -> Float32[ndarray, " 65536"]:
    """Return the values of a draw: ascending, symmetric, of variance 1."""
    middle = ndtri((np.arange(VALUES) + 0.5) / VALUES)
    table = (middle / np.sqrt(np.mean(middle**2))).astype(np.float32)
    table.flags.writeable = False
    return table


def table_draws(rng: np.random.Generator, count: int) -> UInt16[ndarray, " count"]:
    """Return uniform indices into `normal_table`."""
    words = rng.integers(0, 2**64 - 1, -(-count // DRAWS_A_WORD), dtype=np.uint64, endpoint=True)
    return words.view(np.uint16)[:count]
