"""Frames of a run that a calibration has learnt from, under whatever name: known by what its guard keeps.

The guard keeps a thumbnail of every recorded frame, or of some 2000 drawn from more. A frame that was learnt
from lies on its own thumbnail. How near another day's frame may come by chance, the kept frames show: each
has a distance to the next. Copies compressed anew lie within 0.6 of it, nine of ten; of frames drawn afresh
along one line or on a plane of likenesses about a half do. Where kept frames look the same themselves, as
of a touch too light to be seen, none is told.
"""

from __future__ import annotations

import numpy as np

from palpate.core import Float, Indices, Values
from palpate.estimators.certified import Estimator, checked_file
from palpate.estimators.guard import NoveltyDetector, thumbnail
from palpate.recordings import Run

MAX_ASKED = 400
"""Frames of a run that are compared; of more, so many evenly spaced in their order."""

MAX_EQUAL = 0.25
"""Share of frames whose thumbnails are kept ones to the last digit, above which the run was learnt from."""

MIN_NEAR, MAX_NEAR = 30, 0.75
"""Number of frames, and share of them nearer to a kept one than that is to the next, above which they are
altered copies."""

NEAR = 0.6
"""How near, over the kept one's distance to the next kept one."""


def find_learnt_frames(estimator: Estimator, run: Run, rows: Indices) -> str:
    """Why a run's frames test nothing new: a sentence, or nothing where they are others.

    Args:
        estimator: the calibration.
        run: the recording.
        rows: of it that show a touch; the untouched sensor looks the same on any day.
    """
    card = estimator.card
    kept = NoveltyDetector.load(checked_file(estimator.folder, card.guard)).neighbours.thumbs
    asked = np.asarray(rows)[np.unique(np.linspace(0, len(rows) - 1, min(MAX_ASKED, len(rows))).astype(int))]
    images = (run.frame(int(row)).image for row in asked)
    thumbs = [
        np.round(thumbnail(card.input.preparation.apply(image))).ravel()
        for image in images
        if image.shape[:2] == card.input.frame_px
    ]
    if len(thumbs) < 2 or len(kept) < 2:
        return ""
    equal, near = shares_of_copies(np.array(thumbs, float), kept.reshape(len(kept), -1).astype(float))
    expected = min(1.0, len(kept) / max(card.run.frames, 1))  # of a run whose thumbnails were drawn from
    if equal > MAX_EQUAL * expected:
        return (
            f"{100 * equal:.0f} % of its frames are, as far as thumbnails tell, the very frames that the "
            "calibration has learnt from, under another name"
        )
    if near > MAX_NEAR and len(thumbs) >= MIN_NEAR:
        return (
            f"{100 * near:.0f} % of its frames are altered copies, such as compressed ones, of frames that "
            "the calibration has learnt from"
        )
    return ""


def shares_of_copies(thumbs: Float[np.ndarray, "n k"], kept: Float[np.ndarray, "m k"]) -> tuple[float, float]:
    """Share of frames that are kept ones, and share of those much nearer to one than it is to the next.

    Args:
        thumbs: of the frames asked about, flat, in whole grey levels.
        kept: those that the calibration knows, two or more.
    """
    nearest = _squares(thumbs, kept).argmin(axis=1)
    apart = np.sqrt(np.mean((thumbs - kept[nearest]) ** 2, axis=1))
    among = _squares(kept[nearest], kept)
    among[np.arange(len(nearest)), nearest] = np.inf
    gap = np.sqrt(np.maximum(among.min(axis=1), 0.0) / thumbs.shape[1])
    told = gap > 1e-3  # else the kept frame has a twin of its own
    return float(np.mean(told & (apart == 0))), float(np.mean(told & (apart <= NEAR * gap)))


def _squares(a: Float[np.ndarray, "n k"], b: Float[np.ndarray, "m k"]) -> Values:
    squares: Values = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return squares
