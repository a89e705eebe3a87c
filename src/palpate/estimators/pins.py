"""Bright pins in grey images: found in the first frame, followed from frame to frame.

A pin's place is the centroid of what it is brighter than its ground by, which a disc of even brightness gives
to a few hundredths of a pixel. Following looks only near where each pin was, and again around where it is
found, until that no longer moves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import no_type_check

import cv2
import numba
import numpy as np
from scipy.spatial import cKDTree

from palpate.core import Bool, Float, ImageError, InputError, RangeError, Shaped, UInt8, ndarray

ROUNDS = 6  # of looking around where it was found
STILL_PX = 0.005
PARTS = 16  # of a grey level, to which the floor is rounded

i32 = np.int32


@numba.njit(cache=True, nogil=True)
@no_type_check
def settle(pixels, row, margin, xy, reach, floor, sums, weight):
    """Move each place to the centroid of what is brighter than the floor within reach, until it stays.

    Whole numbers, and whole rows of the window in which what is out of reach counts nothing: such a loop
    becomes vectors, one over just what is within reach would not.

    Args:
        pixels, row, margin: an image with a dark margin around, flat, and the length of its rows [px].
        xy: where to start; changed.
        reach: see `PinTracks`.
        floor: in parts of a grey level, as all sums here are.
        sums: workspace, two numbers for every column of a window.
        weight: to be filled.
    """
    column, column_y = sums[0], sums[1]
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        for _ in range(ROUNDS):
            if not (0 <= x < row - 2 * margin and 0 <= y < pixels.size // row - 2 * margin):
                break
            left, top = math.floor(x - reach[i]), math.floor(y - reach[i])
            for k in range(column.size):
                column[k] = column_y[k] = 0
            for r in range(top, math.floor(y + reach[i]) + 1):
                half = math.sqrt(max(0.0, reach[i] ** 2 - (r - y) ** 2))
                low, high = i32(math.ceil(x - half) - left), i32(math.floor(x + half) - left)
                below = i32(r - top)
                at = np.uint64((r + margin) * row + left + margin)  # no sign: nothing is counted from the end
                for k in range(column.size):
                    over = max(i32(PARTS) * i32(pixels[at + np.uint64(k)]) - floor, i32(0))
                    over = over if low <= i32(k) <= high else i32(0)
                    column[k] += over
                    column_y[k] += over * below
            total = at_x = at_y = 0
            for k in range(column.size):
                total += column[k]
                at_x += column[k] * k
                at_y += column_y[k]
            weight[i] = total / PARTS
            if total == 0:
                break
            x, y = left + at_x / total, top + at_y / total
            moved = math.hypot(x - xy[i, 0], y - xy[i, 1])
            xy[i, 0], xy[i, 1] = x, y
            if moved < STILL_PX:
                break


FLOOR = 0.25  # of the way from ground to pin: what is darker has no weight
LOST = 0.35  # of a pin's first weight: with less it is lost
CLEAR = 5.0  # spreads of the ground that pins are brighter by
REACH = 0.45  # of the way to the nearest neighbour
MIN_PX, MIN_PINS = 4, 7

SPAN = 16  # pixels; a window is as wide as some spans
Grey = UInt8[ndarray, "h w"]
Points = Float[ndarray, "p 2"]


@dataclass(frozen=True)
class PinTracks:
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


def find_pins(image: Shaped[ndarray, ...], least: int = MIN_PINS) -> PinTracks:
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
    level, brighter = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    xy = _patches(brighter)
    ground, bright, clear = _contrast(image, int(level))
    if len(xy) < least or not clear:
        raise ImageError(
            f"{len(xy) if clear else 0} pins in the image and at least {least} are needed; pins must "
            "be brighter than their ground and apart: look at focus, light and the crop"
        )
    xy = xy[np.argsort(((xy - xy.mean(axis=0)) ** 2).sum(axis=1))]
    nearest = cKDTree(xy).query(xy, k=2)[0][:, 1]
    first = PinTracks(xy, ground, bright, REACH * nearest, np.full(len(xy), np.inf))
    xy, weight = _centroids(image, first.xy_px, first.reach_px, _floor(first))
    return PinTracks(xy, ground, bright, first.reach_px, weight)


def _patches(brighter: Grey) -> Points:
    """Middles of the patches of what is brighter than the ground, of a pin's size and inside the image."""
    # The algorithm is named, since the usual one takes 2.6 times as long on pins.
    _, _, boxes, middles = cv2.connectedComponentsWithStatsWithAlgorithm(
        brighter, 8, cv2.CV_32S, cv2.CCL_BBDT
    )
    (high, wide), (left, top, width, height, size) = brighter.shape, boxes[1:].T  # the first is the ground
    large = size >= MIN_PX
    typical = np.median(size[large]) if large.any() else 0
    whole = (left > 0) & (top > 0) & (left + width < wide) & (top + height < high)
    return middles[1:][whole & large & (size > 0.3 * typical) & (size < 3 * typical)]


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
    """Median of whole numbers from 0, by how often each occurs."""
    upto = np.cumsum(counts)
    return float(np.searchsorted(upto, upto[-1] / 2))


def follow(frames: Iterable[Shaped[ndarray, ...]], pins: PinTracks) -> Iterator[PinTracks]:
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
        now = PinTracks(xy, pins.ground, pins.bright, pins.reach_px, pins.weight)
        yield now


def _floor(pins: PinTracks) -> float:
    return pins.ground + FLOOR * (pins.bright - pins.ground)


def _centroids(
    image: Grey, xy: Points, reach: Float[ndarray, " p"], floor: float
) -> tuple[Points, Float[ndarray, " p"]]:
    places, weight = xy.copy(), np.zeros(len(xy))
    width = SPAN * math.ceil((2 * reach.max() + 2) / SPAN)
    # 16 parts of 255 levels on half a window squared fit 31 bits.
    sums = np.empty((2, width), np.int32 if width < 700 else np.int64)
    padded = cv2.copyMakeBorder(
        np.ascontiguousarray(image), width, width, width, width, cv2.BORDER_CONSTANT, value=0
    )
    settle(
        padded.ravel(), padded.shape[1], width, places, reach, np.int32(round(PARTS * floor)), sums, weight
    )
    return places, weight
