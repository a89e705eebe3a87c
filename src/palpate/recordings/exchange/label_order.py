"""Whether rows of labels stand beside their own images, or are shifted against them by some rows.

From one image to the next, picture and label change together. A linear map from the change of a small picture
to the change of a label is fitted on half of the rows and scored on the other, once with the rows as they
stand and once shifted by a few; where a shift explains much more, the rows are off by it. Changes rather than
values, since a label that goes up and down slowly looks alike a row later.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from palpate.core import Float, Image, Values

THUMBNAIL_PX = 16
MAX_SHIFT = 5
MIN_ROWS = 60
MIN_GAIN, GAIN_BY_CHANCE = 0.1, 2.5
"""Share of the labels' changes that the best shift explains beyond what no shift does, at least; and what
chance may add to it, times the root of the rows (of 4,000 recordings without a shift none came so far)."""
_COMPONENTS = 12
_BLOCKS = 8


def small_picture(image: Image) -> Float[np.ndarray, " k"]:
    """Area means of an image in grey, as one row of numbers."""
    grey = image if image.ndim == 2 else image.mean(axis=2)
    size = (min(THUMBNAIL_PX, grey.shape[1]), min(THUMBNAIL_PX, grey.shape[0]))
    return cv2.resize(grey.astype(np.float32), size, interpolation=cv2.INTER_AREA).astype(float).ravel()


def explained_by_shift(pictures: Float[np.ndarray, "n k"], labels: Values) -> dict[int, float]:
    """Share of the labels' changes that the pictures' changes explain, by shift of the rows.

    Args:
        pictures: of the images in their order.
        labels: ``[n t]`` numbers of the rows in their order.

    Returns:
        Shift -> best share over the labels, out of sample; at shift ``s`` row ``i + s`` stands beside image
        ``i``.
    """
    change = np.diff(pictures, axis=0)
    change = change - change.mean(axis=0)
    _, size, axes = np.linalg.svd(change, full_matrices=False)
    kept = axes[: min(_COMPONENTS, int((size > 1e-9 * size[0]).sum()))] if size[0] > 0 else axes[:0]
    seen, moved = change @ kept.T, np.diff(labels, axis=0)
    shares = {}
    for shift in range(-MAX_SHIFT, MAX_SHIFT + 1):
        begin, end = max(0, -shift), len(seen) - max(0, shift)
        shares[shift] = _share(seen[begin:end], moved[begin + shift : end + shift])
    return shares


def _share(seen: np.ndarray, moved: np.ndarray) -> float:
    """Largest share of variance over the labels, each half of the blocks predicted from the other."""
    half = np.arange(len(seen)) * _BLOCKS // len(seen) % 2
    error, total = np.zeros(moved.shape[1]), np.zeros(moved.shape[1])
    for k in (0, 1):
        fitted, scored = half != k, half == k
        terms = np.column_stack([np.ones(len(seen)), seen])
        weights = np.linalg.lstsq(terms[fitted], moved[fitted], rcond=None)[0]
        error += np.sum((moved[scored] - terms[scored] @ weights) ** 2, axis=0)
        total += np.sum((moved[scored] - moved[fitted].mean(axis=0)) ** 2, axis=0)
    return float(np.max(1 - error / np.where(total > 0, total, np.inf), where=total > 0, initial=0.0))


def shift_doubt(pictures: Iterable[np.ndarray], labels: Values) -> str:
    """A sentence where the rows seem shifted against the images; empty where not, or where rows are few.

    Args:
        pictures: of the images in their order, see `small_picture`.
        labels: ``[n t]`` numbers of the rows in their order.
    """
    rows = np.stack(list(pictures))
    if len(rows) < MIN_ROWS or not labels.shape[1]:
        return ""
    shares = explained_by_shift(rows, labels)
    if not np.isfinite(list(shares.values())).all():  # numbers too large to be squared
        return ""
    best = max(shares, key=lambda shift: shares[shift])
    if best == 0 or shares[best] - max(shares[0], 0.0) < MIN_GAIN + GAIN_BY_CHANCE / len(rows) ** 0.5:
        return ""
    beside = f"row i + {best}" if best > 0 else f"row i - {-best}"
    return (
        f"labels and images look shifted against each other: with {beside} beside image i the pictures "
        f"explain {100 * shares[best]:.0f} % of a label's changes, as they stand {100 * shares[0]:.0f} %; "
        "check the order before you calibrate"
    )
