"""Steady plateaus told by the image alone: of known weights that are laid on, without a force sensor.

A weight lies still. The image differs from the untouched sensor's by more than its noise, and from one
instant to the next by no more than that. Both are compared on a coarse grid, on which noise is small. A
small change that stays, as of a camera that has settled by a pixel, is taken into the untouched image.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from palpate.core import NS_PER_S, Float32, InputError, UInt8, ndarray
from palpate.sensing.untouched_view import MIN_FRAMES, UntouchedView

GRID_PX = 32  # along the longer side
FIRST_FRAMES = 8  # of the untouched sensor
APART_S = 0.25  # between two frames that are compared
TOUCHES = 6.0  # times the noise: a weight lies there
STILL = 2.0  # times the noise: nothing moves
SHARE = 0.15  # of the greatest change that a touch made, below which a still image is the untouched sensor's
MIN_NOISE = 0.05  # grey levels

Coarse = Float32[ndarray, "h w"]


@dataclass(frozen=True, slots=True)
class StillImage:
    """Stretch in which the image of a touched sensor stood still: begin and end [ns]."""

    begins_ns: int
    ends_ns: int

    @property
    def lasts_s(self) -> float:
        """How long it is [s]."""
        return (self.ends_ns - self.begins_ns) / NS_PER_S


class ImagePlateau:
    """Tells from frames whether the sensor is touched, and since when its image stands still.

    Args:
        hold_s: shortest plateau [s].
        region: x, y, width and height of the part that is looked at, such as one between crossed polarisers,
            which nothing in the air lights; all of the image without [px].

    Attributes:
        still: the stretch under way; None while it moves, is untouched, or is not long enough yet.
    """

    def __init__(self, hold_s: float = 0.8, region: tuple[int, int, int, int] | None = None) -> None:
        self._part = (
            np.s_[:, :]
            if region is None
            else np.s_[region[1] : region[1] + region[3], region[0] : region[0] + region[2]]
        )
        self.hold_s = hold_s
        self.touched = False
        self.still: StillImage | None = None
        self._first: list[Coarse] = []
        self._rest: Coarse | None = None
        self._noise = MIN_NOISE
        self._recent: deque[tuple[int, Coarse]] = deque()
        self._since: int | None = None
        self._greatest = 0.0

    @property
    def ready(self) -> bool:
        """Whether the untouched sensor is known."""
        return self._rest is not None

    def take(self, time_ns: int, image: UInt8[ndarray, ...]) -> StillImage | None:
        """Look at the next frame; the plateau that has just ended, where one has."""
        now = coarse(image[self._part])
        if self._rest is None:
            self._learn(now)
            return None
        change = _rms(now, self._rest)
        ended, self.touched = None, change > max(TOUCHES * self._noise, SHARE * self._greatest)
        before = next((g for t, g in self._recent if t <= time_ns - APART_S * NS_PER_S), None)
        self._recent.append((time_ns, now))
        while len(self._recent) > 1 and self._recent[1][0] <= time_ns - APART_S * NS_PER_S:
            self._recent.popleft()
        moves = before is None or _rms(now, before) > STILL * self._noise
        if not self.touched or moves:
            ended = self.still
            self._since, self.still = None, None
            if not moves:
                self._rest = now
            return ended
        self._greatest = max(self._greatest, change)
        self._since = self._since or time_ns
        if time_ns - self._since >= self.hold_s * NS_PER_S:
            self.still = StillImage(self._since, time_ns)
        return None

    def _learn(self, now: Coarse) -> None:
        """The first frames are of the untouched sensor."""
        self._first.append(now)
        if len(self._first) < FIRST_FRAMES:
            return
        stack = np.stack(self._first)
        self._rest = np.median(stack, axis=0)
        pairs = [_rms(a, b) for a, b in pairwise(stack)]
        self._noise = max(MIN_NOISE, float(np.median(pairs)))


def coarse(image: UInt8[ndarray, ...]) -> Coarse:
    """Grey levels on a coarse grid."""
    grey = image if image.ndim == 2 else image.mean(axis=2, dtype=np.float32)
    scale = GRID_PX / max(grey.shape)
    size = max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale))
    return np.asarray(cv2.resize(np.asarray(grey, np.float32), size, interpolation=cv2.INTER_AREA))


def contact_place(
    image: UInt8[ndarray, ...], rests: Sequence[UInt8[ndarray, ...]], region: tuple[int, int, int, int]
) -> tuple[float, float] | None:
    """Centroid of what differs from the untouched sensor within a region, column and row [px].

    Args:
        rests: images of the untouched sensor shortly before, five or more where there are.
        region: x, y, width and height [px].

    Returns:
        None where nothing differs by more than noise does, or the images are not of one kind.
    """
    if not rests:
        return None
    enough = [*rests, *[rests[-1]] * (MIN_FRAMES - len(rests))]
    try:
        seen = UntouchedView(enough, region=region).seen(image)
    except InputError:
        return None
    return None if seen.region is None else seen.region.centre_px


def _rms(one: Coarse, other: Coarse) -> float:
    return float(np.sqrt(np.mean((one - other) ** 2)))
