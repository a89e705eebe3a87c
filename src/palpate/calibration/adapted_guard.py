"""The guard of an adapted calibration: it knows the frames of both copies, and lets the new one's pass."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.core.shapes import Indices
from palpate.estimators.novelty import NoveltyDetector, RenderedImages, Thumbnails, fit_novelty_detector

TOGETHER = 12
"""Frames of the former calibration that are held out together: they lie in the order of its presses."""


def guard_with(
    former: NoveltyDetector, thumbs: Thumbnails, folds: Sequence[Indices], untouched: Indices
) -> NoveltyDetector:
    """A guard with another copy's frames added; drift is judged by that copy's own untouched frames.

    Its limits let the copy's frames pass, each held against the former calibration and the copy's other
    presses. Where the former frames are too unlike the copy's to help, they are left out.

    Args:
        former: of the calibration that is adapted.
        thumbs: thumbnails of all the copy's frames ``[n h w c]``.
        folds: their rows by press.
        untouched: which rows show the untouched copy; may be none.
    """
    known = former.seen.thumbs
    also = RenderedImages(known, np.arange(len(known)) // TOGETHER)
    return fit_novelty_detector(thumbs, folds, thumbs[untouched], also=also)
