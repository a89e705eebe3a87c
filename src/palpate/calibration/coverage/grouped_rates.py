"""Rates and quantiles over grouped rows, whose errors are correlated within a group.

n rows count as n over the design effect (L. Kish, Survey Sampling, 1965); with few groups the correlation is
raised towards 1, as if two uniform groups more had been seen. The quantile that a new group stays below has
rank ceil(c (K + 1)) of K groups, averaged over drawings of one score per group in closed form.

Groups of rows that rates are counted over, since rows of one press or block are not independent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.special import betaincinv, stdtrit

from palpate.core import Float, InputError, Int
from palpate.estimators.model_card import Card
from palpate.recordings.label_tables import own_column
from palpate.recordings.splits import SESSION, within_session

GROUPS_ADDED = 2  # uniform groups; with two, intervals cover 96 % or more of draws, with none 90 %


def within_group_correlation(inside: np.ndarray, groups: np.ndarray) -> float:
    """Return the correlation of two rows of the same group, 0 to 1; 1 for one group or uniform rows.

    Args:
        inside: hits ``[n]``.
        groups: group of each row ``[n]``.
    """
    sizes, index = group_sizes(groups)
    n, rate, most = len(inside), float(inside.mean()), _largest_effect(sizes)
    if most == 1:
        return 0.0
    if len(sizes) == 1 or rate in (0.0, 1.0):
        return 1.0
    sums = np.bincount(index, weights=inside - rate)
    between = float(sums @ sums) * len(sizes) / (len(sizes) - 1) / n**2
    effect = between * n / (rate * (1 - rate))
    return float(np.clip((effect - 1) / (most - 1), 0.0, 1.0))


def cautious_correlation(inside: np.ndarray, groups: np.ndarray) -> float:
    """Return the within-group correlation, raised towards 1 where groups are few."""
    found, count = within_group_correlation(inside, groups), len(np.unique(groups))
    return found + (1 - found) * min(GROUPS_ADDED / count, 1.0)


def effective_rows(groups: np.ndarray, correlation: float) -> float:
    """Return the effective number of independent rows, 1 to n.

    Example:
        >>> effective_rows(np.repeat([0, 1, 2, 3], 10), 1.0), effective_rows(np.repeat([0, 1], 10), 0.0)
        (4.0, 20.0)
    """
    sizes, _ = group_sizes(groups)
    return float(sizes.sum() / (1 + (_largest_effect(sizes) - 1) * correlation))


def rate_interval(hits: float, n: float, confidence: float) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a rate, continued to fractional numbers.

    Example:
        >>> low, high = rate_interval(9, 10, 0.95)
        >>> round(low, 4), round(high, 4)
        (0.555, 0.9975)
    """
    tail, misses = (1 - confidence) / 2, n - hits
    low = float(betaincinv(hits, misses + 1, tail)) if hits > 0 else 0.0
    high = float(betaincinv(hits + 1, misses, 1 - tail)) if misses > 0 else 1.0
    return low, high


CONFIDENCE = 0.95


def coverage_interval(hits: int, n: int) -> tuple[float, float]:
    """Return the 95 % Clopper-Pearson interval of `hits` of `n` independent rows."""
    return rate_interval(hits, n, CONFIDENCE)


def grouped_coverage_interval(inside: np.ndarray, groups: np.ndarray) -> tuple[float, float]:
    """Return the 95 % Clopper-Pearson interval of a rate by the effective number of rows (E. Korn and B.
    Graubard, Survey Methodology 24, 193 (1998)).
    """
    n = effective_rows(groups, cautious_correlation(inside, groups))
    return rate_interval(float(inside.mean()) * n, n, CONFIDENCE)


MIN_GROUPS_OF_MEAN = 3  # for an interval of a mean


def grouped_mean_interval(values: np.ndarray, groups: np.ndarray) -> tuple[float, float] | None:
    """Return the 95 % interval of a mean over groups; None for fewer than 3 groups.

    Student's, around the cluster-robust standard error (K.-Y. Liang and S. Zeger, Biometrika 73, 13 (1986),
    doi:10.1093/biomet/73.1.13).
    """
    sizes, index = group_sizes(groups)
    count, mean = len(sizes), float(values.mean())
    if count < MIN_GROUPS_OF_MEAN:
        return None
    sums = np.bincount(index, weights=values - mean)
    error = float(np.sqrt(sums @ sums * count / (count - 1))) / len(values)
    half = float(stdtrit(count - 1, (1 + CONFIDENCE) / 2)) * error
    return mean - half, mean + half


def group_sizes(groups: np.ndarray) -> tuple[Int[np.ndarray, " g"], Int[np.ndarray, " n"]]:
    """Return the rows of each group, and the number of each row's group."""
    _, index = np.unique(groups, return_inverse=True)
    return np.bincount(index), index


def _largest_effect(sizes: Int[np.ndarray, " g"]) -> float:
    """Design effect of groups whose rows all agree: the mean size of the group that a row is in."""
    return float(sizes @ sizes / sizes.sum())


MAX_GROUPS_TO_DRAW = 200  # beyond, mean over drawings and weighted quantile agree within a row
POINTS_AT_ONCE = 4096


def rank_of_new_group(groups: int, coverage: float) -> int:
    """Return ceil(c (K + 1)) of K groups at coverage c; more than K where so few cannot promise it.

    Example:
        >>> rank_of_new_group(9, 0.9), rank_of_new_group(8, 0.9), rank_of_new_group(20, 0.9)
        (9, 9, 19)
    """
    return math.ceil(coverage * (groups + 1) - 1e-9)


def is_distribution_free(groups: int, coverage: float) -> bool:
    """Return whether so many groups can promise a new one's coverage without assumptions."""
    return rank_of_new_group(groups, coverage) <= groups


