"""Flipped pictures: whether the sensor in a frame is mirrored or upside down.

A flip is named only if the no-contact part of the frame fits the reference flipped back, and not as it is; a
touch elsewhere on a symmetric sensor could otherwise resemble a flip.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from palpate.core import Float32

Thumbnail = Float32[np.ndarray, "h w c"]

FLIPPED = "flipped"
# kinds of flip, and the code by which `cv2.flip` takes each back
FLIPS: Mapping[str, int] = {"mirrored-x": 1, "mirrored-y": 0, "rotated-180": -1}
# words for each kind, and for one that several explain, as on a skin that is nearly its own mirror image
MIRRORED: Mapping[str, str] = {
    "mirrored-x": "mirrored, left for right",
    "mirrored-y": "mirrored, upside down",
    "rotated-180": "turned by half a turn",
    FLIPPED: "mirrored or turned by half a turn",
}
# novelty flipped back by the best, over that by the second best, up to which it is told which flip it is
MAX_SECOND = 0.5
# median of how far a picture that is flipped back is from the untouched sensor, over that of it as it is
MAX_FLIPPED_BACK = 0.5
MIN_AWAY_GREY_LEVELS = 2.0  # the latter at least: below, the picture fits the untouched sensor as it is


def flipped(picture: Thumbnail, code: int) -> Thumbnail:
    """Return a picture flipped as `cv2.flip` does: 0 vertically, 1 horizontally, -1 both."""
    rows, columns = (slice(None, None, -1 if code in codes else 1) for codes in ((0, -1), (1, -1)))
    return np.ascontiguousarray(picture[rows, columns])


def unflipped(picture: Thumbnail, untouched: Thumbnail) -> dict[str, Thumbnail]:
    """Return the picture flipped back by each flip that explains its change [gray levels]."""
    away = float(np.median(np.abs(picture - untouched)))
    back = {kind: flipped(picture, code) for kind, code in FLIPS.items()}
    most = MAX_FLIPPED_BACK * away if away >= MIN_AWAY_GREY_LEVELS else -1.0
    return {kind: one for kind, one in back.items() if np.median(np.abs(one - untouched)) <= most}


def told_flip(novelty: Mapping[str, float]) -> str:
    """Return the kind of flip by the relative novelty of the picture flipped back by each, or ""."""
    fit = sorted((value, kind) for kind, value in novelty.items() if value <= 1.0)
    if not fit:
        return ""
    told = len(fit) == 1 or fit[0][0] <= MAX_SECOND * fit[1][0]
    return fit[0][1] if told else FLIPPED
