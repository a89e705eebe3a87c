"""Bright pins in grey images: found in the first frame, followed from frame to frame.

A pin's place is the centroid of what it is brighter than its ground by, which a disc of even brightness gives
to a few hundredths of a pixel. Following looks only near where each pin was, and again around where it is
found, until that no longer moves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray
from scipy.spatial import cKDTree

from palpate.core.errors import ImageError, InputError, RangeError
from palpate.core.shapes import Bool, Float, Shaped, UInt8
from palpate.estimators.pin_kernels import PARTS, brighter, settle

FLOOR = 0.25  # of the way from ground to pin: what is darker has no weight
LOST = 0.35  # of a pin's first weight: with less it is lost
CLEAR = 5.0  # spreads of the ground that pins are brighter by
REACH = 0.45  # of the way to the nearest neighbour
LEAST_PX, LEAST_PINS = 4, 7

SPAN = 16  # pixels; a window is as wide as some spans
Grey = UInt8[ndarray, "h w"]
Points = Float[ndarray, "p 2"]


@dataclass(frozen=True)
class Pins:
    """Pins of one frame.

    Attributes:
        xy_px: centres (x along columns, y along rows) [px]; NaN where a pin is lost.
        ground, bright: grey levels of ground and pins.
        reach_px: how far from where it was a pin is looked for.
        weight: summed brightness above the ground, of every pin in the first frame.
    """

    xy_px: Points
    ground: float
    bright: float
    reach_px: Float[ndarray, " p"]
    weight: Float[ndarray, " p"]

    @property
    def found(self) -> Bool[ndarray, " p"]:
        return np.isfinite(self.xy_px).all(axis=1)


def find_pins(image: Shaped[ndarray, ...], least: int = LEAST_PINS) -> Pins:
    """The pins of an image, the one nearest to their middle first and outwards from it.

    Args:
        image: 8-bit grey, pins brighter than their ground.
        least: fewer pins are none.

    Raises:
        ImageError: not 8-bit grey, or too few pins in it.
        RangeError: fewer than two pins asked for.
    """
    if image.dtype != np.uint8 or image.ndim != 2:
        raise ImageError(f"pins are found in 8-bit grey images [h w], got {image.dtype} {list(image.shape)}")
    if least < 2:
        raise RangeError(
            f"{least} pins at least; 2 or more, since how far a pin is looked for is its neighbour's"
        )
    image = np.ascontiguousarray(image)
    level, _ = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    xy = _patches(image, int(level))
    ground, bright, clear = _contrast(image, int(level))
    if len(xy) < least or not clear:
        raise ImageError(
            f"{len(xy) if clear else 0} pins in the image and at least {least} are needed; pins must "
            "be brighter than their ground and apart: look at focus, light and the crop"
        )
    xy = xy[np.argsort(((xy - xy.mean(axis=0)) ** 2).sum(axis=1))]
    nearest = cKDTree(xy).query(xy, k=2)[0][:, 1]
    first = Pins(xy, ground, bright, REACH * nearest, np.full(len(xy), np.inf))
    xy, weight = _centroids(image, first.xy_px, first.reach_px, _floor(first))
    return Pins(xy, ground, bright, first.reach_px, weight)


def _patches(image: Grey, level: int) -> Points:
    """Middles of the patches brighter than a level that are of a pin's size and inside the image."""
    patches = brighter(image, level)
    size = patches[:, 0]
    large = size >= LEAST_PX
    typical = np.median(size[large]) if large.any() else 0
    whole = patches[:, 3] > 0
    kept = whole & large & (size > 0.3 * typical) & (size < 3 * typical)
    return patches[kept, 1:3] / size[kept, None]


def _contrast(image: Grey, level: int) -> tuple[float, float, bool]:
    """Grey of ground and pins, and whether pins stand out from the ground's own spread."""
    counts = cv2.calcHist([image], [0], None, [256], [0, 256]).ravel().astype(np.float64)
    ground, pin = counts[: level + 1], counts[level + 1 :]
    if not (ground.any() and pin.any()):
        return 0.0, 0.0, False
    greys = np.arange(level + 1)
    mean = np.average(greys, weights=ground)
    spread = np.sqrt(np.average((greys - mean) ** 2, weights=ground))
    dark, bright = _median(ground), level + 1 + _median(pin)
    return dark, bright, bool(bright - dark > CLEAR * max(1.0, spread))


def _median(counts: Float[ndarray, " n"]) -> float:
    """Of whole numbers from 0, by how often each occurs."""
    upto = np.cumsum(counts)
    return float(np.searchsorted(upto, upto[-1] / 2))


def follow(frames: Iterable[Shaped[ndarray, ...]], pins: Pins) -> Iterator[Pins]:
    """The pins of every frame, each looked for where it was in the last; a lost pin stays lost.

    Args:
        frames: images as the one in which the pins were found, little apart.
        pins: of the frame before the first of these.

    Raises:
        InputError: a frame of another kind.
    """
    now = pins
    for frame in frames:
        if frame.dtype != np.uint8 or frame.ndim != 2:
            raise InputError(f"pins are followed in 8-bit grey frames, got {frame.dtype} {list(frame.shape)}")
        xy, weight = _centroids(frame, now.xy_px, pins.reach_px, _floor(pins))
        xy[weight < LOST * pins.weight] = np.nan
        now = Pins(xy, pins.ground, pins.bright, pins.reach_px, pins.weight)
        yield now


def largest_circle(pins: Pins) -> float:
    """Radius of the circle around the middle pin through the farthest one [px]: the report's Algorithm 1.

    Raises:
        RangeError: no pins.
    """
    xy = pins.xy_px[pins.found]
    if not len(xy):
        raise RangeError("no pin is found; the circle through the pins has no size")
    return float(np.hypot(*(xy - xy[0]).T).max())


def _floor(pins: Pins) -> float:
    return pins.ground + FLOOR * (pins.bright - pins.ground)


def _centroids(
    image: Grey, xy: Points, reach: Float[ndarray, " p"], floor: float
) -> tuple[Points, Float[ndarray, " p"]]:
    found, weight = xy.copy(), np.zeros(len(xy))
    width = SPAN * math.ceil((2 * reach.max() + 2) / SPAN)
    whole = (
        np.int32 if width < 700 else np.int64
    )  # 16 parts of 255 levels on half a window squared fit 31 bits
    padded = cv2.copyMakeBorder(
        np.ascontiguousarray(image), width, width, width, width, cv2.BORDER_CONSTANT, value=0
    )
    sums = np.empty((2, width), whole)
    settle(padded.ravel(), padded.shape[1], width, found, reach, np.int32(round(PARTS * floor)), sums, weight)
    return found, weight
