"""Rank observers fitted to confusion matrices of rankings.

A published matrix tells no single ranking, so the likelihood is composite: each row is taken as a multinomial
count of its own, which gives consistent values. What it leaves out, that a ranking fills all rows at once, is
put back where it matters: intervals and tests are of simulated rankings, fitted again (parametric bootstrap).
What differs between participants is not in a published matrix, and so not in these intervals: they are too
short where people differ.

`sensitivity_at` needs no likelihood: the d' at which an observer without faults is right as often. A few wild
rankings pull the likelihood of such an observer down to a d' that no other cell bears out; so both are given.

Reference: C. Varin, N. Reid, D. Firth, Statistica Sinica 21 (2011) 5 (composite likelihood).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import optimize, special

from palpate.core import Float, Int, RangeError, ndarray
from palpate.psychophysics.analysis.rank_confusion import RankConfusion, confusion_of_places
from palpate.psychophysics.judgements import RankObserver, gaussian_matrix, mixed_matrix

MAX_SENSITIVITY = 8.0
MIN_PROBABILITY = 1e-9
SENSITIVITIES = np.linspace(-2.0, MAX_SENSITIVITY, 101)
LAPSES, REVERSALS = np.linspace(0.0, 0.6, 31), np.linspace(0.0, 0.5, 26)
CHUNK = 50
DRAWS = 200
SLOPE_STEP = 1e-5  # over which a slope is differenced
MAX_LOG_STEP = 1.5  # of two neighbours, 4.5 standard deviations


@dataclass(frozen=True)
class ObserverFit:
    """An observer fitted to a matrix.

    Attributes:
        deviance: twice what a matrix of the observed shares would have more.
        deviance_p: share of simulated matrices that fit as badly; small where the observer is wrong.
        drawn: sensitivity, lapse and reversal fitted to each simulated matrix.
    """

    observer: RankObserver
    sensitivity: float
    log_likelihood: float
    deviance: float
    deviance_p: float
    drawn: Float[ndarray, "draws 3"]

    def interval(self, of: int = 0, coverage: float = 0.95) -> tuple[float, float]:
        """Percentiles of sensitivity (0), lapse (1) or reversal (2) over simulated matrices."""
        tail = 50 * (1 - coverage)
        low, high = np.percentile(self.drawn[:, of], [tail, 100 - tail])
        return float(low), float(high)


def sensitivity_at(total_accuracy: float, stimuli: int = 5) -> float:
    """The d' of neighbours with which an observer without faults is right so often in rankings.

    Args:
        total_accuracy: share of right places, above 1 / stimuli and below 1.
    """
    if not 1 / stimuli < total_accuracy < 1:
        raise RangeError(
            f"a total accuracy of {total_accuracy:g} of {stimuli} stimuli; above chance, {1 / stimuli:g}, "
            "and below 1 are allowed"
        )

    return float(sensitivities_at(np.array([total_accuracy]), stimuli)[0])


def sensitivities_at(total_accuracy: Float[ndarray, " n"], stimuli: int = 5) -> Float[ndarray, " n"]:
    """`sensitivity_at` of many, by monotone interpolation; of chance and less 0, of certainty its end, 8."""
    d, accuracy = _accuracies(stimuli)
    return np.interp(total_accuracy, accuracy, d)


def fit_observer(
    confusion: RankConfusion,
    rng: np.random.Generator,
    *,
    lapses: bool = False,
    reversals: bool = False,
    draws: int = DRAWS,
) -> ObserverFit:
    """The evenly spaced observer of greatest composite likelihood, on a grid of 0.1 in d' and 0.02 in shares.

    Args:
        lapses, reversals: whether the observer may have them.
    """
    table = _table(len(confusion.names), lapses, reversals)
    at, best = _fitted(confusion.counts[None], table)
    d, lapse, reversal = (float(each) for each in table.unknowns[at[0]])
    observer = RankObserver.evenly(d, len(confusion.names), lapse, reversal)
    drawn = np.stack([
        confusion_of_places(confusion.names, observer.drawn_places(confusion.rankings, rng)).counts
        for _ in range(draws)
    ])  # fmt: skip
    places, likelihoods = _fitted(drawn, table)
    deviance = 2 * (_full(confusion.counts[None])[0] - best[0])
    as_far = 2 * (_full(drawn) - likelihoods) >= deviance - 1e-9
    p = float((1 + as_far.sum()) / (draws + 1))
    return ObserverFit(observer, d, float(best[0]), float(deviance), p, table.unknowns[places])


def composite_log_likelihood(counts: Int[ndarray, "m m"], matrix: Float[ndarray, "m m"]) -> float:
    """Composite log likelihood of counts, less the multinomial coefficients."""
    return float((counts * np.log(np.maximum(matrix, MIN_PROBABILITY))).sum())


def fit_shared_spacing(
    kinesthetic: RankConfusion, cutaneous: RankConfusion
) -> tuple[RankObserver, RankObserver]:
    """Observers of two cues of one softness, the stimuli's spacing free and common to both.

    Each cue has its own noise and its own lapses. Spacings rise.
    """
    m = len(kinesthetic.names)
    counts = np.stack([kinesthetic.counts, cutaneous.counts])

    def parts(unknowns: ndarray) -> tuple[ndarray, ndarray]:
        """Places and lapses of both cues, of many rows of unknowns."""
        steps = np.exp(unknowns[:, : m - 1])
        places = np.concatenate([np.zeros((len(unknowns), 1)), np.cumsum(steps, axis=1)], axis=1)
        both = np.stack([places, np.exp(unknowns[:, m - 1 : m]) * places], axis=1)
        return both, special.expit(unknowns[:, m:])

    def off(unknowns: ndarray) -> tuple[float, ndarray]:
        rows = unknowns + SLOPE_STEP * np.vstack([np.zeros_like(unknowns), np.eye(len(unknowns))])
        places, lapses = parts(rows)
        matrix = mixed_matrix(gaussian_matrix(places), lapses[..., None, None], 0.0)
        value = -(counts * np.log(np.maximum(matrix, MIN_PROBABILITY))).sum(axis=(1, 2, 3))
        return float(value[0]), (value[1:] - value[0]) / SLOPE_STEP

    start = np.append(np.zeros(m), [-1.5, -1.5])
    bounds = [(-4.0, MAX_LOG_STEP)] * (m - 1) + [(-2.0, 2.0)] + [(-6.0, 2.0)] * 2
    found = optimize.minimize(off, start, jac=True, method="L-BFGS-B", bounds=bounds)
    places, lapses = parts(found.x[None])
    k, c = (
        RankObserver(tuple(map(float, at)), float(lapse))
        for at, lapse in zip(places[0], lapses[0], strict=True)
    )
    return k, c


@cache
def _accuracies(stimuli: int) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    """Sensitivities, and total accuracies that rise strictly with them."""
    d = np.linspace(0.0, MAX_SENSITIVITY, 1601)
    accuracy = np.trace(gaussian_matrix(d[:, None] * np.arange(stimuli)), axis1=1, axis2=2) / stimuli
    rising = np.append(True, np.diff(np.maximum.accumulate(accuracy)) > 0)
    return d[rising], accuracy[rising]


@dataclass(frozen=True)
class _ObserverTable:
    """Observers on a grid: sensitivity, lapse and reversal of each, and the logarithm of its matrix."""

    unknowns: Float[ndarray, "g 3"]
    log_matrix: Float[ndarray, "g cells"]


@cache
def _table(stimuli: int, lapses: bool, reversals: bool) -> _ObserverTable:
    rows = np.array([
        (i, lapse, reversal)
        for i, d in enumerate(SENSITIVITIES)
        for lapse in (LAPSES if lapses else LAPSES[:1])
        for reversal in (REVERSALS if reversals else REVERSALS[:1])
        if lapse + reversal <= 1 and (d >= 0 or not reversals)  # a reversal is a d' below 0 by another name
    ])  # fmt: skip
    plain = gaussian_matrix(SENSITIVITIES[:, None] * np.arange(stimuli))[rows[:, 0].astype(int)]
    matrices = mixed_matrix(plain, rows[:, 1, None, None], rows[:, 2, None, None])
    unknowns = np.column_stack([SENSITIVITIES[rows[:, 0].astype(int)], rows[:, 1:]])
    return _ObserverTable(unknowns, np.log(np.maximum(matrices, MIN_PROBABILITY)).reshape(len(rows), -1))


def _fitted(counts: Int[ndarray, "sets m m"], table: _ObserverTable) -> tuple[ndarray, ndarray]:
    """Row of the table that fits each matrix best, and its composite likelihood."""
    at, best = [], []
    for start in range(0, len(counts), CHUNK):
        each = table.log_matrix @ counts[start : start + CHUNK].reshape(-1, table.log_matrix.shape[1]).T
        at.append(each.argmax(axis=0))
        best.append(each.max(axis=0))
    return np.concatenate(at), np.concatenate(best)


def _full(counts: Int[ndarray, "sets m m"]) -> Float[ndarray, " sets"]:
    """Composite likelihood of the observed shares themselves."""
    share = counts / counts.sum(axis=2, keepdims=True)
    return np.asarray((counts * np.log(np.maximum(share, MIN_PROBABILITY))).sum(axis=(1, 2)))
