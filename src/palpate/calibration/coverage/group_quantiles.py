"""Quantile of scores that a row of a new group stays below, where the errors within a group are correlated:
rank ceil(c (K + 1)) of K groups, averaged over drawings of one score per group in closed form
(`calibration.sessions.session_intervals`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palpate.core import Float, InputError

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
