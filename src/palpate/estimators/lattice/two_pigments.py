"""Color frames as one number for each pixel: the position on the line between two pigments.

The line follows differences between neighboring pixels, so that slow changes of light do not rotate it;
channels are weighted by contrast over noise (Fisher's discriminant).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from palpate.core import Float, ImageError, Shaped, UInt8, ndarray
from palpate.estimators.brightest_channel import brightest_channel

Axis = UInt8[ndarray, "h w"]

LOW, HIGH = 12.0, 243.0  # where the darkest and brightest thousandth of the axis come to lie
MIN_CONTRAST = 6.0  # grey levels between the pigments, and times the noise
DARK, BRIGHT = 16, 250
MAX_CLIPPED = 0.5  # greatest ratio of saturated pixels
LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)  # its output has 6 times the noise
HALF_NORMAL_MEDIAN = 0.6745


@dataclass(frozen=True, eq=False)
class PigmentAxis:
    """Channel weights and offset of the two-pigment axis, the brighter pigment high."""

    weights: Float[ndarray, "1 c1"]
    size: tuple[int, int]

    def of(self, frame: Shaped[ndarray, ...]) -> Axis:
        channels = self.weights.shape[1] - 1
        if frame.dtype != np.uint8 or frame.shape[:2] != self.size or channels_of(frame) != channels:
            raise ImageError(
                f"a frame {frame.dtype} {list(frame.shape)}; give 8-bit frames of {list(self.size)} px, "
                f"{channels} channels"
            )
        return cv2.transform(frame, self.weights).reshape(self.size)


def channels_of(frame: Shaped[ndarray, ...]) -> int:
    """Return the number of a frame's channels, 1 for gray."""
    return 1 if frame.ndim == 2 else frame.shape[-1]


def find_axis(frame: Shaped[ndarray, ...], pitch_px: float) -> PigmentAxis:
    """Return the line between the pigments of an 8-bit frame with tiles of about this size."""
    if frame.dtype != np.uint8 or frame.ndim not in (2, 3) or channels_of(frame) not in (1, 3):
        raise ImageError(
            f"a pattern is found in 8-bit grey or RGB frames, got {frame.dtype} {list(frame.shape)}"
        )
    if min(frame.shape[:2]) < 4 * pitch_px:
        raise ImageError(
            f"a frame of {frame.shape[1]} x {frame.shape[0]} px is too small for tiles of {pitch_px:.0f} px"
        )
    _refuse_ends(frame)
    planes = np.float32(frame).reshape(*frame.shape[:2], -1)
    wide = int(2 * pitch_px) | 1
    local = planes - cv2.blur(planes, (wide, wide)).reshape(planes.shape)
    flat = local[::2, ::2].reshape(-1, planes.shape[2])
    noise = np.array([noise_of(planes[..., k]) for k in range(planes.shape[2])]) + 0.3
    _, along = np.linalg.eigh(np.cov((flat / noise).T).reshape(len(noise), -1))
    weights = along[:, -1] / noise
    weights *= np.sign(weights.sum()) / np.abs(weights).sum()
    return PigmentAxis(_stretched(planes @ weights, weights), frame.shape[:2])


def _refuse_ends(frame: Shaped[ndarray, ...]) -> None:
    grey = brightest_channel(frame)
    if np.percentile(grey, 99) < DARK:
        raise ImageError(f"the frame is dark: 99 % of it lies below {DARK} of 255; look at the light")
    if (grey > BRIGHT).mean() > MAX_CLIPPED:
        raise ImageError(
            f"{100 * (grey > BRIGHT).mean():.0f} % of the frame is saturated; lower light or exposure"
        )


def _stretched(axis: Float[ndarray, "h w"], weights: Float[ndarray, " c"]) -> Float[ndarray, "1 c1"]:
    """Weights that stretch the axis over an 8-bit range."""
    low, high = np.percentile(axis[::2, ::2], [0.1, 99.9])
    if high - low < MIN_CONTRAST:
        raise ImageError(
            f"the frame's colours differ by {high - low:.1f} grey levels; {MIN_CONTRAST:.0f} are needed"
        )
    scale = (HIGH - LOW) / (high - low)
    return np.append(scale * weights, LOW - scale * low)[None].astype(np.float64)


def noise_of(plane: Shaped[ndarray, "h w"]) -> float:
    """Return an image's pixel noise (median of Immerkaer's mask, doi:10.1006/cviu.1996.0060)."""
    rough = np.abs(cv2.filter2D(plane, cv2.CV_32F, LAPLACIAN))
    return float(np.median(rough)) / (6 * HALF_NORMAL_MEDIAN)


def noise_near(axis: Axis, smooth_below: Float[ndarray, "h w"], reach_px: int) -> Float[ndarray, "h w"]:
    """Return the local standard deviation of the noise, from pixels that are no edges.

    Args:
        axis: Image.
        smooth_below: Gradient below which a pixel is no edge [levels/px].
        reach_px: Half-side of the window [px].
    """
    blurred = cv2.GaussianBlur(axis, (0, 0), 1.5)
    gx, gy = cv2.spatialGradient(blurred)
    flat = np.float32(np.abs(np.float32(gx)) + np.abs(np.float32(gy)) < 8 * smooth_below)
    flat = cv2.erode(flat, np.ones((3, 3), np.uint8))
    square = cv2.filter2D(axis, cv2.CV_32F, LAPLACIAN) ** 2 * flat
    window = (2 * reach_px + 1,) * 2
    count = cv2.blur(flat, window)
    everywhere = square.sum() / max(float(flat.sum()), 1.0)
    near = np.where(count > 0.02, cv2.blur(square, window) / np.maximum(count, 0.02), everywhere)
    return np.sqrt(near / 36)
