"""Bright pins in images: found in the first frame by their lattice, tracked from frame to frame.

A spot is a pin if it stands on the lattice and resembles its neighbors; reflections do not. Spots come from
one gray level for the frame, or in uneven light, glare, or blur from local contrast at several scales. A
pin's position is the centroid of its brightness above the ground, iterated within reach of its last position.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import no_type_check

import cv2
import numba
import numpy as np
from scipy.spatial import cKDTree

from palpate.core import Bool, Float, ImageError, InputError, Int, RangeError, Shaped, UInt8, ndarray
from palpate.estimators.lattice.dotted_skin import round_patches
from palpate.estimators.lattice.ring_layout import (
    MAX_RINGS,
    WITHIN,
    PinLattice,
    empty_sites,
    name_pins,
    ring_of,
)

ROUNDS = 6  # of looking around where it was found
STILL_PX = 0.005
PARTS = 16  # of a grey level, to which the floor is rounded

i32 = np.int32


@numba.njit(cache=True, nogil=True)
@no_type_check
def settle(pixels, row, margin, xy, reach, floor, sums, weight):
    """Move each position to the centroid above the floor within reach, until it stays.

    Whole rows in integers, so that the loop vectorizes; `pixels` has a dark margin, `floor` and sums are in
    parts of a gray level, `sums` is a workspace of two numbers a column.
    """
    column, column_y = sums[0], sums[1]
    for i in range(len(xy)):
        x, y, ground = xy[i, 0], xy[i, 1], floor[i]
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
                    over = max(i32(PARTS) * i32(pixels[at + np.uint64(k)]) - ground, i32(0))
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


FLOOR = 0.25  # fraction of the way from ground to pin below which pixels have no weight
LOST = 0.35  # of a pin's first weight: with less it is lost
REACH = 0.45  # of the way to the nearest neighbour
MIN_REACH = 0.3  # the same, next to glare
MIN_PINS = 7
NEAR = 19  # pins that one is compared with, itself among them
LIKE = 0.3, 3.0  # times their weight
DARK_AROUND = 0.35  # ratio of directions in which the ground is visible halfway to the neighbors
CROWDED, SPLINTER = 0.72, 0.65  # of the neighbours' distances, and of the other's weight
SHORTER, SHORTEN = 6, 0.8  # times that a reach is shortened, and to how much each time
STRAY = 0.2  # of the way to the nearest neighbour, by which a centroid may lie from where it was looked for
# pins in two rings or more about one; a ring of six about one may be lamps
WHOLE = frozenset(3 * n * (n + 1) + 1 for n in range(2, 20))
MIN_STRAY_PX = 1.5  # spots lie on whole pixels
GLARE_PX = 4  # pixels that touch: fewer are noise

SPAN = 16  # pixels; a window is as wide as some spans
Grey = UInt8[ndarray, "h w"]
Points = Float[ndarray, "p 2"]


@dataclass(frozen=True)
class PinTracks:
    """Pins of one frame.

    Attributes:
        xy_px: Centers (x, y) [px]; NaN if lost.
        ground, bright: Gray levels of ground and pins (medians in uneven light).
        reach_px: Search radius around the last position [px].
        weight: Summed brightness above the ground in the first frame.
        cells: (column, row) on the lattice, (0, 0) being the field's middle; None without a lattice.
        floor: Gray level without weight at each pin; None for a common one.
    """

    xy_px: Points
    ground: float
    bright: float
    reach_px: Float[ndarray, " p"]
    weight: Float[ndarray, " p"]
    cells: Int[ndarray, "p 2"] | None = None
    floor: Float[ndarray, " p"] | None = None

    @property
    def found(self) -> Bool[ndarray, " p"]:
        return np.isfinite(self.xy_px).all(axis=1)

    @property
    def floors(self) -> Float[ndarray, " p"]:
        """Gray level at each pin below which pixels have no weight."""
        if self.floor is not None:
            return self.floor
        return np.full(len(self.xy_px), self.ground + FLOOR * (self.bright - self.ground))


def grey_frame(frame: Shaped[ndarray, ...]) -> Grey | None:
    """Return an 8-bit frame as gray, the mean of three channels; None for any other."""
    if frame.dtype != np.uint8 or frame.ndim not in (2, 3):
        return None
    if frame.ndim == 3:
        return cv2.transform(frame, MEAN_OF_THREE).reshape(frame.shape[:2]) if frame.shape[2] == 3 else None
    return np.ascontiguousarray(frame)


def find_pins(image: Shaped[ndarray, ...], least: int = MIN_PINS, *, on_lattice: bool = True) -> PinTracks:
    """Return the pins of an image, from the middle outwards.

    Args:
        image: 8-bit gray ``[h w]`` or color ``[h w 3]``, pins brighter than their ground.
        least: Least number of pins.
        on_lattice: Whether only spots on a lattice are pins; fewer than seven form none and are accepted as
            they are.
    """
    grey = grey_frame(image)
    if grey is None:
        raise ImageError(
            f"an image {image.dtype} {list(image.shape)}; give 8-bit grey [h w] or colour [h w 3]",
            code="pixel-format",
        )
    if least < 2:
        raise RangeError(f"{least} pins; give 2 or more", code="pin-count")
    level, brighter = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    spots = patches(brighter)
    ground, bright, clear = contrast(grey, int(level))
    seen = len(spots) if clear else 0
    found = None
    if on_lattice:
        found = _by_level(grey, spots, ground, bright) if seen >= least else None
        found = found or _by_contrast(grey)
    if found is None and seen >= least and (seen < MIN_PINS or not on_lattice):
        return _even(grey, spots, ground, bright)
    told = 0 if found is None else len(found.xy_px)
    if found is None or told < least:
        raise ImageError(
            (NO_LATTICE if seen >= least and on_lattice else TOO_FEW).format(seen, least, told),
            code="pins-not-found",
        )
    return found


MEAN_OF_THREE = np.full((1, 3), 1 / 3)
TOO_FEW = (
    "{} pins in the image and at least {} are needed; pins must be brighter than their ground and apart: "
    "look at focus, light and the crop"
)
NO_LATTICE = (
    "{0} bright spots in the image, of which {2} stand on a lattice as pins do, and at least {1} pins in the "
    "image are needed: pins in rings, or on a hexagonal or square lattice, all in sight but for a few. Look "
    "at focus, light and the crop; shade lamps that are mirrored between the pins"
)


def _by_level(grey: Grey, spots: Points, ground: float, bright: float) -> PinTracks | None:
    """Pins as spots of one level, if they are a whole lattice and nothing else."""
    if len(spots) not in WHOLE:
        return None
    named = name_pins(spots, (grey.shape[0], grey.shape[1]))
    if named is None or not named.whole or len(named.marks) < len(spots):
        return None
    order = _outwards(spots[named.marks])
    return _even(grey, spots[named.marks[order]], ground, bright, named.cells[order])


def _even(
    grey: Grey, xy: Points, ground: float, bright: float, cells: Int[ndarray, "p 2"] | None = None
) -> PinTracks:
    xy = xy if cells is not None else xy[_outwards(xy)]
    first = PinTracks(xy, ground, bright, REACH * _spacing(xy), np.full(len(xy), np.inf), cells)
    xy, weight = _centroids(grey, first.xy_px, first.reach_px, first.floors)
    return PinTracks(xy, ground, bright, first.reach_px, weight, cells)


LOOKS = 2  # sizes of spots that are named


def _by_contrast(grey: Grey) -> PinTracks | None:
    """Pins among round patches of any size, each with the floor of its own light."""
    best: PinTracks | None = None
    for spots in orderly_spots(grey)[:LOOKS]:
        named = name_pins(spots, (grey.shape[0], grey.shape[1]))
        if named is None or len(named.marks) < MIN_PINS:
            continue
        found = _uneven(grey, spots, named)
        if best is None or len(found.xy_px) > len(best.xy_px):
            best = found
        if named.settled:
            break
    return best


def _uneven(grey: Grey, spots: Float[ndarray, "s 2"], named: PinLattice) -> PinTracks:
    marks = named.marks[_uncrowded(grey, spots[named.marks])]
    cells = named.cells[np.isin(named.marks, marks)]
    xy, others = spots[marks], np.delete(spots, marks, axis=0)
    more, looked_at = _where_expected(named.kind, cells, xy, others, (grey.shape[0], grey.shape[1]))
    sure, cells, xy = len(xy), np.concatenate([cells, more]), np.concatenate([xy, looked_at])
    start = xy
    if len(others):
        others = others[cKDTree(xy).query(others)[0] > 0]
    spacing = _spacing(xy)
    near = _neighbours(xy, sure)
    beside = np.maximum(REACH * _apart(xy, others), MIN_REACH * spacing)
    for _ in range(2):
        bright, around = light_at(grey, xy, spacing)
        # Of the neighbours together: one pin's own would be its dirt, or the glare that stands in its place.
        ground = np.median(around, axis=1)
        dark, light = (np.median(levels[near], axis=1) for levels in (ground, bright))
        # A halo of glare is above all of a pin's ground, and would draw it to itself.
        floor = np.maximum(dark + FLOOR * (light - dark), np.minimum(ground, 0.5 * (dark + light)))
        reach = np.minimum(_clear_of_glare(_brighter(grey, xy, floor), xy, spacing), beside)
        xy, reach, weight, here = _held(grey, start, reach, floor, np.maximum(STRAY * spacing, MIN_STRAY_PX))
    bright, around = light_at(grey, xy, spacing)
    kept = here & _looks_like_a_pin(bright, around, dark, light)
    pins = PinTracks(xy, float(np.median(dark)), float(np.median(light)), reach, weight, cells, floor)
    pins = _only(pins, kept & _alike(pins))
    return _only(pins, _outwards(pins.xy_px))


def _where_expected(
    kind: str, cells: Int[ndarray, "p 2"], xy: Points, others: Float[ndarray, "o 2"], size: tuple[int, int]
) -> tuple[Int[ndarray, "e 2"], Float[ndarray, "e 2"]]:
    """Cells without a pin, and the search position: a spot near the prediction, or the prediction."""
    if kind == "square" or ring_of(cells).max() > MAX_RINGS:
        return np.empty((0, 2), int), np.empty((0, 2))
    empty, expected = empty_sites(kind, cells, xy, size)
    if len(others) and len(empty):
        far, which = cKDTree(others).query(expected)
        near = far < WITHIN * np.median(_spacing(xy))
        _, once = np.unique(which, return_index=True)
        near &= np.isin(np.arange(len(which)), once)
        expected = np.where(near[:, None], others[which], expected)
    return empty, expected


def _neighbours(xy: Points, sure: int | None = None) -> Int[ndarray, "p q"]:
    """Pins around each, among the first so many, for comparison."""
    known = xy[:sure]
    return np.asarray(cKDTree(known).query(xy, k=min(NEAR, len(known)))[1])


def _uncrowded(grey: Grey, xy: Points) -> Bool[ndarray, " p"]:
    """Which spots remain where two are too close to be pins."""
    spacing, kept = _spacing(xy), np.ones(len(xy), bool)
    usual = np.percentile(spacing[_neighbours(xy)], 70, axis=1)
    crowded = np.flatnonzero(spacing < CROWDED * usual)
    if len(crowded):
        bright, around = light_at(grey, xy, usual)
        floor = np.median((1 - FLOOR) * np.median(around, axis=1) + FLOOR * bright)
        _, weight = _centroids(grey, xy[crowded], MIN_REACH * usual[crowded], np.full(len(crowded), floor))
        tree = cKDTree(xy[crowded])
        for i, j in tree.query_pairs(CROWDED * float(usual[crowded].max())):
            if np.hypot(*(xy[crowded[i]] - xy[crowded[j]])) < CROWDED * usual[crowded[i]]:
                weaker, stronger = (i, j) if weight[i] < weight[j] else (j, i)
                kept[crowded[weaker]] &= weight[weaker] > SPLINTER * weight[stronger]
    return kept


def _held(
    grey: Grey,
    spots: Points,
    reach: Float[ndarray, " p"],
    floor: Float[ndarray, " p"],
    stray: Float[ndarray, " p"],
) -> tuple[Points, Float[ndarray, " p"], Float[ndarray, " p"], Bool[ndarray, " p"]]:
    """Centroids, with a shorter reach for those that otherwise reach bright neighbors."""
    reach = reach.copy()
    for _ in range(SHORTER):
        moved, weight = _centroids(grey, spots, reach, floor)
        here = np.hypot(*(moved - spots).T) < stray
        if here.all():
            break
        reach[~here] *= SHORTEN
    return np.where(here[:, None], moved, spots), reach, weight, here


def _looks_like_a_pin(
    bright: Float[ndarray, " p"],
    around: Float[ndarray, "p a"],
    dark: Float[ndarray, " p"],
    light: Float[ndarray, " p"],
) -> Bool[ndarray, " p"]:
    """Ratio of directions in which a spot is brighter in its middle than around."""
    half = 0.5 * (dark + light)
    outshines = np.maximum((bright - dark) / np.maximum(light - dark, 1.0) - 1.0, 0.0)
    ground_seen = (around < half[:, None]).mean(axis=1)
    return np.asarray((bright > half) & (ground_seen > DARK_AROUND + outshines))


def _apart(xy: Points, others: Float[ndarray, "o 2"]) -> Float[ndarray, " p"]:
    """Distance of each pin to the nearest spot that is no pin [px]."""
    return np.asarray(cKDTree(others).query(xy)[0]) if len(others) else np.full(len(xy), np.inf)


def _alike(pins: PinTracks) -> Bool[ndarray, " p"]:
    """Which pins have about the weight of their neighbors, unlike glare and dirt."""
    usual = np.median(pins.weight[_neighbours(pins.xy_px)], axis=1)
    return np.asarray((pins.weight > LIKE[0] * usual) & (pins.weight < LIKE[1] * usual))


def _brighter(grey: Grey, xy: Points, floor: Float[ndarray, " p"]) -> Grey:
    """Spots brighter than a floor that is a quadratic polynomial over the frame."""
    high, wide = grey.shape
    scale = max(high, wide)

    def terms(x: ndarray, y: ndarray) -> ndarray:
        u, v = x / scale - 0.5, y / scale - 0.5
        return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)

    fit, *_ = np.linalg.lstsq(terms(*xy.T), floor, rcond=None)
    y, x = np.mgrid[:high, :wide]
    return np.where(grey > terms(x, y) @ fit, 255, 0).astype(np.uint8)


def _clear_of_glare(brighter: Grey, xy: Points, spacing: Float[ndarray, " p"]) -> Float[ndarray, " p"]:
    """Reach of each pin that excludes bright spots which are no pins."""
    reach = REACH * spacing
    _, label, boxes, _ = cv2.connectedComponentsWithStatsWithAlgorithm(brighter, 8, cv2.CV_32S, cv2.CCL_BBDT)
    column, row = (
        np.clip(np.rint(a).astype(int), 0, n - 1) for a, n in zip(xy.T, label.shape[::-1], strict=True)
    )
    other = boxes[:, 4] >= GLARE_PX
    other[0] = False
    other[label[row, column]] = False
    if not other.any():
        return reach
    away = cv2.distanceTransform(np.where(other[label], 0, 255).astype(np.uint8), cv2.DIST_L2, 5)
    return np.minimum(np.maximum(away[row, column] - 1.0, MIN_REACH * spacing), reach)


def _spacing(xy: Points) -> Float[ndarray, " p"]:
    return np.asarray(cKDTree(xy).query(xy, k=2)[0][:, 1])


def _outwards(xy: Points) -> Int[ndarray, " p"]:
    return np.argsort(((xy - xy.mean(axis=0)) ** 2).sum(axis=1))


def _only(pins: PinTracks, which: ndarray) -> PinTracks:
    cells, floor = (None if a is None else a[which] for a in (pins.cells, pins.floor))
    return PinTracks(
        pins.xy_px[which], pins.ground, pins.bright, pins.reach_px[which], pins.weight[which], cells, floor
    )


def follow(frames: Iterable[Shaped[ndarray, ...]], pins: PinTracks) -> Iterator[PinTracks]:
    """Yield the pins of every frame, each searched where it last was; a lost pin stays lost."""
    now, floors = pins, pins.floors
    for frame in frames:
        grey = grey_frame(frame)
        if grey is None:
            raise InputError(
                f"a frame {frame.dtype} {list(frame.shape)}; give 8-bit grey [h w] or colour [h w 3]",
                code="pixel-format",
            )
        xy, weight = _centroids(grey, now.xy_px, pins.reach_px, floors)
        xy[weight < LOST * pins.weight] = np.nan
        now = replace(pins, xy_px=xy)
        yield now


def _centroids(
    image: Grey, xy: Points, reach: Float[ndarray, " p"], floor: Float[ndarray, " p"]
) -> tuple[Points, Float[ndarray, " p"]]:
    places, weight = xy.copy(), np.zeros(len(xy))
    width = SPAN * math.ceil((2 * reach.max() + 2) / SPAN)
    # 16 parts of 255 levels on half a window squared fit 31 bits.
    sums = np.empty((2, width), np.int32 if width < 700 else np.int64)
    padded = cv2.copyMakeBorder(image, width, width, width, width, cv2.BORDER_CONSTANT, value=0)
    parts = np.rint(PARTS * floor).astype(np.int32)
    settle(padded.ravel(), padded.shape[1], width, places, reach, parts, sums, weight)
    return places, weight


CLEAR = 5.0  # spreads of the ground that pins are brighter by
MIN_PX = 4
RADII = 1.2, 1.7  # px at each scale
MIN_SIDE = 32  # px at the smallest scale
MIN_CONTRAST = 0.03
BESIDE = 6  # neighbours that are looked at
OPPOSITE = 0.35  # of the nearest one's distance: how far from the mirrored place the opposite one may lie
AROUND = 12
ONE_SIZE = 1.5  # times the nearest one's distance


def patches(brighter: Grey) -> Points:
    """Return centers of the patches brighter than the ground, of a pin's size and inside the image."""
    # The algorithm is named, since the usual one takes 2.6 times as long on pins.
    _, _, boxes, middles = cv2.connectedComponentsWithStatsWithAlgorithm(
        brighter, 8, cv2.CV_32S, cv2.CCL_BBDT
    )
    (high, wide), (left, top, width, height, size) = brighter.shape, boxes[1:].T  # the first is the ground
    large = size >= MIN_PX
    typical = np.median(size[large]) if large.any() else 0
    whole = (left > 0) & (top > 0) & (left + width < wide) & (top + height < high)
    return middles[1:][whole & large & (size > 0.3 * typical) & (size < 3 * typical)]


