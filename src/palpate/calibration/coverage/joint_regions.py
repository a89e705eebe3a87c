"""Joint regions of several targets: one ellipsoid that covers all of them at the stated rate, by the second
moments of scaled errors and the conformal quantile of their Mahalanobis distances.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palpate.calibration.coverage.conformal import spread_of_others
from palpate.calibration.coverage.grouped_rates import grouped_coverage_interval
from palpate.calibration.coverage.range_fit import group_parts, grouped_quantile
from palpate.core import Float, Values
from palpate.estimators.intervals import Intervals, component_names, mahalanobis
from palpate.estimators.model_card import VectorCard
from palpate.estimators.target_layout import Outputs

RIDGE = 1e-6  # added to a correlation's diagonal, for components with equal errors
MIN_TRACE = float(np.finfo(np.float32).tiny)  # of errors that are all zero


def vector_cards(
    vectors: Mapping[str, Sequence[str]],
    columns: Sequence[str],
    intervals: Intervals,
    outputs: Outputs,
    true: Values,
    groups: np.ndarray,
) -> tuple[VectorCard, ...]:
    """Return joint regions of vectors, from held-out outputs.

    Args:
        vectors: name of each, quantity_unit, and its targets.
        columns: all targets, in the order of the labels.
        intervals: of the single targets.
        outputs, true: of the model ``[n o]``, and labels ``[n t]``.
    """
    errors = intervals.errors(outputs, true)
    scaled = errors / spread_of_others(outputs, np.abs(errors), groups)
    cards = []
    for name, parts in vectors.items():
        at = [list(columns).index(part) for part in parts]
        correlation, scores = _fitted(scaled[:, at], groups)
        radius = grouped_quantile(scores, groups, intervals.coverage)
        inside = scores <= radius
        low, high = grouped_coverage_interval(inside, groups)
        cards.append(
            VectorCard(
                column=name,
                columns=tuple(parts),
                components=component_names(name, parts),
                correlation=tuple(tuple(map(float, row)) for row in correlation),
                radius=max(radius, float(np.finfo(np.float32).tiny)),
                n=len(true),
                covered=float(inside.mean()),
                low=low,
                high=high,
            )
        )
    return tuple(cards)


def joint_score(
    vector: VectorCard, columns: Sequence[str], errors: Values, spread: Values, groups: np.ndarray
) -> dict[str, Any]:
    """Return rows, covered ratio, and its 95 % interval of a vector's region; label uncertainty is not
    included.

    Args:
        columns: all targets, in the order of the labels.
        errors: estimates less labels ``[n t]``, in the targets' units.
        spread: expected sizes of the errors ``[n t]``.
    """
    at = [list(columns).index(part) for part in vector.columns]
    scaled = errors[:, at] / spread[:, at]
    inside = mahalanobis(scaled, np.array(vector.correlation)) <= vector.radius
    low, high = grouped_coverage_interval(inside, groups)
    return {"n": len(inside), "covered": float(inside.mean()), "low": low, "high": high}


def _fitted(
    scaled: Float[np.ndarray, "n k"], groups: np.ndarray
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " n"]]:
    parts, scores = group_parts(groups), np.empty(len(scaled))
    for part in np.unique(parts):
        held = parts == part
        scores[held] = mahalanobis(scaled[held], _moments(scaled[~held] if not held.all() else scaled))
    return _moments(scaled), scores


def _moments(scaled: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k k"]:
    moments = scaled.T @ scaled / len(scaled)
    return moments + RIDGE * max(float(np.trace(moments)), MIN_TRACE) * np.eye(len(moments))
