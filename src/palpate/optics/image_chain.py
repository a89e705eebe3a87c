"""Lens blur and distortion, applied to light before noise, and JPEG compression; off by default."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from palpate.core import Float32, InputError, RangeError, UInt8, ndarray

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
