"""Rotational symmetry of a sensor: each training image and its labels stand for several.

If markers repeat n times around the axis, rotation by 360/n degrees maps touches to touches. In-plane
components rotate with the image; axial ones stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.core import Float, InputError, Tensor, Values, split_column

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
