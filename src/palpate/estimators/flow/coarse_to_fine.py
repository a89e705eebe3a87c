"""Horn and Schunck's flow for large motion: from a coarse image to the fine one, warping as it goes.

Brightness is linear between two images only for motion of about a pixel. On an image shrunk to a few pixels
all motion is that small; each finer image is then first warped by the flow found so far, so that only the
remainder must be found. Smoothness is asked of the whole flow, not of the remainder: with (u0, v0) the flow
that warped, E_x (u - u0) + E_y (v - v0) + E_t = 0. Between warps a median takes out what single pixels claim.

Reference, for warps and median: D. Sun, S. Roth, M. J. Black, A quantitative analysis of current practices in
optical flow estimation, IJCV 106 (2014) 115, doi:10.1007/s11263-013-0644-x.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from palpate.core import Float32, RangeError, ndarray
from palpate.estimators.flow.horn_schunck import FlowField, Grey, HornSchunck, brightness, check_pair, flow

WARPED = HornSchunck(alpha=0.03, iterations=40)  # smoothness for images that are nearly alike

Levels = Float32[ndarray, "_ _"]  # of any size: each level has its own


@dataclass(frozen=True)
class CoarseToFine:
    """Settings.

    Attributes:
        horn_schunck: of every warp on every level.
        shrink: each coarser image's size over that of the finer.
        smallest_px: the coarsest image is at least as high and wide.
        warps: on each level.
        median_px: width of the median of the flow between warps, 3 or 5; 1 for none.
    """

    horn_schunck: HornSchunck = WARPED
    shrink: float = 0.5
    smallest_px: int = 16
    warps: int = 10
    median_px: int = 5

    def __post_init__(self) -> None:
        if not 0.3 <= self.shrink <= 0.9:
            raise RangeError(f"each level is {self.shrink} times the finer one; 0.3 to 0.9, 0.5 if in doubt")
        if self.smallest_px < 8 or self.warps < 1:
            raise RangeError(
                f"{self.warps} warps, coarsest image {self.smallest_px} px; 1 or more, 8 px or more"
            )
        if self.median_px not in (1, 3, 5):
            raise RangeError(f"a median {self.median_px} px wide; 1 (none), 3 or 5")


def coarse_to_fine(first: Grey, second: Grey, settings: CoarseToFine | None = None) -> FlowField:
    """Flow from the first image to the second [px/frame], of many pixels if need be. Refuses as `flow`."""
    settings = settings or CoarseToFine()
    first, second = np.asarray(first), np.asarray(second)
    check_pair(first, second)
    levels = _pyramid(first, second, settings)
    estimate = np.zeros((2, *levels[-1][0].shape), np.float32)
    for a, b in reversed(levels):
        estimate = _enlarged(estimate, a.shape)
        for _ in range(settings.warps):
            estimate = _refined(a, b, estimate, settings)
    return estimate


def _pyramid(first: Grey, second: Grey, settings: CoarseToFine) -> list[tuple[Levels, Levels]]:
    """The pair at every size, finest first."""
    pair = [brightness(image).astype(np.float32) for image in (first, second)]
    levels = [(pair[0], pair[1])]
    sigma = 0.5 / settings.shrink  # of a blur that leaves little above the coarser image's resolution
    while min(levels[-1][0].shape) * settings.shrink >= settings.smallest_px:
        h, w = (round(settings.shrink * n) for n in levels[-1][0].shape)
        a, b = (
            cv2.resize(cv2.GaussianBlur(x, (0, 0), sigma), (w, h), interpolation=cv2.INTER_LINEAR)
            for x in levels[-1]
        )
        levels.append((a, b))
    return levels


def _enlarged(coarse: Float32[ndarray, "2 _ _"], shape: tuple[int, ...]) -> FlowField:
    """A flow on a finer image, in its pixels."""
    h, w = shape
    per_axis = (w / coarse.shape[2], h / coarse.shape[1])
    return np.stack(
        [cv2.resize(part, (w, h)) * np.float32(k) for part, k in zip(coarse, per_axis, strict=True)]
    )


def _refined(a: Levels, b: Levels, estimate: FlowField, settings: CoarseToFine) -> FlowField:
    """The flow after one warp of the second image by it."""
    h, w = a.shape
    y, x = np.mgrid[:h, :w].astype(np.float32)
    at_x, at_y = x + estimate[0], y + estimate[1]
    warped = cv2.remap(b, at_x, at_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE).clip(0, 1)
    inside = (at_x >= 0) & (at_x <= w - 1) & (at_y >= 0) & (at_y <= h - 1)
    estimate = flow(a, warped, settings.horn_schunck, about=estimate, mask=inside)
    if settings.median_px == 1:
        return estimate
    return np.stack([cv2.medianBlur(part, settings.median_px) for part in estimate])
