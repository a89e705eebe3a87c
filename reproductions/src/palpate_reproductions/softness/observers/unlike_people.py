"""A prediction of both cues where people differ in which cue they are good at.

A matrix of all people's rankings has the mean of their accuracies. Where some tell stimuli by one cue and
some by the other, everybody with both cues is as good as with the better one: the mean then rises further
than one observer of the mean accuracies, by quadrature, would have it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy import optimize

from palpate.core import Float, RangeError, ndarray
from palpate.psychophysics.analysis.rank_confusion import RankConfusion
from palpate.psychophysics.judgements import RankObserver, gaussian_matrix
from palpate_reproductions.softness.observers.cue_prediction import CuePrediction, tested_prediction
from palpate_reproductions.softness.observers.observer_fit import MAX_SENSITIVITY, sensitivities_at

UNLIKE_STUDIES = 2_000
NODES_OF_PEOPLE = 41
MAX_LOG_SENSITIVITY = 4.0  # of the middle person
SENSITIVITY_STEP = 0.01

Accuracy = Callable[[Float[ndarray, "*sets"]], Float[ndarray, "*sets"]]


def predict_of_unlike_people(
    kinesthetic: RankConfusion, cutaneous: RankConfusion, integrated: RankConfusion,
    rng: np.random.Generator, *, log_scatter: float, skills: float = -1.0, people: int = 10,
    studies: int = UNLIKE_STUDIES,
) -> CuePrediction:  # fmt: skip
    """Prediction of observers without faults whose d' differ between people, weighted by reliability.

    The logarithms of a person's two d' are Gaussian over people; their middles are those with which the mean
    accuracies of K and C are as counted.

    Args:
        kinesthetic, cutaneous: matrices that the middles are fitted to.
        integrated: matrix that it is tested on.
        rng: of simulated studies, in which people are drawn, for I anew, and rank as often as they did.
        log_scatter: standard deviation of ln d' over people; 0 is that all are alike.
        skills: correlation of the two cues' ln d' over people; -1 where who is good at one is bad at the
            other.
        people: number of them, of as many rankings each.
    """
    if log_scatter < 0 or abs(skills) > 1 or people < 1 or integrated.rankings % people:
        raise RangeError(
            f"a log scatter of {log_scatter:g}, skills correlated by {skills:g} and {people} people of "
            f"{integrated.rankings} rankings; 0 or more, -1 to 1, and people of "
            "as many rankings each are allowed"
        )
    m = len(integrated.names)
    grid = np.arange(0.0, MAX_SENSITIVITY, SENSITIVITY_STEP)
    exact = np.trace(gaussian_matrix(grid[:, None] * np.arange(m)), axis1=1, axis2=2) / m

    def accuracy(d: ndarray) -> ndarray:
        return np.interp(d, grid, exact)

    middles = [_middle(one.total_accuracy, accuracy, log_scatter) for one in (kinesthetic, cutaneous)]
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES_OF_PEOPLE)
    first, second = np.meshgrid(nodes, nodes, indexing="ij")
    d = _sensitivities_of(middles, first, second, log_scatter, skills)
    share = weights / weights.sum()
    mean = float(share @ accuracy(np.hypot(*d)) @ share)

    def drawn(at: list[float]) -> ndarray:
        """Right places of K, C and I of one simulated study."""
        one, other = rng.standard_normal((2, people))
        k, c = _sensitivities_of(at, one, other, log_scatter, skills)
        d = np.repeat(np.stack([k, c, np.hypot(k, c)]), integrated.rankings // people, axis=1)
        percept = d[:, :, None] * np.arange(m) + rng.standard_normal((*d.shape, m))
        return np.asarray((percept.argsort(axis=2).argsort(axis=2) == np.arange(m)).mean(axis=(1, 2)))

    by_middle = np.linspace(-MAX_LOG_SENSITIVITY, MAX_LOG_SENSITIVITY, 401)
    means = _mean_accuracy(by_middle, accuracy, log_scatter)
    again = [np.interp(drawn(middles)[:2], means, by_middle) for _ in range(studies)]
    observer = RankObserver.evenly(float(sensitivities_at(np.array([mean]), m)[0]), m)
    return tested_prediction(observer, np.array([drawn(list(at))[2] for at in again]), integrated)


def _sensitivities_of(
    middles: list[float], first: ndarray, second: ndarray, log_scatter: float, skills: float
) -> tuple[ndarray, ndarray]:
    """Persons' d' of both cues, from two standard Gaussian values of each."""
    other = skills * first + math.sqrt(1 - skills**2) * second
    return np.exp(middles[0] + log_scatter * first), np.exp(middles[1] + log_scatter * other)


def _mean_accuracy(middles: ndarray, accuracy: Accuracy, log_scatter: float) -> ndarray:
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES_OF_PEOPLE)
    d = np.exp(np.asarray(middles)[..., None] + log_scatter * nodes)
    return np.asarray(accuracy(d) @ (weights / weights.sum()))


def _middle(total: float, accuracy: Accuracy, log_scatter: float) -> float:
    return float(
        optimize.brentq(
            lambda at: float(_mean_accuracy(np.array(at), accuracy, log_scatter)) - total,
            -MAX_LOG_SENSITIVITY,
            MAX_LOG_SENSITIVITY,
        )
    )
