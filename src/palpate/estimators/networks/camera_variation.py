"""Camera variation drawn into a network's training images, whose labels stay.

Each change leaves a part of the images as they are. Noise in the inputs penalizes the slope along it: C. M.
Bishop, Neural Comput. 7, 108 (1995), doi:10.1162/neco.1995.7.1.108.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import cv2
import numpy as np

from palpate.core import Float32, InputError, Tensor

# ratio of the images with each change; half as many are compressed, which takes longest
SHARE = 0.5

Rng = np.random.Generator
Planes = Float32[np.ndarray, "h w c"]


@dataclass(frozen=True, slots=True)
class CameraVariation:
    """Greatest size of each change, drawn uniformly with either sign.

    Attributes:
        shift_px: Shift along each axis [px of the input].
        turn_deg: Rotation about the center [deg].
        blur_px: Sigma of a Gaussian blur [px of the input].
        width_px: Motion of bright outlines along rows and columns, at most 1 [px of the input].
        noise: Sigma [gray levels].
        below_quality_100: JPEG quality below 100.
    """

    shift_px: float = 3.0
    turn_deg: float = 0.75
    zoom_percent: float = 0.75
    blur_px: float = 0.5
    width_px: float = 0.6
    gain_percent: float = 15.0
    noise: float = 2.0
    below_quality_100: float = 40.0

    def __post_init__(self) -> None:
        for field in fields(self):
            if not 0 <= getattr(self, field.name) < 100:
                raise InputError(
                    f"{field.name} is {getattr(self, field.name)}; it is from 0 up to, not including, 100"
                )

    def scaled(self, strength: float) -> CameraVariation:
        """Return all sizes but the shift's multiplied by a factor."""
        return replace(
            self, **{f.name: strength * getattr(self, f.name) for f in fields(self) if f.name != "shift_px"}
        )

    def drawn(self, images: Tensor, rng: Rng) -> Tensor:
        """Return each image ``[c h w]`` with its own changes; differences are not compressed."""
        levels = bool(images.min() >= 0)
        each = (self._changed(image.transpose(1, 2, 0), levels, rng) for image in images)
        return np.stack([image.transpose(2, 0, 1) for image in each])

    def _changed(self, image: Planes, levels: bool, rng: Rng) -> Planes:
        channels = image.shape[2]
        image = self._moved(np.ascontiguousarray(image), rng)
        if levels and self.width_px and rng.random() < SHARE:
            image = with_outlines_moved(image, rng.uniform(-self.width_px, self.width_px), rng)
        if self.blur_px and rng.random() < SHARE:
            sigma = max(rng.uniform(0, self.blur_px), 0.05)
            image = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        image = image.reshape(*image.shape[:2], channels)
        if self.gain_percent and rng.random() < SHARE:
            image = image * np.float32(1 + rng.uniform(-1, 1) * self.gain_percent / 100)
        if self.noise and rng.random() < SHARE:
            image = image + rng.uniform(0, self.noise) * rng.standard_normal(image.shape, np.float32)
        if not levels:
            return image
        image = np.clip(image, 0, 255)
        compresses = self.below_quality_100 and rng.random() < SHARE / 2
        return _compressed(image, 100 - rng.uniform(0, self.below_quality_100)) if compresses else image

    def _moved(self, image: Planes, rng: Rng) -> Planes:
        """Shift, rotation, and zoom in one interpolation, or a shift by whole pixels."""
        height, width, channels = image.shape
        shift = rng.uniform(-self.shift_px, self.shift_px, 2)
        matrix = np.array([[1.0, 0, 0], [0, 1, 0]])
        if (self.turn_deg or self.zoom_percent) and rng.random() < SHARE:
            turn, zoom = rng.uniform(-1, 1, 2) * (self.turn_deg, self.zoom_percent)
            middle = ((width - 1) / 2, (height - 1) / 2)
            matrix = cv2.getRotationMatrix2D(middle, turn, 1 + zoom / 100)
        else:
            shift = np.rint(shift)
        matrix[:, 2] += shift
        if not shift.any() and matrix[0, 0] == 1:
            return image
        moved = cv2.warpAffine(
            image, matrix, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        return moved.reshape(height, width, channels)


NEIGHBOURHOODS = (np.ones((3, 3), np.uint8), np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8))


def with_outlines_moved(image: Planes, px: float, rng: Rng) -> Planes:
    """Return an image whose bright parts extend by `px`, at most 1."""
    neighbourhood = NEIGHBOURHOODS[int(rng.integers(2))]
    reached = (cv2.dilate if px > 0 else cv2.erode)(image, neighbourhood).reshape(image.shape)
    return np.asarray(image + np.float32(abs(px)) * (reached - image))


def _compressed(image: Planes, quality: float) -> Planes:
    grey_levels = np.rint(image).astype(np.uint8)
    _, data = cv2.imencode(".jpg", grey_levels, [cv2.IMWRITE_JPEG_QUALITY, round(quality)])
    kind = cv2.IMREAD_COLOR if image.shape[2] == 3 else cv2.IMREAD_GRAYSCALE
    return np.reshape(np.asarray(cv2.imdecode(data, kind)), image.shape).astype(np.float32)
