"""Skin region: the part of a picture that changes from one press to the next, and what lies outside it.

Lamp, reflections, and background change slowly, so frames a little apart in order are compared. Large
connected regions that change are the skin, one in each view.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import cv2
import numpy as np

from palpate.core import Bool, Float, Float32, Int

MAP_PX = 40  # cells along the longer side in which change is averaged: gaps between markers close
PAIRS = 300
NEAR = 0.02  # ratio of a session between the frames of a pair
ACTIVE = 0.15  # change of a skin cell, between the quietest (0) and the liveliest (1)
MIN_CONTRAST = 1.5  # liveliest over quietest change, below which all is noise
SMALL_PLACE, SMALL_AT_BORDER = 0.05, 0.15  # area relative to the largest, below which it is no skin
FAR_AWAY = 0.1
MIN_OUTSIDE = 0.02  # ratio of the picture below which there is no outside


class RegionSource(Enum):
    """How a region was found, in words."""

    GIVEN = "the box that was given"
    CHANGING = "the part of the picture that changes from press to press"
    CHANGING_UNDER_TOUCH = "the part of the picture that changes more under touch than at rest"
    EVERYWHERE = "every part of the picture changes alike"


@dataclass(frozen=True)
class SkinRegion:
    """Skin in prepared pictures.

    Attributes:
        outside, inside: pixels surely outside the skin, and of the skin, with a margin between ``[h w]``.
    """

    outside: Bool[np.ndarray, "h w"]
    inside: Bool[np.ndarray, "h w"]
    source: RegionSource

    @property
    def far_outside(self) -> Bool[np.ndarray, "h w"]:
        """Pixels outside that no light of a press reaches, a tenth of the picture away from the skin."""
        reach = 2 * round(FAR_AWAY * max(self.inside.shape)) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
        far: Bool[np.ndarray, "h w"] = cv2.dilate((~self.outside).astype(np.uint8), disc) == 0
        return far

    @property
    def has_outside(self) -> bool:
        return bool(self.outside.mean() >= MIN_OUTSIDE)

    @property
    def box(self) -> tuple[int, int, int, int]:
        """(x, y, width, height) that just holds the skin [px of the prepared picture]."""
        rows, columns = (np.flatnonzero(self.inside.any(axis=axis)) for axis in (1, 0))
        return int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1


def change_map(
    images: Float32[np.ndarray, "n h w c"],
    units: Int[np.ndarray, " n"],
    seed: int = 0,
    sessions: Int[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "y x"]:
    """Return the mean absolute difference of frames a little apart in order, in cells [grey levels]."""
    n = len(images)
    sessions = np.zeros(n, np.int64) if sessions is None else sessions
    by_session = np.argsort(sessions, kind="stable")
    rng = np.random.default_rng(seed)
    # Beyond the unit a frame belongs to: within a press, frames may differ by noise alone.
    near = round(NEAR * n / len(np.unique(sessions)))
    step = max(1, near, int(np.median(np.bincount(np.unique(units, return_inverse=True)[1]))))
    step = min(step, max(1, n // 2))
    first = np.unique(np.linspace(0, n - 1 - step, min(PAIRS, n - step)).astype(np.int64))
    second = np.minimum(first + step + rng.integers(0, step + 1, len(first)), n - 1)
    first, second = by_session[first], by_session[second]
    if (same := sessions[first] == sessions[second]).any():
        first, second = first[same], second[same]
    height, width = images.shape[1:3]
    scale = MAP_PX / max(height, width)
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    change = np.mean(
        [np.abs(images[a] - images[b]).max(axis=-1) for a, b in zip(first, second, strict=True)], axis=0
    )
    cells = cv2.resize(change.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return cv2.blur(cells, (3, 3), borderType=cv2.BORDER_REPLICATE).astype(np.float64)


def find_skin(
    images: Float32[np.ndarray, "n h w c"],
    units: Int[np.ndarray, " n"],
    untouched: Float32[np.ndarray, "r h w c"] | None = None,
    sessions: Int[np.ndarray, " n"] | None = None,
    rest_sessions: Int[np.ndarray, " r"] | None = None,
) -> SkinRegion:
    """Find the skin by what changes from press to press.

    Args:
        images: prepared frames in temporal order [grey levels].
        units: press of each.
        untouched: no-contact frames in temporal order, which show what changes without touch.
        sessions, rest_sessions: session of each image and no-contact frame; None for one.
    """
    change = change_map(images, units, sessions=sessions)
    quiet = float(np.quantile(change, 0.02))
    source = RegionSource.CHANGING
    if untouched is not None and len(untouched) >= 4:
        rest = change_map(untouched, np.arange(len(untouched)), sessions=rest_sessions)
        change, quiet = np.maximum(change - rest, 0.0), 0.0
        source = RegionSource.CHANGING_UNDER_TOUCH
    lively = float(np.quantile(change, 0.9))
    height, width = images.shape[1:3]
    whole = np.ones((height, width), dtype=bool)
    if lively <= max(MIN_CONTRAST * quiet, 1e-6):
        return SkinRegion(~whole, whole, RegionSource.EVERYWHERE)
    return _region(change > quiet + ACTIVE * (lively - quiet), (height, width), source)


def _region(active: Bool[np.ndarray, "y x"], shape: tuple[int, int], source: RegionSource) -> SkinRegion:
    closed = cv2.morphologyEx(active.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    _, parts, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    x, y, wide, tall, areas = stats[1:].T
    at_border = (np.minimum(x, y) == 0) | (x + wide == active.shape[1]) | (y + tall == active.shape[0])
    least = np.where(at_border, SMALL_AT_BORDER, SMALL_PLACE) * areas.max(initial=1)
    hull = np.zeros(active.shape, np.uint8)
    for part in 1 + np.flatnonzero(areas >= least):
        corners = np.argwhere(parts == part)[:, ::-1].astype(np.int32)
        cv2.fillConvexPoly(hull, cv2.convexHull(corners), 1)
    wide = cv2.dilate(hull, np.ones((3, 3), np.uint8))
    size = shape[::-1]
    inside, near = (cv2.resize(m, size, interpolation=cv2.INTER_NEAREST) > 0 for m in (hull, wide))
    return SkinRegion(~near, inside, source)


def boxed(shape: tuple[int, int], box: tuple[int, int, int, int]) -> SkinRegion:
    """Return the region whose outside lies beyond a box, (x, y, width, height) [px of the picture]."""
    inside = np.zeros(shape, dtype=bool)
    x, y, width, height = box
    inside[max(y, 0) : y + height, max(x, 0) : x + width] = True
    return SkinRegion(~inside, inside, RegionSource.GIVEN)
