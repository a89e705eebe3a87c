"""Observers: fits, cues that combine, and predictions that can fail."""

import math

import numpy as np
import pytest
from scipy import stats
from tests.refusals import refused

from palpate.core import RangeError
from palpate.psychophysics.analysis import RankConfusion, confusion_of_places
from palpate.psychophysics.judgements import RankObserver
from palpate_reproductions.softness.observers import (
    combined_observer,
    combined_sensitivity,
    composite_log_likelihood,
    correlation_needed,
    fit_observer,
    gain_needed,
    predict_by_accuracy,
    predict_of_unlike_people,
    sensitivity_at,
)

NAMES = ("S1", "S2", "S3", "S4", "S5")


def drawn(observer: RankObserver, rng: np.random.Generator, rankings: int = 30) -> RankConfusion:
    return confusion_of_places(NAMES, observer.drawn_places(rankings, rng))


def test_the_wrong_sign_turns_the_matrix_round_and_fits_what_it_did_not_make_worse() -> None:
    forth, back = RankObserver.evenly(0.8), RankObserver.evenly(-0.8)
    assert back.rank_matrix() == pytest.approx(forth.rank_matrix()[:, ::-1])
    assert back.pair_accuracy(0, 1) == pytest.approx(1 - forth.pair_accuracy(0, 1))
    counts = drawn(forth, np.random.default_rng(2)).counts
    gain = composite_log_likelihood(counts, forth.rank_matrix()) - composite_log_likelihood(
        counts, back.rank_matrix()
    )
    assert gain > 20


def test_cues_add_in_quadrature_and_correlated_noise_is_that_of_the_best_weights() -> None:
    assert combined_sensitivity(3.0, 4.0) == 5.0
    for rho in (-0.7, -0.2, 0.4, 0.9):
        noise, step = np.array([[1.0, rho], [rho, 1.0]]), np.array([0.96, 1.17])
        best = math.sqrt(step @ np.linalg.inv(noise) @ step)
        assert combined_sensitivity(*step, rho) == pytest.approx(best)
    assert (
        combined_sensitivity(1.0, 1.0, -0.5)
        > combined_sensitivity(1.0, 1.0)
        > combined_sensitivity(1, 1, 0.5)
    )
    assert combined_sensitivity(0.9, 1.2, -0.6) == pytest.approx(2.0, abs=0.4)
    for d in (1.6, 2.0, 3.0):
        rho = correlation_needed(0.96, 1.17, d)
        assert rho is not None
        assert combined_sensitivity(0.96, 1.17, rho) == pytest.approx(d)
        assert gain_needed(0.96, 1.17, d) * math.hypot(0.96, 1.17) == pytest.approx(d)
        assert (rho < 0) == (d > math.hypot(0.96, 1.17))
    assert correlation_needed(0.96, 1.17, 1.0) is None
    with refused("correlation", RangeError):
        combined_sensitivity(1.0, 1.0, -1.0)
    with pytest.raises(RangeError, match="sensitivities"):
        combined_observer(RankObserver.evenly(-1.0), RankObserver.evenly(1.0))


def test_the_accuracy_of_a_sensitivity_gives_it_back() -> None:
    for d in (0.2, 0.9569, 3.0):
        assert sensitivity_at(RankObserver.evenly(d).total_accuracy()) == pytest.approx(d, abs=2e-5)
    for share in (0.2, 1.0):
        with pytest.raises(RangeError, match="above chance"):
            sensitivity_at(share)


def test_a_fit_gives_back_its_observer_and_its_interval_holds_it() -> None:
    rng, held = np.random.default_rng(3), 0
    for _ in range(30):
        fit = fit_observer(drawn(RankObserver.evenly(1.0), rng), rng, draws=60)
        low, high = fit.interval()
        held += low <= 1.0 <= high
    assert held >= stats.binom.ppf(0.002, 30, 0.93)
    many = drawn(RankObserver.evenly(1.2, lapse=0.2, reversal=0.1), rng, 3000)
    fit = fit_observer(many, rng, lapses=True, reversals=True, draws=5)
    assert fit.sensitivity == pytest.approx(1.2, abs=0.15)
    assert (fit.observer.lapse, fit.observer.reversal) == pytest.approx((0.2, 0.1), abs=0.041)


def test_shuffled_matrices_tell_of_no_sensitivity() -> None:
    rng = np.random.default_rng(5)
    counts = drawn(RankObserver.evenly(1.5), rng).counts
    for order in ([2, 4, 1, 0, 3], [3, 0, 2, 4, 1]):
        shuffled = RankConfusion(NAMES, counts[:, order])
        assert abs(fit_observer(shuffled, rng, draws=20).sensitivity) < 0.5
        assert fit_observer(shuffled, rng, draws=60).deviance_p < 0.05


def test_a_prediction_is_refuted_seldom_where_it_is_true_and_mostly_where_noises_are_correlated() -> None:
    rng, d = np.random.default_rng(7), (0.95, 1.15)
    k, c = (RankObserver.evenly(one) for one in d)
    refuted = {0.0: 0, -0.8: 0}
    for rho in refuted:
        together = RankObserver.evenly(combined_sensitivity(*d, rho))
        for _ in range(40):
            found = predict_by_accuracy(
                drawn(k, rng), drawn(c, rng), drawn(together, rng), rng, studies=100
            )  # fmt: skip
            refuted[rho] += found.p < 0.05
    assert refuted[0.0] <= stats.binom.ppf(0.999, 40, 0.05)
    assert refuted[-0.8] > 25


@pytest.mark.slow
def test_a_prediction_of_unlike_people_is_refuted_seldom_where_they_are_and_mostly_where_it_is_not() -> None:
    rng, refuted = np.random.default_rng(21), np.zeros(2)
    for _ in range(30):
        z = rng.standard_normal(10)
        d = np.exp([z, -z])
        k, c, i = (
            confusion_of_places(
                NAMES, np.concatenate([RankObserver.evenly(float(one)).drawn_places(3, rng) for one in each])
            )
            for each in (d[0], d[1], np.hypot(*d))
        )
        refuted += [
            predict_of_unlike_people(k, c, i, rng, log_scatter=1.0, studies=100).p < 0.05,
            predict_by_accuracy(k, c, i, rng, studies=200).p < 0.05,
        ]
    assert refuted[0] <= 4
    assert refuted[1] >= 10
