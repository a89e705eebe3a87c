"""Confusion matrix of rankings, and rank correlation of each ranking with the true order.

Rows and columns all sum to the number of rankings. Cells are not independent: a wrong ranking has at least
two wrong positions.

References: M. G. Kendall, Biometrika 30 (1938) 81, doi:10.1093/biomet/30.1-2.81; C. Spearman, Am. J. Psychol.
15 (1904) 72, doi:10.2307/1412159.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import permutations

import numpy as np
from scipy import stats

from palpate.core import Float, InputError, Int, ndarray
from palpate.psychophysics.judgements import Judgement, Stimulus, Task

MAX_COUNTED_ORDERS = 8  # stimuli of which all orders are counted


@dataclass(frozen=True)
class RankConfusion:
    """Confusion counts of rankings: row of the true position, column of the position given."""

    names: tuple[str, ...]
    counts: Int[ndarray, "rows columns"]

    def __post_init__(self) -> None:
        if self.counts.shape != (len(self.names),) * 2 or len(self.names) < 2 or self.counts.min() < 0:
            raise InputError(
                f"counts of shape {self.counts.shape} for {len(self.names)} stimuli; a square of counts from "
                "0 is needed, two stimuli or more",
                code="matrix-shape",
            )
        rows, columns = self.counts.sum(axis=1), self.counts.sum(axis=0)
        if len({*rows.tolist(), *columns.tolist()}) > 1:
            raise InputError(
                f"rows sum to {', '.join(map(str, rows))} and columns to {', '.join(map(str, columns))}; "
                "rankings give each stimulus one place, so that all of them sum to the number of rankings",
                code="matrix-sums",
            )

    @property
    def rankings(self) -> int:
        """Number of rankings."""
        return int(self.counts[0].sum())

    @property
    def right(self) -> int:
        """Number of right places in all rankings."""
        return int(np.trace(self.counts))

    @property
    def total_accuracy(self) -> float:
        """Share of right places, 0 to 1."""
        return self.right / (self.rankings * len(self.names))

    @property
    def relative_accuracy(self) -> Float[ndarray, " m"]:
        """Share of right places of each stimulus, 0 to 1."""
        return np.asarray(np.diag(self.counts) / self.rankings, np.float64)


def confusion_of_places(names: Sequence[str], places: Int[ndarray, "n m"]) -> RankConfusion:
    """Count the positions (from 0) that each ranking gives to the stimuli in their true order."""
    m = len(names)
    if not len(places) or not (np.sort(places, axis=1) == np.arange(m)).all():
        raise InputError(
            f"a ranking of {m} stimuli gives each of the places 0 to {m - 1} once; one does not",
            code="not-a-permutation",
        )
    counts = np.zeros((m, m), np.int64)
    np.add.at(counts, (np.tile(np.arange(m), len(places)), places.ravel()), 1)
    return RankConfusion(tuple(names), counts)


def places_given(
    judgements: Iterable[Judgement], stimuli: Mapping[str, Stimulus]
) -> tuple[tuple[str, ...], Int[ndarray, "n m"]]:
    """Names in the true order, from the least soft, and the place that each ranking gave them."""
    ranked = [one for one in judgements if one.task is Task.RANK]
    sets = {frozenset(one.presented) for one in ranked}
    if len(sets) != 1:
        raise InputError(
            f"rankings of {len(sets)} different sets of stimuli; a confusion matrix is of one set, give "
            "those of one condition and presentation",
            code="stimuli-differ",
        )
    names = ranked[0].truth(stimuli)
    places = np.array([[one.answer.index(name) for name in names] for one in ranked])
    return names, places


def rank_confusion(judgements: Iterable[Judgement], stimuli: Mapping[str, Stimulus]) -> RankConfusion:
    """Confusion of the rankings among judgements, those of one set of stimuli."""
    return confusion_of_places(*places_given(judgements, stimuli))


@dataclass(frozen=True, slots=True)
class RankCorrelation:
    """Correlation of a ranking with the true order.

    Attributes:
        tau_p: exact two-sided p.
        rho_p: exact two-sided p up to eight stimuli, else by Student's t.
    """

    tau: float
    tau_p: float
    rho: float
    rho_p: float


def rank_correlation(places: Sequence[int] | ndarray) -> RankCorrelation:
    """Correlate the positions given to stimuli, from 0, with their true order.

    Example:
        >>> found = rank_correlation([1, 0, 2, 3, 4])
        >>> round(found.tau, 3), round(found.rho, 3)
        (0.8, 0.9)
    """
    given = np.asarray(places)
    m = len(given)
    if m < 2 or not (np.sort(given) == np.arange(m)).all():
        raise InputError(
            f"places {given.tolist()} are no order; each of 0 to {m - 1} is needed once",
            code="not-a-permutation",
        )
    tau_test = stats.kendalltau(np.arange(m), given, method="exact")
    rho = _rho(given)
    if m > MAX_COUNTED_ORDERS:
        rho_p = float(stats.spearmanr(np.arange(m), given).pvalue)
    else:
        rho_p = float((np.abs(_all_rho(m)) >= abs(rho) - 1e-9).mean())
    return RankCorrelation(float(tau_test.statistic), float(tau_test.pvalue), rho, rho_p)


def _rho(given: Int[ndarray, " m"]) -> float:
    m = len(given)
    return float(1 - 6 * np.sum((given - np.arange(m)) ** 2) / (m * (m**2 - 1)))


@cache
def _all_rho(m: int) -> Float[ndarray, " orders"]:
    orders = np.array(list(permutations(range(m))), np.int64)
    return np.asarray(1 - 6 * ((orders - np.arange(m)) ** 2).sum(axis=1) / (m * (m**2 - 1)), np.float64)
