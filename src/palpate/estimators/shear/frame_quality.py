"""Whether a frame can be read: its light, its sharpness and its marks beside those of the reference frame.

Marks are found in poor frames as well, with places that are wrong by more than they say. What a reading needs
is therefore asked of the frame itself: levels neither at the end of the camera's range nor far below the
reference's, and edges of the pattern as steep, over its contrast, as they were.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from palpate.core import Float, Shaped, ndarray
from palpate.core.refusal import NONE, Refusal
from palpate.estimators.brightest_channel import brightest_channel

MIN_CONTRAST = 0.4  # of the reference's
MIN_SHARPNESS = 0.7  # of the reference's
MAX_CLIPPED = 0.1  # share of pixels at the end of the range, beyond the reference's
CLIPPED = 254
STEP = 2  # every second pixel tells a level


class FrameLook(NamedTuple):
    """What a frame looks like where the pattern is.

    Attributes:
        contrast: between its darker and its brighter parts [grey levels].
        clipped: share of pixels of which a channel is at the end of the range.
        steep: steepest gradients along x and along y over the contrast [1/px].
    """

    contrast: float
    clipped: float
    steep: tuple[float, float]


def pattern_box(places_px: Float[ndarray, "n 2"], shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of an image that hold marks."""
    low = np.clip(places_px.min(axis=0), 0, None).astype(int)
    high = np.ceil(np.minimum(places_px.max(axis=0) + 1, shape[1::-1])).astype(int)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def look_at(image: Shaped[ndarray, ...], box: tuple[slice, slice]) -> FrameLook:
    """Look of an 8-bit frame within a box."""
    part = image[box]
    grey = part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_RGB2GRAY)
    brightest = brightest_channel(part)
    some = grey[::STEP, ::STEP]
    low, high = _level(some, 10), _level(some, 90)
    contrast = max(high - low, 1.0)
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.8)  # noise is no edge
    gx, gy = (np.abs(g[::STEP, ::STEP]) for g in cv2.spatialGradient(smooth))
    steep = tuple(_level(g, 97) / contrast for g in (gx, gy))
    return FrameLook(contrast, float((brightest[::STEP, ::STEP] >= CLIPPED).mean()), (steep[0], steep[1]))


def _level(values: Shaped[ndarray, ...], percent: float) -> float:
    """Percentile of whole numbers from 0 on, as NumPy has it, by counting them."""
    below = np.cumsum(np.bincount(values.ravel()))
    place = percent / 100 * (below[-1] - 1)
    lower, upper = np.searchsorted(below, [math.floor(place), math.ceil(place)], side="right")
    return float(lower + (upper - lower) * (place % 1))


def why_unreadable(now: FrameLook, reference: FrameLook) -> Refusal:
    """Why a frame is not to be read against its reference; none where it may be."""
    if now.clipped > reference.clipped + MAX_CLIPPED:
        percent = f"{100 * now.clipped:.0f} %"
        return Refusal("saturated", f"{percent} of the pattern is saturated; lower light or exposure")
    if now.contrast < MIN_CONTRAST * reference.contrast:
        return Refusal(
            "low_contrast",
            f"the pattern's contrast is {now.contrast:.0f} grey levels, and {reference.contrast:.0f} in the "
            f"reference: too dark, or covered; look at the light",
        )
    sharp = min(a / b for a, b in zip(now.steep, reference.steep, strict=True))
    if sharp < MIN_SHARPNESS:
        return Refusal(
            "blurred", f"the frame is blurred: edges are {100 * sharp:.0f} % as steep as the reference's"
        )
    return NONE
