"""What lies still around a skin: tells a camera that has moved, or another light, from a touch."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from palpate.core import Bool, Shaped, UInt8, ndarray

LOOKED_AT_PX = 640  # about the longer side of what is looked at: larger frames are averaged to it
MEAN_OF_THREE = np.full((1, 3), 1 / 3)
MAX_SHIFT_PX = 0.5  # of what lies still beside the skin
MIN_EXPLAINED = 0.5  # of the rim's difference, by a shift
MIN_SLOPE = 4.0  # grey levels a pixel: an edge
MIN_EDGE_PX = 200
MAX_CONDITION = 100.0  # of the edges' normal matrix: edges of both directions
EVERY_STILL = 16  # pixel of what lies still is looked at
RIM = 0.06  # of each side of the frame: what is taken to lie still
STILL_NOISES = 5.0  # by which what lies still differs, where it does
MIN_LIT = 8.0  # grey levels: darker pixels tell nothing of a change of brightness
MIN_LIT_PX = 12

Box = tuple[int, int, int, int]


class StillSurround:
    """What lies beside the skin, and along the sides of the frame.

    Args:
        frames: 8-bit grey or RGB, of the untouched sensor.
        region: x, y, width and height of the skin [px].
    """

    def __init__(self, frames: Sequence[Shaped[ndarray, ...]], region: Box) -> None:
        height, width = frames[0].shape[:2]
        self._size = (width, height)
        self._times = max(1, round(max(self._size) / LOOKED_AT_PX))
        grey = np.stack([self._grey(frame) for frame in frames]).astype(np.float32)
        mean = grey.mean(axis=0)
        x, y, wide, high = (round(value / self._times) for value in region)
        still = _outside((x, y, wide, high), mean.shape)
        smooth = cv2.GaussianBlur(mean, (0, 0), 1.0)
        slope_x = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
        slope_y = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
        edges = still & (np.hypot(slope_x, slope_y) > MIN_SLOPE)
        self._edges = np.nonzero(edges)
        self._slope = np.stack([slope_x[edges], slope_y[edges]], axis=1).astype(np.float64)
        self._level = mean[edges]
        normal = self._slope.T @ self._slope
        told = len(self._slope) >= MIN_EDGE_PX and np.linalg.cond(normal) < MAX_CONDITION
        self._inverse = np.linalg.inv(normal) if told else None
        self._even = tuple(a[::EVERY_STILL] for a in np.nonzero(still))
        self._even_level = mean[self._even]
        spread = float(
            np.sqrt(np.mean(grey.std(axis=0)[self._even] ** 2 * (len(frames) / (len(frames) - 1))))
        )
        self._limit = STILL_NOISES * max(spread, 1.0)

    def shift(self, image: Shaped[ndarray, ...], gain: float) -> tuple[float, float] | None:
        """Shift of what lies still; None where there is none, or none can be told.

        Returns:
            To the right and downwards [px].
        """
        if self._inverse is None:
            return None
        apart = self._grey(image)[self._edges] / gain - self._level
        moved = -self._inverse @ (self._slope.T @ apart)
        left = apart + self._slope @ moved
        explained = float(left @ left) < (1 - MIN_EXPLAINED) * float(apart @ apart)
        if not explained or np.hypot(*moved) < MAX_SHIFT_PX:
            return None
        return self._times * float(moved[0]), self._times * float(moved[1])

    def changed_share(self, image: Shaped[ndarray, ...]) -> float:
        """Share of what lies still that differs from the reference, by more than its brightness."""
        now, then = self._grey(image)[self._even].astype(np.float64), self._even_level
        lit = then > MIN_LIT
        gain = float(np.median(now[lit] / then[lit])) if lit.sum() > MIN_LIT_PX else 1.0
        apart = now / gain - then
        return float(np.mean(np.abs(apart) > self._limit))

    def _grey(self, image: Shaped[ndarray, ...]) -> UInt8[ndarray, "h w"]:
        """The frame in grey, and a large one made smaller."""
        if self._times > 1:
            small = (self._size[0] // self._times, self._size[1] // self._times)
            image = cv2.resize(image, small, interpolation=cv2.INTER_AREA)
        return image if image.ndim == 2 else cv2.transform(image, MEAN_OF_THREE).reshape(image.shape[:2])


def _outside(region: Box, shape: tuple[int, ...]) -> Bool[ndarray, "h w"]:
    """Pixels beside the skin, and along the sides of the frame."""
    height, width = shape
    x, y, wide, high = region
    edge_x, edge_y = round(RIM * width), round(RIM * height)
    still = np.ones(shape, bool)
    rows = slice(max(y, edge_y), min(y + high, height - edge_y))
    still[rows, max(x, edge_x) : min(x + wide, width - edge_x)] = False
    return still
