"""Bright pins in grey images: found in the first frame, followed from frame to frame.

A pin's place is the centroid of what it is brighter than its ground by, which a disc of even brightness gives
to a few hundredths of a pixel. Following looks only near where each pin was, and again around where it is
found, until that no longer moves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import no_type_check

import cv2
import numba
import numpy as np
from jaxtyping import Bool, Float, Shaped, UInt8
from numpy import ndarray
from scipy.spatial import cKDTree

from palpate.core.errors import ImageError, InputError, RangeError

FLOOR = 0.25  # of the way from ground to pin: what is darker has no weight
ROUNDS = 6  # of looking around where it was found
STILL_PX = 0.005
LOST = 0.35  # of a pin's first weight: with less it is lost
CLEAR = 5.0  # spreads of the ground that pins are brighter by
REACH = 0.45  # of the way to the nearest neighbour
LEAST_PX, LEAST_PINS = 4, 7

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
    """
    if image.dtype != np.uint8 or image.ndim != 2:
        raise ImageError(f"pins are found in 8-bit grey images [h w], got {image.dtype} {list(image.shape)}")
    _, mask = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, _, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
    size = stats[1:, cv2.CC_STAT_AREA]
    h, w = image.shape
    left, top, wide, high = (stats[1:, k] for k in range(4))
    whole = (left > 0) & (top > 0) & (left + wide < w) & (top + high < h)
    typical = np.median(size[size >= LEAST_PX]) if (size >= LEAST_PX).any() else 0
    kept = whole & (size >= LEAST_PX) & (size > 0.3 * typical) & (size < 3 * typical)
    ground, bright, clear = _contrast(image, mask > 0)
    if kept.sum() < least or not clear:
        raise ImageError(
            f"{int(kept.sum()) if clear else 0} pins in the image and at least {least} are needed; pins must "
            "be brighter than their ground and apart: look at focus, light and the crop"
        )
    xy = centres[1:][kept]
    xy = xy[np.argsort(((xy - xy.mean(axis=0)) ** 2).sum(axis=1))]
    nearest = cKDTree(xy).query(xy, k=2)[0][:, 1]
    first = Pins(xy, ground, bright, REACH * nearest, np.full(len(xy), np.inf))
    xy, weight = _centroids(image, first.xy_px, first.reach_px, _floor(first))
    return Pins(xy, ground, bright, first.reach_px, weight)


def _contrast(image: Grey, pin: Bool[ndarray, "h w"]) -> tuple[float, float, bool]:
    """Levels of ground and pins, and whether pins stand out from the ground's own spread."""
    if pin.all() or not pin.any():
        return 0.0, 0.0, False
    ground, bright = float(np.median(image[~pin])), float(np.median(image[pin]))
    return ground, bright, bright - ground > CLEAR * max(1.0, float(image[~pin].std()))


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
    _settle(image, found, reach, floor, weight)
    return found, weight


@numba.njit(cache=True, nogil=True)
@no_type_check
def _settle(image, xy, reach, floor, weight):
    h, w = image.shape
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        if not (np.isfinite(x) and np.isfinite(y)):
            continue
        for _ in range(ROUNDS):
            total = at_x = at_y = 0.0
            for r in range(max(0, int(y - reach[i])), min(h, int(y + reach[i]) + 2)):
                for c in range(max(0, int(x - reach[i])), min(w, int(x + reach[i]) + 2)):
                    inside = reach[i] ** 2 - (c - x) ** 2 - (r - y) ** 2
                    over = image[r, c] - floor
                    if inside > 0 and over > 0:
                        total += over
                        at_x += over * c
                        at_y += over * r
            if total == 0.0:
                break
            moved = np.hypot(at_x / total - x, at_y / total - y)
            x, y = at_x / total, at_y / total
            if moved < STILL_PX:
                break
        xy[i, 0], xy[i, 1] = x, y
        weight[i] = total
