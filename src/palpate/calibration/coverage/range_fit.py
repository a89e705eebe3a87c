"""Intervals that keep their rate over the whole range, from held-out errors.

Tenths of the range are joined until each cell has `MIN_GROUPS` groups. Where one width covers too few rows of
a cell, its band is the inner 90 % of scaled errors, rescaled by the cell's conformal quantile (V. Vovk, Ann.
Math. Artif. Intell. 74:9 (2015), doi:10.1007/s10472-013-9368-4; Y. Romano, E. Patterson and E. Candès,
NeurIPS 2019).
"""

from __future__ import annotations

import numpy as np

from palpate.calibration.coverage.grouped_rates import group_sizes, weighted_quantile
from palpate.core import Float, Int
from palpate.estimators.intervals import ErrorCells, RangeIntervals, Row

TENTHS = 10
MIN_GROUPS = 25  # per cell; its kept rate scatters by sqrt(0.9 · 0.1 / groups), 6 % with 25
MIN_ROWS = 60  # per cell, so that three or more lie beyond each quantile of a band
MAX_LEVEL = 1.0


def fit_range_intervals(
    estimate: Row, true: Row, spread: Row, quantile: float, groups: np.ndarray, coverage: float
) -> RangeIntervals | None:
    """Return bands of one target in the cells where one width covers too seldom; None where no cell needs
    one.

    Args:
        estimate, true: held-out estimates and labels, in the target's unit.
        spread: expected size of each row's error, fitted without its group.
        quantile: half-width of the interval of one width, in units of the spread.
    """
    ends = float(true.min()), float(true.max())
    by_truth, by_estimate = (cell_limits(values, groups, *ends) for values in (true, estimate))
    if not len(by_truth):
        return None
    half, error, parts = quantile * spread, (true - estimate) / spread, group_parts(groups)
    none = ErrorCells(np.empty(0), np.zeros(1), np.zeros(1))
    low, high = estimate - half, estimate + half
    first = _bands(by_truth, true, error, groups, parts, coverage, (low <= true) & (true <= high))
    low, high = RangeIntervals(first, none).ends(estimate, spread, half)
    second = _bands(by_estimate, estimate, error, groups, parts, coverage, (low <= true) & (true <= high))
    if not first.half.any() and not second.half.any():
        return None
    return RangeIntervals(first, second)


def cell_limits(values: Row, groups: np.ndarray, least: float, greatest: float) -> Float[np.ndarray, " k"]:
    """Return the limits between tenths of the range that leave each cell enough groups."""
    kept: list[float] = []
    start = -np.inf
    for limit in np.linspace(least, greatest, TENTHS + 1)[1:-1]:
        if _holds_enough(values, groups, start, limit):
            kept.append(float(limit))
            start = limit
    while kept and not _holds_enough(values, groups, kept[-1], np.inf):
        kept.pop()
    return np.array(kept)


def group_parts(groups: np.ndarray) -> Int[np.ndarray, " n"]:
    """Return the number of each row's part, at most five, groups kept whole."""
    # Here, since whoever reads an interval needs no scikit-learn.
    from sklearn.model_selection import GroupKFold

    part = np.zeros(len(groups), np.int64)
    count = min(5, len(np.unique(groups)))
    for k, (_, held) in enumerate(GroupKFold(count).split(part, groups=groups) if count > 1 else ()):
        part[held] = k
    return part


def grouped_quantile(scores: Row, groups: np.ndarray, coverage: float) -> float:
    """Return the score below which a row of a new group lies with probability `coverage`.

    Groups have equal weight; the level is coverage (G + 1) / G of G groups (R. Dunn, L. Wasserman and A.
    Ramdas, J. Am. Stat. Assoc. 118, 2491 (2023), doi:10.1080/01621459.2022.2060112).
    """
    n, sizes, index = len(scores), *group_sizes(groups)
    g = len(sizes)
    level = min(coverage * (g + 1) / g, MAX_LEVEL)
    if (sizes != sizes[0]).any():
        return weighted_quantile(scores, index, level)
    rank = min(int(np.ceil(n * level - 1e-9)), n)
    return float(np.sort(scores)[rank - 1])


def _holds_enough(values: Row, groups: np.ndarray, start: float, end: float) -> bool:
    rows = (values >= start) & (values < end)
    return int(rows.sum()) >= MIN_ROWS and len(np.unique(groups[rows])) >= MIN_GROUPS


def _bands(
    limits: Float[np.ndarray, " k"],
    values: Row,
    error: Row,
    groups: np.ndarray,
    parts: Int[np.ndarray, " n"],
    coverage: float,
    held: np.ndarray,
) -> ErrorCells:
    """Bands of the errors in the cells of some values; rows that are `held` need none."""
    cells = np.searchsorted(limits, values, side="right")
    centre, half = np.zeros((2, len(limits) + 1))
    for cell in range(len(limits) + 1):
        rows = cells == cell
        middle, reach = _middle(error[rows], coverage)
        scores = _scores(error[rows], parts[rows], coverage)
        factor = grouped_quantile(np.where(held[rows], 0.0, scores), groups[rows], coverage)
        centre[cell], half[cell] = middle, factor * reach
    return ErrorCells(limits, centre, half)


def _scores(error: Row, parts: Int[np.ndarray, " n"], coverage: float) -> Row:
    scores = np.empty_like(error)
    for part in np.unique(parts):
        held = parts == part
        middle, reach = _middle(error[~held] if not held.all() else error, coverage)
        scores[held] = np.abs(error[held] - middle) / reach
    return scores


def _middle(error: Row, coverage: float) -> tuple[float, float]:
    """Middle and half the length of the range that holds the inner share `coverage` of the errors."""
    low, high = np.quantile(error, [(1 - coverage) / 2, (1 + coverage) / 2])
    return float(low + high) / 2, max(float(high - low) / 2, float(np.finfo(np.float32).tiny))
