"""Quality of a camera's picture from a few frames of a still scene: focus, noise, flicker, exposure, advice.

Focus is the blur of the sharpest edges. Flicker of lamps is brightness that changes between frames, or moving
bands with a rolling shutter; lamps synchronous with the frames are invisible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.special import chdtri

from palpate.core import Float, Float32, ImageError, InputError, RangeError, Shaped, ndarray
from palpate.estimators.fringe_light import brightest_channel

MIN_FRAMES = 4
DARK, BRIGHT = 4, 251  # grey levels from which a pixel is taken to be at the end of the range
MAX_CLIPPED = 0.02  # share of pixels at the bright end
TOO_DARK, TOO_BRIGHT = 40.0, 210.0  # mean of the lit part [grey levels]
LIT = 0.25  # of the brightest hundredth's level: what is darker is no skin
SHARP_PX = 2.0  # blur of the sharpest edges, beyond which a picture is out of focus
MAX_NOISE = 4.0  # grey levels
MAX_FLICKER = 0.01  # of the brightness
STEP_PX = 0.7, 1.4  # blurs that are added, whose ratio of slopes tells the blur that is there
TIMES = 1, 2, 4  # of those blurs, until they are not small beside the one that is there
MAX_BLUR_PX = 8.0  # what varies over more is light, and no edge
WELL_TOLD = 1.2  # px: blur that is told well by the first
PIXEL_WIDTH = 1 / 12 + 1 / 3  # px²: of the pixel, and of the difference of the next but one
EDGE_QUANTILE = 0.998  # quantile of slopes that are the sharpest edges
MIN_SLOPE = 0.5  # grey levels a pixel
MIN_SLOPE_NOISES = 6.0  # of a slope, to be an edge
BANDS = 32  # parts of a frame's rows in which flicker is looked for


@dataclass(frozen=True, slots=True)
class ImageHealth:
    """Quality of the picture, from frames of a still scene.

    Attributes:
        blur_px: Standard deviation of the blur of the sharpest edges; None without an edge [px].
        noise: Temporal standard deviation of a pixel, frame brightness removed [gray levels].
        level: Mean of the lit part [gray levels].
        clipped: Fraction of pixels with a saturated channel.
        flicker: Amplitude of brightness over frames and bands of rows, relative to the level.
        advice: Recommended actions, the most important first.
    """

    blur_px: float | None
    noise: float
    level: float
    clipped: float
    black: float
    flicker: float
    advice: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether nothing is to be done."""
        return not self.advice

    def to_dict(self) -> dict[str, Any]:
        """The same as numbers and lists, for JSON."""
        return asdict(self)


def image_health(
    frames: Sequence[Shaped[ndarray, ...]], *, region: tuple[int, int, int, int] | None = None
) -> ImageHealth:
    """Measure whether a picture is fit for measurements.

    Args:
        frames: 8-bit gray ``[h w]`` or RGB ``[h w 3]`` frames of a still scene, in order.
        region: Region (x, y, width, height); the whole frame by default [px].
    """
    stack = _stack(frames, region)
    grey = np.stack([_grey(one) for one in stack])
    mean = grey.mean(axis=0)
    noise = _noise(grey)
    brightest = np.stack([brightest_channel(one) for one in stack])
    found = ImageHealth(
        edge_blur_px(mean, noise / math.sqrt(len(grey))),
        noise,
        _lit_level(mean),
        float((brightest >= BRIGHT).mean()),
        float((brightest <= DARK).mean()),
        flicker_of(grey),
        (),
    )
    return replace(found, advice=_advice(found))


def edge_blur_px(image: Float[ndarray, "h w"] | Float32[ndarray, "h w"], noise: float = 0.0) -> float | None:
    """Return the standard deviation of the blur of the sharpest edges, None without one below 8 px [px].

    An edge of height H blurred by s has the slope H / (s sqrt(2 pi)). The slope ratio after two further blurs
    gives s without H (Zhuo and Sim, doi:10.1016/j.patcog.2011.03.009).
    """
    blur = None
    for times in TIMES:
        a, b = (times * step for step in STEP_PX)
        small, large = _slopes(image, a), _slopes(image, b)
        limit = max(
            float(np.quantile(large, EDGE_QUANTILE)), MIN_SLOPE_NOISES * _slope_noise(noise, b), MIN_SLOPE
        )
        edges = large >= limit
        if not edges.any():
            return None
        squared = float(np.sum(small[edges] * large[edges]) / np.sum(large[edges] ** 2)) ** 2
        # The ratio squared is (s² + b²) / (s² + a²), and a pixel and a difference have widths of their own.
        wide = max(squared - 1.0, 1e-3)
        blur = math.sqrt(max((b**2 - squared * a**2) / wide - PIXEL_WIDTH, 0.0))
        if blur < WELL_TOLD * times:
            break
    return blur if blur is not None and blur < MAX_BLUR_PX else None


