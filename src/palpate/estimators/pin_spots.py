"""Bright spots of a pin's size: by one gray level for the frame, or by local contrast.

Local contrast looks for round patches at several scales and keeps the scale with the most regular ones.
Neither distinguishes pins from reflections; the lattice does (`lattice.pin_lattice`).
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from scipy.spatial import cKDTree

from palpate.core import Float, Shaped, UInt8, ndarray
from palpate.estimators.lattice.dotted_skin import round_patches

Grey = UInt8[ndarray, "h w"]
Points = Float[ndarray, "p 2"]

CLEAR = 5.0  # spreads of the ground that pins are brighter by
MIN_PX = 4
RADII = 1.2, 1.7  # px in each copy
MIN_SIDE = 32  # px of the smallest copy
MIN_CONTRAST = 0.03
BESIDE = 6  # neighbours that are looked at
OPPOSITE = 0.35  # of the nearest one's distance: how far from the mirrored place the opposite one may lie
AROUND = 12
ONE_SIZE = 1.5  # times the nearest one's distance


def patches(brighter: Grey) -> Points:
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


def contrast(image: Grey, level: int) -> tuple[float, float, bool]:
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
    upto = np.cumsum(counts)
    return float(np.searchsorted(upto, upto[-1] / 2))


def orderly_spots(image: Grey) -> list[Points]:
    """Round patches of each size, those in best order first; a pixel or two from where they are."""
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
    """How many have neighbours opposite each other as in a lattice, times their share."""
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
