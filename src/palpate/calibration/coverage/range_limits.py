"""Where a range ends: how far beyond it frames within it are read, which defines extrapolation.

An estimate, and an interval's end, may lie beyond the range as far as is usual for held-out frames within it:
as far as in 97 % of the outermost tenth of them, in 97 % of those in the outermost tenth of the range, or in
99 % of all, whichever is farthest. Where these tenths have too few groups for 97 %, the distance of all rows
beyond their own label counts too.
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
    """How far below and above a range some values of rows within it usually lie, 0 or more.

    Args:
        true: labels of held-out rows.
        low, high: of each row, what is compared with the least and with the greatest of them: its estimate
            twice, or its interval's ends.
        groups: label of each row's group.
        ends: of the calibrated range, of which the rows may not have the very last.
    """
    length = ends[1] - ends[0]
    below = _usual(true - ends[0], ends[0] - low, length, groups)
    above = _usual(ends[1] - true, high - ends[1], length, groups)
    return below, above


def _usual(within: Row, beyond: Row, length: float, groups: np.ndarray) -> float:
    """How far beyond one end values usually lie, 0 or more.

    Args:
        within: how far within that end each row's label lies.
        beyond: how far beyond it its value lies; negative where within.
        length: of the range, in the same unit.
        groups: label of each row's group.
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
    """Each target's card over its range, from held-out outputs; None for a circular one.

    Args:
        intervals: as they were fitted to these.
        outputs: of the model ``[n o]``.
        true: the labels ``[n t]``.
        groups: label of each row's group.
        ranges: least and greatest label of each target, of all rows learnt from.
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
                true[:, j],
                estimate[:, j] - true[:, j],
                inside[:, j],
                groups,
                ranges[j],
                intervals.coverage,
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