def contrast(image: Grey, level: int) -> tuple[float, float, bool]:
    """Return gray levels of ground and pins, and whether pins stand out from the ground's spread."""
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
    upto = np.cumsum(counts)
    return float(np.searchsorted(upto, upto[-1] / 2))


def orderly_spots(image: Grey) -> list[Points]:
    """Return round patches of each size, the most regular first, to a pixel or two."""
    found = [(_order(places), places) for places in _by_size(image)]
    return [places for order, places in sorted(found, key=lambda one: -one[0]) if order > 0]


def _by_size(image: Grey) -> Iterator[Points]:
    copy, scale = image, 1
    while min(copy.shape) >= MIN_SIDE:
        for radius in RADII:
            yield scale * _one_each(round_patches(copy, radius, "bright", MIN_CONTRAST))
        copy, scale = cv2.pyrDown(copy), 2 * scale


def _one_each(places: Float[ndarray, "n 2"]) -> Points:
    """Pixels that touch are one patch, whose top is flat."""
    pairs = cKDTree(places).query_pairs(1.5, output_type="ndarray") if len(places) else np.empty((0, 2), int)
    keep = np.ones(len(places), bool)
    keep[pairs[:, 1]] = False
    return places[keep]


def _order(places: Points) -> float:
    """Number of patches with opposite neighbors, times their ratio."""
    if len(places) <= BESIDE:
        return 0.0
    near, which = cKDTree(places).query(places, k=BESIDE + 1)
    near, out = near[:, 1:], places[which[:, 1:]] - places[:, None]
    mirror = np.hypot(*(out[:, :, None] + out[:, None]).transpose(3, 0, 1, 2)).min(axis=2)
    paired = (mirror < OPPOSITE * near[:, :1]) & (near < ONE_SIZE * near[:, :1])
    orderly = paired.sum(axis=1) >= 4
    return float(orderly.sum() * orderly.mean())


def light_at(
    image: Shaped[ndarray, "h w"], xy: Points, spacing: Float[ndarray, " p"]
) -> tuple[Float[ndarray, " p"], Float[ndarray, "p a"]]:
    """Return gray levels of each pin ``[p]``, and halfway to its neighbors in twelve directions ``[p a]``."""
    angle = np.arange(AROUND) * 2 * np.pi / AROUND
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    between = xy[:, None] + 0.5 * spacing[:, None, None] * around
    at = np.concatenate([xy[:, None], between], axis=1).astype(np.float32)
    levels = cv2.remap(
        cv2.blur(image, (3, 3)), at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float64)
    return levels[:, 0], levels[:, 1:]
