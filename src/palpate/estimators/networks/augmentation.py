"""Rotational symmetry of a sensor: each training image and its labels stand for several.

If markers repeat n times around the axis, rotation by 360/n degrees maps touches to touches. In-plane
components rotate with the image; axial ones stay.

Camera variation drawn into a network's training images, whose labels stay.

Each change leaves a part of the images as they are. Noise in the inputs penalizes the slope along it: C. M.
Bishop, Neural Comput. 7, 108 (1995), doi:10.1162/neco.1995.7.1.108.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np

from palpate.core import Float, Float32, InputError, Tensor, Values, split_column

# correlation of the mean image with itself rotated below which the symmetry is refused (0.9 if present)
MIN_LIKENESS = 0.8


@dataclass(frozen=True, slots=True)
class RotationalSymmetry:
    """Rotation of images and their values together.

    Attributes:
        order: n, repetitions in a full turn.
        centre: (x, y) of the axis in the input [px].
        pairs: Columns that are x and y components of one vector; x to the right, y down.
        lone: Columns that are one component alone, which change sign at a half turn.
    """

    order: int
    centre: tuple[float, float]
    pairs: tuple[tuple[int, int], ...]
    lone: tuple[int, ...] = ()

    @classmethod
    def find(cls, order: int, images: Tensor, names: tuple[str, ...]) -> RotationalSymmetry:
        """Find the axis from sample images, and the rotating columns from the target names."""
        pairs, lone = in_plane(names)
        if lone and order != 2:
            raise InputError(
                f"{', '.join(names[i] for i in lone)} has no other component to rotate with; name both, as "
                "in shear_x_mm,shear_y_mm"
            )
        return cls(order, axis_of(images.mean(axis=(0, 1)), order), pairs, lone)

    def matrix(self, count: int) -> Float[np.ndarray, "2 3"]:
        """Return the affine map of an image rotated clockwise (x towards y) by `count` steps."""
        return np.asarray(cv2.getRotationMatrix2D(self.centre, -360.0 * count / self.order, 1.0))

    def turned(self, images: Tensor, values: Values, rng: np.random.Generator) -> tuple[Tensor, Values]:
        """Return images and values rotated by random numbers of steps."""
        counts = rng.integers(0, self.order, len(images))
        each = zip(images, counts, strict=True)
        rotated = np.stack([_warped(image, self.matrix(int(n))) if n else image for image, n in each])
        return rotated, self.turned_values(values, counts)

    def turned_values(self, values: Values, counts: np.ndarray) -> Values:
        """Return values of touches rotated clockwise by these numbers of steps."""
        rotated = values.copy()
        cos, sin = (f(2 * math.pi * counts / self.order) for f in (np.cos, np.sin))
        for i, j in self.pairs:
            rotated[:, i] = cos * values[:, i] - sin * values[:, j]
            rotated[:, j] = sin * values[:, i] + cos * values[:, j]
        rotated[:, list(self.lone)] *= np.rint(cos)[:, None]
        return rotated


def in_plane(names: tuple[str, ...]) -> tuple[tuple[tuple[int, int], ...], tuple[int, ...]]:
    """Return the columns that are in-plane vectors, by name, and those that are half of one.

    Example:
        >>> in_plane(("depth_mm", "shear_x_mm", "shear_y_mm", "tilt_x_deg"))
        (((1, 2),), (3,))
    """
    words = [tuple(split_column(name)[0].split("_")) for name in names]
    x = {i: tuple("y" if w == "x" else w for w in ws) for i, ws in enumerate(words) if "x" in ws}
    pairs = tuple((i, words.index(other)) for i, other in x.items() if other in words)
    paired = {i for pair in pairs for i in pair}
    lone = tuple(i for i, ws in enumerate(words) if {"x", "y"} & set(ws) and i not in paired)
    return pairs, lone


def axis_of(mean: Float[np.ndarray, "h w"], order: int) -> tuple[float, float]:
    """Return the axis in the mean image (x, y) [px], from the offset R e - e of its rotated copy."""
    if order < 2:
        raise InputError(f"a sensor repeats 2 or more times in a full turn; turns={order}", code="turn-count")
    height, width = mean.shape
    middle = ((width - 1) / 2, (height - 1) / 2)
    angle = 2 * math.pi / order
    rotated = _warped(mean[None].astype(np.float32), RotationalSymmetry(order, middle, ()).matrix(1))[0]
    away = _displacement(mean, rotated)
    R = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    ex, ey = np.linalg.solve(R - np.eye(2), away)
    axis = (middle[0] + float(ex), middle[1] + float(ey))
    likeness = _likeness(mean, RotationalSymmetry(order, axis, ()))
    if not likeness >= MIN_LIKENESS:
        raise InputError(
            f"the mean image correlates at {likeness:.2f} with itself rotated by {360 / order:g} deg; "
            f"{MIN_LIKENESS} is needed",
            code="not-symmetric",
        )
    return axis


def _displacement(a: Float[np.ndarray, "h w"], b: Float[np.ndarray, "h w"]) -> Float[np.ndarray, " 2"]:
    """Displacement (x, y) of the second image from the first, by correlation, to a pixel."""
    height, width = a.shape
    spectrum = np.conj(np.fft.rfft2(a - a.mean())) * np.fft.rfft2(b - b.mean())
    y, x = np.unravel_index(int(np.argmax(np.fft.irfft2(spectrum, (height, width)))), (height, width))
    x, y = (x + width // 2) % width - width // 2, (y + height // 2) % height - height // 2
    return np.array([x, y], dtype=float)


def _likeness(mean: Float[np.ndarray, "h w"], turns: RotationalSymmetry) -> float:
    """Correlation of the image with itself rotated, inside the largest circle about the axis."""
    height, width = mean.shape
    (cx, cy), (y, x) = turns.centre, np.mgrid[:height, :width]
    reach = 0.95 * min(cx, cy, width - 1 - cx, height - 1 - cy)
    inside = (x - cx) ** 2 + (y - cy) ** 2 < max(reach, 0.0) ** 2
    if inside.sum() < 9 or not mean[inside].std():
        return 0.0
    other = _warped(mean[None].astype(np.float32), turns.matrix(1))[0]
    return float(np.corrcoef(mean[inside], other[inside])[0, 1])


def _warped(image: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    height, width = image.shape[1:]
    return np.stack(
        [cv2.warpAffine(c, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE) for c in image]
    )


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