def flicker_of(grey: Float32[ndarray, "n h w"]) -> float:
    """Brightness change over time beyond a steady drift, relative to the level."""
    n, height, _ = grey.shape
    rows = min(BANDS, height)
    bands = grey[:, : height // rows * rows].reshape(n, rows, height // rows, -1).mean(axis=(2, 3))
    change = _level(bands / np.maximum(bands.mean(axis=0), 1.0))
    return float(math.sqrt(2) * change.std())


def _level(signals: Float[ndarray, "n b"]) -> Float[ndarray, "n b"]:
    """Signals less the straight line through each, by least squares."""
    line = np.vander(np.linspace(-1, 1, len(signals)), 2)
    return np.asarray(signals - line @ np.linalg.lstsq(line, signals, rcond=None)[0])


def _noise(grey: Float32[ndarray, "n h w"]) -> float:
    """Median standard deviation of a pixel over time, once the brightness of bands of rows is divided out."""
    level = np.maximum(grey.mean(axis=0), 1.0)
    bands = np.stack([cv2.blur((one / level).mean(axis=1), (1, 9)).ravel() for one in grey])
    even = grey / np.maximum(bands, 0.05)[:, :, None]
    freedom = len(grey) - 1  # the median of few frames' variances lies below their mean
    usual = float(np.median(even.var(axis=0, ddof=1))) * freedom / float(chdtri(freedom, 0.5))
    return math.sqrt(usual)


def _slopes(image: Float[ndarray, "h w"], sigma: float) -> Float32[ndarray, "_ _"]:
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma)
    gx = cv2.filter2D(smooth, cv2.CV_32F, np.array([[-0.5, 0, 0.5]], np.float32))
    gy = cv2.filter2D(smooth, cv2.CV_32F, np.array([[-0.5], [0], [0.5]], np.float32))
    slope = np.hypot(gx, gy)
    edge = math.ceil(3 * max(STEP_PX))
    return slope[edge:-edge, edge:-edge] if min(slope.shape) > 2 * edge + 4 else slope


def _slope_noise(noise: float, sigma: float) -> float:
    """Standard deviation of a slope of noise smoothed by a Gaussian, both directions together."""
    return noise / (2 * math.sqrt(math.pi) * sigma**2)


def _lit_level(mean: Float32[ndarray, "h w"]) -> float:
    """Mean of what is lit; of all, where hardly anything is."""
    lit = mean > LIT * np.percentile(mean, 99)
    return float(mean[lit].mean()) if lit.any() else float(mean.mean())


def _grey(image: Shaped[ndarray, ...]) -> Float32[ndarray, "h w"]:
    return (image if image.ndim == 2 else image.mean(axis=2)).astype(np.float32)


def _stack(
    frames: Sequence[Shaped[ndarray, ...]], region: tuple[int, int, int, int] | None
) -> list[Shaped[ndarray, ...]]:
    """Frames cut to the region."""
    if len(frames) < MIN_FRAMES:
        raise InputError(
            f"{len(frames)} frames; {MIN_FRAMES} or more tell noise and flicker", code="too-few-frames"
        )
    first = frames[0]
    for image in frames:
        if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
            raise ImageError(
                f"a picture is judged by 8-bit grey or RGB frames, got {image.dtype} {list(image.shape)}"
            )
        if image.shape != first.shape:
            raise InputError(
                f"frames of {list(image.shape)} and {list(first.shape)} px; give those of one camera and size"
            )
    if region is None:
        return list(frames)
    x, y, width, height = region
    if x < 0 or y < 0 or min(width, height) < 16 or x + width > first.shape[1] or y + height > first.shape[0]:
        raise RangeError(
            f"a region {list(region)} px (x, y, width, height) in frames of {first.shape[1]} x "
            f"{first.shape[0]} px; it lies inside and is 16 px or more along each side"
        )
    return [image[y : y + height, x : x + width] for image in frames]


def _advice(found: ImageHealth) -> tuple[str, ...]:
    """What to do, what matters most first."""
    told = []
    if found.clipped > MAX_CLIPPED:
        told.append(
            f"{100 * found.clipped:.0f} % of the picture is saturated: shorten the exposure or dim the light"
        )
    if found.level < TOO_DARK:
        told.append(
            f"the lit part has {found.level:.0f} of 255 grey levels: more light or exposure, then gain"
        )
    elif found.level > TOO_BRIGHT and found.clipped <= MAX_CLIPPED:
        told.append(f"the lit part has {found.level:.0f} of 255 grey levels: shorten the exposure")
    if found.flicker > MAX_FLICKER:
        told.append(
            f"brightness changes by {100 * found.flicker:.1f} %: shade lamps on mains off, or expose for a "
            "multiple of 10 ms (50 Hz) or 8.333 ms (60 Hz); else look at the light's supply"
        )
    if found.blur_px is not None and found.blur_px > SHARP_PX:
        told.append(
            f"the sharpest edges are blurred over {found.blur_px:.1f} px: focus on the skin, lock the focus"
        )
    if found.noise > MAX_NOISE:
        told.append(f"noise is {found.noise:.1f} grey levels: more light and less gain")
    return tuple(told)
