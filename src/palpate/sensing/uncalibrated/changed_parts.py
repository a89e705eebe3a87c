"""Connected parts of what has changed: which is strong and large enough to be a touch, and its outlines."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from palpate.core import Bool, Float32, Int, UInt8, ndarray

Box = tuple[int, int, int, int]

MIN_PX = 12  # a smaller part is a speck
SECOND = 0.25  # of the largest part: smaller ones are not of the contact


def strongest_part(
    over: Bool[ndarray, "h w"], strong: Bool[ndarray, "h w"], energy: Float32[ndarray, "h w"]
) -> Bool[ndarray, "h w"] | None:
    """Connected part in which the most is strong; the largest where nothing is; None where all are specks.

    Args:
        strong: what of it differs as a touch does; fewer than twelve pixels count for none.
    """
    # The algorithm is named, since the usual one takes longer.
    count, label, boxes, _ = cv2.connectedComponentsWithStatsWithAlgorithm(
        over.view(np.uint8), 8, cv2.CV_32S, cv2.CCL_BBDT
    )
    size = boxes[:, cv2.CC_STAT_AREA].copy()
    size[0] = 0
    if size.max() < MIN_PX:
        return None
    of_strong = label[strong]
    weight = np.bincount(of_strong, energy[strong], count)
    weight[np.bincount(of_strong, minlength=count) < MIN_PX] = 0.0
    weight[0] = 0.0
    best = int(weight.argmax()) if weight.max() > 0 else int(size.argmax())
    return np.asarray(label == best)


def box_of(mask: Bool[ndarray, "h w"], margin: int) -> tuple[slice, slice]:
    """Rows and columns of what is set, with a margin."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(int(rows[0]) - margin, 0), min(int(rows[-1]) + 1 + margin, mask.shape[0])),
        slice(max(int(columns[0]) - margin, 0), min(int(columns[-1]) + 1 + margin, mask.shape[1])),
    )


def large_parts(mask: Bool[ndarray, "h w"]) -> list[Int[ndarray, "p 1 2"]]:
    """Outlines of the large connected parts of a mask."""
    outlines = outlines_of(mask.view(np.uint8))
    areas = np.array([cv2.contourArea(one) for one in outlines])
    large = areas >= SECOND * areas.max(initial=0.0)
    return [one for one, is_large in zip(outlines, large, strict=True) if is_large]


def outlines_of(mask: UInt8[ndarray, "h w"]) -> Sequence[Int[ndarray, "p 1 2"]]:
    """Outer outlines of the connected parts of a mask."""
    return cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]


def disc(radius: int) -> UInt8[ndarray, "h w"]:
    """A disc, for closing gaps."""
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
