"""The guard of an adapted calibration: it knows the frames of both copies, and lets the new one's pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from palpate.core.axes import Indices
from palpate.estimators.guard import Guard, Neighbours, Thumbnails, fit_guard

MOST_THUMBNAILS = 2000
FALSE_ALARMS = 0.005


def guard_with(former: Guard, thumbs: Thumbnails, folds: Sequence[Indices], untouched: Indices) -> Guard:
    """A guard with another copy's frames added; drift is judged by that copy's own untouched frames.

    Args:
        former: of the calibration that is adapted.
        thumbs: thumbnails of all the copy's frames ``[n k]``.
        folds: their rows by press.
        untouched: which rows show the untouched copy; may be none.
    """
    own = fit_guard(thumbs, folds, thumbs[untouched])
    seen, limits = _joined(former, *_at_most(MOST_THUMBNAILS, np.round(thumbs), folds))
    return replace(own, seen=seen, limits=limits)


def _at_most(most: int, thumbs: Thumbnails, folds: Sequence[Indices]) -> tuple[Thumbnails, list[Indices]]:
    """Thumbnails evenly through the run, and their folds."""
    kept = np.unique(np.linspace(0, len(thumbs) - 1, min(most, len(thumbs))).astype(np.int64))
    return thumbs[kept], [np.flatnonzero(np.isin(kept, held)) for held in folds]


def _joined(
    former: Guard, thumbs: Thumbnails, folds: Sequence[Indices]
) -> tuple[Neighbours, Float[np.ndarray, " 2"]]:
    """Both sensors' thumbnails, and limits that let the copy's frames pass as often as the former's did.

    Each of the copy's frames is held against the former calibration and the copy's other presses. The fewer
    presses, the farther is a new one from all of them, and the wider the limits.
    """
    old, every = len(former.seen.thumbs), np.arange(len(thumbs))
    together = np.concatenate([former.seen.thumbs, thumbs])
    own = np.concatenate([former.seen.own, np.zeros(len(thumbs), np.float32)])
    nearest = np.zeros(len(thumbs), np.int64)
    for held in (fold for fold in folds if len(fold)):
        others = np.concatenate([np.arange(old), old + np.setdiff1d(every, held)])
        rows, distance = replace(former.seen, thumbs=together[others]).nearest(thumbs[held])
        nearest[held], own[old + held] = others[rows], np.maximum(distance, np.float32(0.05))
    strangeness = np.stack([own[old:], own[old:] / own[nearest]], axis=1).astype(np.float64)
    limits = np.quantile(strangeness, 1 - FALSE_ALARMS, axis=0, method="higher")
    seen = Neighbours(together, former.seen.stray, own)
    return seen, np.maximum(limits, former.limits)
