"""Labels of a run that say nothing of the model: outside its range, or of other rows than their images."""

from __future__ import annotations

import numpy as np
import pandas as pd

from palpate.core import Values
from palpate.estimators.model_card import Card

MAX_INSIDE = 0.05
"""Share of a target's labels within the calibrated range up to which the run shows nothing of that range."""


def labels_outside(card: Card, true: Values) -> dict[str, str]:
    """Sentences on targets of which hardly any label lies in the calibrated range, by column.

    Args:
        card: of the calibration.
        true: the labels ``[n t]``.
    """
    found = {}
    for target, labels in zip(card.targets, true.T, strict=True):
        room = 0.05 * (target.greatest - target.least)
        inside = (labels >= target.least - room) & (labels <= target.greatest + room)
        if target.circular is None and inside.mean() <= MAX_INSIDE:
            found[target.column] = (
                f"labels of {target.column} run from {labels.min():.4g} to {labels.max():.4g} {target.unit} "
                f"and lie outside what was calibrated ({target.least:.4g} to {target.greatest:.4g} "
                f"{target.unit}): check their unit; these scores say nothing of the model"
            )
    return found


MAX_LAG, SHIFT_GAIN, MIN_ROWS = 5, 0.5, 60
"""Rows by which labels are tried against estimates; squared error over that of their own rows, below which
they are shifted; and how many rows are asked at least."""


def shifted_labels(card: Card, true: Values, table: pd.DataFrame) -> list[str]:
    """A sentence where estimates fit the labels of other rows much better than their own; else none.

    Args:
        card: of the calibration.
        true: the labels ``[n t]``, in the order of recording.
        table: of `predictions`.
    """
    for j, target in enumerate(card.targets):
        estimate, label = table[f"estimate:{target.column}"].to_numpy(float), true[:, j]
        if target.circular is not None or len(label) < MIN_ROWS or not np.ptp(label) > 0:
            continue
        middle = np.arange(MAX_LAG, len(label) - MAX_LAG)
        middle = middle[np.isfinite(estimate[middle])]
        if not len(middle):
            continue
        lags = range(-MAX_LAG, MAX_LAG + 1)
        errors = {lag: float(np.mean((estimate[middle] - label[middle + lag]) ** 2)) for lag in lags}
        best = min(errors, key=lambda lag: errors[lag])
        if best and errors[best] < SHIFT_GAIN * min(errors[0], float(np.var(label))):
            beside = f"row i {'+' if best > 0 else '-'} {abs(best)}"
            share = 100 * errors[best] / errors[0]
            text = (
                f"labels and images look shifted against each other: the estimate of image i fits "
                f"{target.column} of {beside} with {share:.0f} % of the squared error of its own row; check "
                "the order before you trust these scores"
            )
            return [text]
    return []
