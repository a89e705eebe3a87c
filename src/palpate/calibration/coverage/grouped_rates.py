"""Effective number of independent rows for rates over grouped rows: n over the design effect (L. Kish, Survey
Sampling, 1965). With few groups the correlation is raised towards 1, as if two uniform groups more had
been seen.
"""

from __future__ import annotations

import numpy as np
from scipy.special import betaincinv, stdtrit

from palpate.core import Int

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
