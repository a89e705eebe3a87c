"""Targets that a model tells, from what it gave for rows held out, before there is a card that says so."""

from __future__ import annotations

import numpy as np

from palpate.calibration.coverage.circular_scores import (
    calibrated_arc,
    mean_of,
    shortest,
    uninformative_width,
)
from palpate.core import Bool, Float, Values
from palpate.estimators.model_card import NO_BETTER
from palpate.estimators.target_layout import Outputs, TargetLayout


def told_targets(
    held_out: Outputs,
    true: Values,
    learnt: Float[np.ndarray, "m t"],
    widths: Values,
    layout: TargetLayout,
    coverage: float,
) -> Bool[np.ndarray, " t"]:
    """Tell which targets beat always saying the mean, with intervals that are shorter than their range.

    It is the rule of `TargetCard.is_read`, but that the mean is one of all rows.

    Args:
        held_out: outputs ``[n o]`` for rows that the model had not learnt from.
        true: their labels ``[n t]``.
        learnt: the labels of all rows ``[m t]``.
        widths: of the rows' intervals ``[n t]``.
        layout: of the targets in the outputs.
        coverage: what the intervals promise.
    """
    error = np.abs(layout.differences(layout.decoded(held_out), true)).mean(axis=0)
    told = [
        error[j] <= NO_BETTER * np.abs(shortest(true[:, j] - mean_of(learnt[:, j], period), period)).mean()
        and widths[:, j].mean() < _untold(learnt[:, j], widths[:, j], period, coverage)
        for j, period in enumerate(layout.periods)
    ]
    return np.array(told, bool)


def _untold(learnt: np.ndarray, widths: np.ndarray, period: float | None, coverage: float) -> float:
    """Width from which on an interval tells nothing."""
    if period is None:
        return float(np.ptp(learnt))
    least, greatest = calibrated_arc(learnt, period)
    return uninformative_width(widths, greatest - least, coverage)
