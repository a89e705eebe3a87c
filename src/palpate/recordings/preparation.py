"""Preparation of a camera's image for an estimator: rectify, crop, scale, colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from palpate.core import Image, ImageError, InputError, Lens, UInt8
from palpate.recordings.rectification import rectified

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
