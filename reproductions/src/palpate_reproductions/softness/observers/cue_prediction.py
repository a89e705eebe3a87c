"""Predictions of rankings with both cues, from rankings with each cue alone, tested on the former.

Observers are fitted to the matrices of the kinesthetic (K) and the cutaneous (C) condition, never to the
integrated one (I). What is predicted of I is then its total accuracy, with an interval that holds both the
uncertainty of the fits and the chance of I's own rankings; p is the share of simulated studies as far off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, ndarray
from palpate.psychophysics.analysis.rank_confusion import RankConfusion, confusion_of_places
from palpate.psychophysics.judgements import RankObserver
from palpate_reproductions.softness.observers.cue_combination import (
    combined_observer,
    combined_sensitivity,
    correlation_needed,
    gain_needed,
)
from palpate_reproductions.softness.observers.observer_fit import (
    ObserverFit,
    fit_observer,
    fit_shared_spacing,
    sensitivities_at,
)

STUDIES = 400
ACCURACY_STUDIES = 2_000
SHAPE_STUDIES = 100
MAX_SHARE = 1 - 1e-4  # of right places taken from simulated matrices: all right has no finite d'
MIN_ABOVE_CHANCE = 1e-3


@dataclass(frozen=True)
class CuePrediction:
    """What one kind of observer predicts of the integrated condition.

    Attributes:
        low, high: 95 % interval of the total accuracy of so many rankings, fits' uncertainty included.
        p: two-sided share of simulated studies as far from the median as what was observed.
    """

    observer: RankObserver
    accuracy: float
    low: float
    high: float
    observed: float
    p: float


@dataclass(frozen=True)
class CueNeeds:
    """What the plain observer would need for the integrated condition's accuracy.

    Attributes:
        sensitivities: d' of neighbours in K, C and I, by total accuracy.
        correlation: of the cues' noises, None where none makes so little.
        gain: by which stimuli would have to differ more in both cues than in K and in C.
    """

    sensitivities: tuple[float, float, float]
    sensitivity_intervals: tuple[tuple[float, float], ...]
    correlation: float | None
    correlation_interval: tuple[float, float]
    gain: float
    gain_interval: tuple[float, float]


def predict_by_accuracy(
    kinesthetic: RankConfusion, cutaneous: RankConfusion, integrated: RankConfusion,
    rng: np.random.Generator, *, correlation: float = 0.0, gains: tuple[float, float] = (1.0, 1.0),
    studies: int = ACCURACY_STUDIES, independent: int | None = None,
) -> CuePrediction:  # fmt: skip
    """Prediction of an observer without faults, whose d' are those of the total accuracies of K and C.

    Args:
        kinesthetic, cutaneous: matrices that it is fitted to.
        integrated: matrix that it is tested on.
        gains: how much more stimuli differ in each cue in I than in K and C.
        independent: rankings of each matrix that count as independent; all of them unless given. As many as
            there are people is the worst case, each person's rankings alike.
    """
    d = [_sensitivity(one.total_accuracy, len(one.names)) for one in (kinesthetic, cutaneous)]

    def both(k: float, c: float) -> RankObserver:
        together = combined_sensitivity(gains[0] * k, gains[1] * c, correlation)
        return RankObserver.evenly(together, len(integrated.names))

    drawn = [
        _drawn_sensitivity(value, one, rng, studies, independent)
        for value, one in zip(d, (kinesthetic, cutaneous), strict=True)
    ]
    accuracies = [
        _drawn_accuracy(both(k, c), integrated, rng, independent) for k, c in zip(*drawn, strict=True)
    ]
    return tested_prediction(both(*d), np.array(accuracies), integrated)


def predict_with_faults(
    kinesthetic: ObserverFit, cutaneous: ObserverFit, integrated: RankConfusion, rng: np.random.Generator,
    *, faults_in_both: bool = False,
) -> CuePrediction:  # fmt: skip
    """Prediction of observers with lapses or reversals in K and C, by likelihood.

    Args:
        integrated: matrix that it is tested on.
        rng: of simulated studies, one for each that the fits have drawn.
        faults_in_both: whether I has the mean of their faults; else it has none.
    """

    def both(k: Float[ndarray, " 3"], c: Float[ndarray, " 3"]) -> RankObserver:
        together = combined_sensitivity(max(float(k[0]), 0.0), max(float(c[0]), 0.0))
        lapse, reversal = (k[1:] + c[1:]) / 2 if faults_in_both else (0.0, 0.0)
        return RankObserver.evenly(together, len(integrated.names), float(lapse), float(reversal))

    own = [
        np.array([one.sensitivity, one.observer.lapse, one.observer.reversal])
        for one in (kinesthetic, cutaneous)
    ]
    pairs = zip(kinesthetic.drawn, cutaneous.drawn, strict=True)
    accuracies = [_drawn_accuracy(both(k, c), integrated, rng) for k, c in pairs]
    return tested_prediction(both(*own), np.array(accuracies), integrated)


def predict_with_spacing(
    kinesthetic: RankConfusion, cutaneous: RankConfusion, integrated: RankConfusion,
    rng: np.random.Generator, *, studies: int = SHAPE_STUDIES,
) -> CuePrediction:  # fmt: skip
    """Prediction where the stimuli's spacing is free and common to both cues, and lapses are K's and C's own.

    Its interval is of few simulated studies, each fitted again, and so is rough.
    """
    k, c = fit_shared_spacing(kinesthetic, cutaneous)
    accuracies = []
    for _ in range(studies):
        again = fit_shared_spacing(*(
            confusion_of_places(one.names, observer.drawn_places(one.rankings, rng))
            for observer, one in ((k, kinesthetic), (c, cutaneous))
        ))  # fmt: skip
        accuracies.append(_drawn_accuracy(combined_observer(*again), integrated, rng))
    return tested_prediction(combined_observer(k, c), np.array(accuracies), integrated)


def needs_of(
    kinesthetic: RankConfusion, cutaneous: RankConfusion, integrated: RankConfusion,
    rng: np.random.Generator, studies: int = ACCURACY_STUDIES,
) -> CueNeeds:  # fmt: skip
    """What correlation of noises, or what gain in both cues, would make the integrated accuracy."""
    all_ = (kinesthetic, cutaneous, integrated)
    d = [_sensitivity(one.total_accuracy, len(one.names)) for one in all_]
    drawn = np.array(
        [_drawn_sensitivity(value, one, rng, studies) for value, one in zip(d, all_, strict=True)]
    )
    correlations = [correlation_needed(k, c, i) for k, c, i in drawn.T]
    told = [one for one in correlations if one is not None]
    gains = [gain_needed(k, c, i) for k, c, i in drawn.T]
    return CueNeeds(
        (d[0], d[1], d[2]),
        tuple(_ends(each) for each in drawn),
        correlation_needed(*d),
        _ends(np.array(told)) if told else (float("nan"), float("nan")),
        gain_needed(*d),
        _ends(np.array(gains)),
    )


def predictions_of(
    kinesthetic: RankConfusion, cutaneous: RankConfusion, integrated: RankConfusion, rng: np.random.Generator
) -> Mapping[str, CuePrediction]:
    """All kinds of observers fitted to K and C, tested on I, by name."""
    faulty = [
        fit_observer(one, rng, lapses=True, reversals=True, draws=STUDIES) for one in (kinesthetic, cutaneous)
    ]
    plain = [fit_observer(one, rng, draws=STUDIES) for one in (kinesthetic, cutaneous)]
    return {
        "no faults, by accuracy": predict_by_accuracy(kinesthetic, cutaneous, integrated, rng),
        "no faults, by likelihood": predict_with_faults(plain[0], plain[1], integrated, rng),
        "faults in K and C, none in I": predict_with_faults(faulty[0], faulty[1], integrated, rng),
        "faults in all": predict_with_faults(faulty[0], faulty[1], integrated, rng, faults_in_both=True),
        "free spacing, lapses in K and C": predict_with_spacing(kinesthetic, cutaneous, integrated, rng),
        "correlation of noises 0.5": predict_by_accuracy(
            kinesthetic, cutaneous, integrated, rng, correlation=0.5
        ),
        "correlation of noises -0.5": predict_by_accuracy(
            kinesthetic, cutaneous, integrated, rng, correlation=-0.5
        ),
    }


def tested_prediction(
    observer: RankObserver, drawn: Float[ndarray, " _"], integrated: RankConfusion
) -> CuePrediction:
    """An observer's prediction, its interval and p from simulated studies' total accuracies.

    Args:
        drawn: total accuracy of I in each simulated study.
    """
    seen = integrated.total_accuracy
    tails = [(1 + (drawn <= seen + 1e-9).sum()), (1 + (drawn >= seen - 1e-9).sum())]
    low, high = _ends(drawn)
    p = float(min(1.0, 2 * min(tails) / (len(drawn) + 1)))
    return CuePrediction(observer, observer.total_accuracy(), low, high, seen, p)


def _sensitivity(accuracy: float, stimuli: int) -> float:
    return float(_sensitivities(np.array([accuracy]), stimuli)[0])


def _sensitivities(accuracy: Float[ndarray, " n"], stimuli: int) -> Float[ndarray, " n"]:
    return sensitivities_at(np.clip(accuracy, 1 / stimuli + MIN_ABOVE_CHANCE, MAX_SHARE), stimuli)


def _drawn_sensitivity(
    sensitivity: float,
    confusion: RankConfusion,
    rng: np.random.Generator,
    studies: int,
    independent: int | None = None,
) -> Float[ndarray, " studies"]:
    """Sensitivities that so many simulated matrices of such an observer would be found to have."""
    m = len(confusion.names)
    places = RankObserver.evenly(sensitivity, m).drawn_places(
        (independent or confusion.rankings) * studies, rng
    )
    return _sensitivities((places == np.arange(m)).mean(axis=1).reshape(studies, -1).mean(axis=1), m)


def _drawn_accuracy(
    observer: RankObserver, like: RankConfusion, rng: np.random.Generator, independent: int | None = None
) -> float:
    places = observer.drawn_places(independent or like.rankings, rng)
    return float((places == np.arange(len(like.names))).mean())


def _ends(drawn: Float[ndarray, " _"]) -> tuple[float, float]:
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(low), float(high)
