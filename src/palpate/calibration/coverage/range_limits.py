"""Limits of a range: how far beyond it frames within it are read, which defines extrapolation.

The limit is the farthest of: 97 % of the outermost tenth of held-out frames, 97 % of those in the outermost
tenth of the range, and 99 % of all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.calibration.coverage.group_quantiles import is_distribution_free
from palpate.calibration.coverage.range_fit import grouped_quantile
from palpate.calibration.coverage.range_scores import range_scores
from palpate.core import Values
from palpate.estimators.intervals import ErrorCells, Intervals, Row
from palpate.estimators.model_card import CellsCard, RangeCard
from palpate.estimators.target_layout import Outputs

USUAL_AT_THE_END, USUAL = 0.97, 0.99
OUTER_SHARE, MIN_OUTER_ROWS = 0.1, 20


def usual_reach(
    true: Row, low: Row, high: Row, groups: np.ndarray, ends: tuple[float, float]
) -> tuple[float, float]:
    """Return how far below and above a range values of rows within it usually lie, 0 or more.

    Args:
        true: labels of held-out rows.
        low, high: values compared with the least and with the greatest label: the estimate twice, or the
            interval's ends.
        ends: of the calibrated range.
    """
    length = ends[1] - ends[0]
    below = _usual(true - ends[0], ends[0] - low, length, groups)
    above = _usual(ends[1] - true, high - ends[1], length, groups)
    return below, above


def _usual(within: Row, beyond: Row, length: float, groups: np.ndarray) -> float:
    """Distance beyond one end at which values usually lie.

    Args:
        within: distance of each label within that end.
        beyond: distance of its value beyond it; negative where within.
        length: of the range.
    """
    count = min(max(int(OUTER_SHARE * len(within)), MIN_OUTER_ROWS), len(within))
    tenths = np.argsort(within, kind="stable")[:count], np.flatnonzero(within <= OUTER_SHARE * length)
    found = [0.0, grouped_quantile(beyond, groups, USUAL)]
    found += [grouped_quantile(beyond[rows], groups[rows], USUAL_AT_THE_END) for rows in tenths if len(rows)]
    if not all(is_distribution_free(len(np.unique(groups[rows])), USUAL_AT_THE_END) for rows in tenths):
        found.append(grouped_quantile(within + beyond, groups, USUAL_AT_THE_END))
    return max(found)


def range_cards(
    intervals: Intervals,
    outputs: Outputs,
    true: Values,
    groups: np.ndarray,
    ranges: Sequence[tuple[float, float]],
) -> Sequence[RangeCard | None]:
    """Return each target's card over its range, from held-out outputs; None for a circular one.

    Args:
        outputs, true: of the model ``[n o]``, and labels ``[n t]``.
        ranges: least and greatest label of each target in all training rows.
    """
    layout = intervals.layout
    estimate = outputs if layout is None else layout.decoded(outputs)
    low, high = intervals.ends(outputs)
    inside = intervals.hold(outputs, true)
    return [
        None
        if layout is not None and layout.periods[j] is not None
        else RangeCard(
            by_truth=_cells_card(intervals, j, "by_truth"),
            by_estimate=_cells_card(intervals, j, "by_estimate"),
            beyond=usual_reach(true[:, j], estimate[:, j], estimate[:, j], groups, ranges[j]),
            reach=usual_reach(true[:, j], low[:, j], high[:, j], groups, ranges[j]),
            tenths=range_scores(
                true[:, j], estimate[:, j] - true[:, j], inside[:, j], groups, ranges[j], intervals.coverage
            ),
        )
        for j in range(true.shape[1])
    ]


def _cells_card(intervals: Intervals, j: int, which: str) -> CellsCard | None:
    one = intervals.by_range[j] if intervals.by_range else None
    if one is None:
        return None
    cells: ErrorCells = getattr(one, which)
    plain = {name: tuple(map(float, getattr(cells, name))) for name in ("limits", "centre", "half")}
    return CellsCard(**plain)
