"""Preparation of a camera's image for an estimator: rectify, crop, scale, colour.

Rectification of frames: what a pinhole without distortion would have seen, by maps made once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy import ndarray

from palpate.core import Float32, Image, ImageError, InputError, Lens, Shaped, UInt8

OUTSIDE_PX = -8.0  # a place outside every image: its pixel becomes black


def exact_maps(
    lens: Lens, onto: Lens | None = None
) -> tuple[Float32[ndarray, "h w"], Float32[ndarray, "h w"]]:
    """Where in the lens's image each pixel of a rectified one lies: x and y [px].

    Args:
        onto: what is seen instead; None is the lens's `flat`.

    Returns:
        Maps for `cv2.remap`; outside the image where the lens has no answer.
    """
    onto = onto or lens.flat()
    height, width = onto.size_px
    column, row = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    places = lens.project(onto.rays(np.stack([column, row], axis=-1)))
    places = np.where(np.isfinite(places), places, OUTSIDE_PX).astype(np.float32)
    return np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])


@lru_cache(maxsize=8)
def fixed_maps(
    lens: Lens, onto: Lens | None = None
) -> tuple[Shaped[ndarray, "h w 2"], Shaped[ndarray, "h w"]]:
    """The same maps in fixed point, made once for a lens: 1/32 px, which `cv2.remap` reads fastest.

    Returns:
        Maps of CV_16SC2 and CV_16UC1; not to be written to.
    """
    whole, part = cv2.convertMaps(*exact_maps(lens, onto), cv2.CV_16SC2)
    for array in (whole, part):
        array.flags.writeable = False
    return whole, part


def rectified(image: Image, lens: Lens, onto: Lens | None = None) -> Image:
    """The image with straight lines straight; black where the lens saw nothing or has no answer.

    Args:
        image: grey or RGB, of the lens's own size.
        onto: what is seen instead; None is the lens's `flat`, of the same size and scale in the middle.
    """
    lens.check_size(image.shape[:2])
    flat = cv2.remap(
        image, *fixed_maps(lens, onto), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0
    )
    return flat.reshape(*flat.shape[:2], *image.shape[2:])


Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Preparation:
    """Preparation of a frame as an estimator's input.

    Attributes:
        crop_px: Crop (x, y, width, height); None for the whole frame [px].
        size_px: Input (height, width) [px].
        channels: 1 for gray, 3 for RGB.
        beside_px: Second crop, placed to the right of the first, each at half the input's width.
        lens: Lens of the camera; frames are first rectified onto its `flat`, where the crops count.
    """

    crop_px: Box | None
    size_px: tuple[int, int]
    channels: Literal[1, 3]
    beside_px: Box | None = None
    lens: Lens | None = None

    def __post_init__(self) -> None:
        if min(self.size_px) < 1 or max(self.size_px) > 4096:
            raise InputError(
                f"size {self.size_px}: give height and width of 1 px or more, 4096 px at most",
                code="preparation-size",
            )
        if self.channels not in (1, 3):
            raise InputError(f"channels is {self.channels}; it is 1 (grey) or 3 (RGB)")
        for crop in (self.crop_px, self.beside_px):
            if crop is not None and (min(crop[:2]) < 0 or min(crop[2:]) < 1):
                raise InputError(
                    f"crop {crop}: give x and y of 0 px or more, width and height of 1 px or more",
                    code="preparation-crop",
                )
        if self.beside_px is not None and (self.crop_px is None or self.size_px[1] % 2):
            raise InputError(
                f"a second crop {self.beside_px} needs a first one, {self.crop_px}, and an even width, "
                f"{self.size_px[1]} px"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """(channels, height, width) of the input."""
        return (self.channels, *self.size_px)

    def apply(self, image: Image) -> UInt8[np.ndarray, "height width channels"]:
        """Rectify, crop, turn to grey or RGB, and scale one image.

        Grey is ITU-R BT.601 luma. Shrinking averages areas, so that no marker falls between samples.
        """
        if self.lens is not None:
            image = rectified(image, self.lens)
        height, width = self.size_px
        if self.beside_px is None:
            return self._scaled(image, self.crop_px, height, width)
        halves = [self._scaled(image, crop, height, width // 2) for crop in (self.crop_px, self.beside_px)]
        return np.ascontiguousarray(np.concatenate(halves, axis=1))

    def _scaled(self, image: Image, crop: Box | None, height: int, width: int) -> np.ndarray:
        image = self._in_channels(self._cropped(image, crop))
        if image.shape[:2] != (height, width):
            shrinks = height <= image.shape[0] and width <= image.shape[1]
            image = cv2.resize(
                image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
            )
        return np.ascontiguousarray(image.reshape(height, width, self.channels))

    def _cropped(self, image: Image, crop: Box | None) -> np.ndarray:
        if crop is None:
            return image
        x, y, width, height = crop
        rows, columns = image.shape[:2]
        if x + width > columns or y + height > rows:
            raise ImageError(
                f"crop x={x} y={y} {width}x{height} px does not lie inside the image of {columns}x{rows} px; "
                "give a crop that does",
                code="crop-outside",
            )
        return image[y : y + height, x : x + width]

    def _in_channels(self, image: Image) -> np.ndarray:
        colour = image.ndim == 3 and image.shape[2] == 3
        if self.channels == 1 and colour:
            return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
        if self.channels == 3 and not colour:
            return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_GRAY2RGB)
        return image