def new_group_quantile(scores: Float[np.ndarray, " n"], groups: np.ndarray, coverage: float) -> float:
    """Return the score that one of a new group stays below with this probability.

    Args:
        scores: absolute scores.
        groups: group of each row ``[n]``.
        coverage: 0 to 1.
    """
    names, of = np.unique(groups, return_inverse=True)
    count, rank = len(names), rank_of_new_group(len(names), coverage)
    if rank > count:
        least = math.ceil(coverage / (1 - coverage) - 1e-9)
        raise InputError(
            f"{count} groups cannot set an interval that holds {100 * coverage:g} % of a new one's rows "
            f"whatever the distribution; give {least} or more",
            code="few-groups",
        )
    if count == len(scores):
        return float(np.sort(scores)[rank - 1])
    if count > MAX_GROUPS_TO_DRAW:
        return weighted_quantile(scores, of, min(coverage * (count + 1) / count, 1.0))
    points = np.sort(scores)
    parts = [np.sort(scores[of == k]) for k in range(count)]
    at_most = np.concatenate(
        [
            _rank_reached(points[i : i + POINTS_AT_ONCE], parts, rank)
            for i in range(0, len(points), POINTS_AT_ONCE)
        ]
    )
    return max(float(points @ np.diff(at_most, prepend=0.0)), weighted_quantile(scores, of, coverage))


def _rank_reached(points: np.ndarray, parts: Sequence[np.ndarray], rank: int) -> np.ndarray:
    """Probability that of one score from each part at least `rank` are at or below each point ``[p]``."""
    below = np.zeros((len(parts) + 1, len(points)))  # how many of the parts so far are: a Poisson binomial
    below[0] = 1.0
    for part in parts:
        share = np.searchsorted(part, points, side="right") / len(part)
        below[1:] = below[1:] * (1 - share) + below[:-1] * share
        below[0] *= 1 - share
    return np.asarray(below[rank:].sum(axis=0))


def weighted_quantile(scores: Float[np.ndarray, " n"], groups: np.ndarray, level: float) -> float:
    """Return the quantile of scores with the same weight for each group.

    Args:
        groups: number of each row's group ``[n]``, 0, 1, 2, and so on.
        level: 0 to 1.
    """
    order, weights = np.argsort(scores), 1.0 / np.bincount(groups)[groups]
    reached = np.cumsum(weights[order]) / weights.sum()
    return float(scores[order][min(int(np.searchsorted(reached, level - 1e-12)), len(scores) - 1)])


def groups_in(table: pd.DataFrame, columns: tuple[str, ...]) -> np.ndarray:
    """Return a label of each row's group; each row its own where a column is missing."""
    columns = tuple(name for name in columns if name != SESSION or name in table or len(columns) == 1)
    if not columns or not set(columns) <= set(table):
        return np.arange(len(table))
    return table.groupby(list(columns), sort=False, dropna=False).ngroup().to_numpy()


PRESS_COLUMNS = ("press", "cycle", "trial")


def press_groups(table: pd.DataFrame) -> np.ndarray:
    """Return a label of each row's press within one group, as a session; each row its own without presses."""
    named = press_column(table)
    return np.arange(len(table)) if named is None else groups_in(table, within_session(table, (named,)))


def press_column(table: pd.DataFrame) -> str | None:
    """Return the column that names the press; None where there is none."""
    return next((column for column in PRESS_COLUMNS if column in table), None)


ROW, BLOCK = "row", "held-out block"


def counted_groups(card: Card, table: pd.DataFrame) -> tuple[np.ndarray, str]:
    """Return a label of each row's group, and the kind of group.

    Groups are by the columns that the calibration was split by, where the table has them; else by the press;
    each row is its own only where no press is named.
    """
    columns = tuple(c for c in card.split.columns if c != SESSION or c in table)
    if columns and set(columns) <= set(table):
        return groups_in(table, columns), "/".join(columns)
    return press_groups(table), press_column(table) or ROW


def held_out_groups(card: Card, table: pd.DataFrame) -> tuple[np.ndarray, str]:
    """Return groups of a calibration's own held-out rows, as `counted_groups`; blocks where blocks were held
    out.
    """
    length = card.split.block_rows
    if card.split.columns or card.interval_reset or length is None:
        return counted_groups(card, table)
    return _held_out_blocks(length, table), BLOCK


def _held_out_blocks(length: int, table: pd.DataFrame) -> np.ndarray:
    """Number of each row's block: a fold's stretches of rows without a gap, cut after each block's length."""
    rows, folds = (own_column(table, name).to_numpy(np.int64) for name in ("row", "held_out_in_fold"))
    sessions = groups_in(table, (SESSION,)) if SESSION in table else np.zeros(len(table), np.int64)
    order, place = np.argsort(rows), np.arange(len(table))
    begins = np.append(True, np.diff(rows[order]) > 1)[: len(table)]
    for part in (folds, sessions):
        begins[1:] |= np.diff(part[order]) != 0
    numbers = np.empty(len(table), np.int64)
    first = np.maximum.accumulate(np.where(begins, place, 0))
    numbers[order] = np.cumsum((place - first) % length == 0) - 1
    return numbers


def counted_text(count: int, by: str) -> str:
    """Return the number of groups in words.

    Example:
        >>> counted_text(9, "held-out block"), counted_text(16, "press"), counted_text(80, "row")
        ('9 held-out blocks', '16 groups of press', '80 rows, each its own group')
    """
    if by == ROW:
        return f"{count} rows, each its own group"
    return f"{count} {BLOCK}s" if by == BLOCK else f"{count} groups of {by}"
