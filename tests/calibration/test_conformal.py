"""Intervals hold the truth at their stated rate, and say so with an interval of their own."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scipy import stats
from scipy.stats import binomtest
from tests.refusals import refused

from palpate.calibration.coverage.conformal import conformal_quantile, fit_intervals
from palpate.calibration.coverage.grouped_rates import (
    coverage_interval,
    grouped_coverage_interval,
    grouped_mean_interval,
)
from palpate.core.errors import InputError, RangeError
from palpate.estimators.intervals import ErrorSpread


def world(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Predictions, and truths whose error grows with the first prediction."""
    predicted = rng.uniform(0, 1, (n, 2))
    size = np.stack([0.05 + 0.4 * predicted[:, 0], np.full(n, 0.2)], axis=1)
    return predicted, predicted + size * rng.standard_normal((n, 2))


def test_intervals_cover_at_their_rate() -> None:
    rng = np.random.default_rng(0)
    rates = []
    for _ in range(8):
        predicted, true = world(rng, 400)
        intervals = fit_intervals(predicted, true, np.arange(400), 0.9)
        fresh, fresh_true = world(rng, 2000)
        rates.append((np.abs(fresh - fresh_true) <= intervals.half_widths(fresh)).mean(axis=0))
    # Each calibration's own rate scatters by 1.5 % (400 scores); the mean of 8 by 0.5 %.
    np.testing.assert_allclose(np.mean(rates, axis=0), 0.9, atol=0.012)


def test_intervals_are_wide_where_errors_are_large() -> None:
    rng = np.random.default_rng(1)
    predicted, true = world(rng, 2000)
    intervals = fit_intervals(predicted, true, np.arange(2000), 0.9)
    ends = intervals.half_widths(np.array([[0.05, 0.5], [0.95, 0.5]]))
    assert ends[1, 0] > 3 * ends[0, 0]
    assert ends[1, 1] == pytest.approx(ends[0, 1], rel=0.25)


@pytest.mark.parametrize("coverage", ["0.5", "0.8", "0.9", "0.95", "0.99"])
@pytest.mark.cases(2)
def test_the_quantile_is_the_least_score_whose_rank_promises_the_coverage(coverage: str) -> None:
    """Of n + 1 exchangeable scores the last is below the k-th of the others in k of n + 1 cases."""
    for n in range(1, 200):
        enough = [k for k in range(1, n + 1) if Fraction(k, n + 1) >= Fraction(coverage)]
        assert conformal_quantile(np.arange(1.0, n + 1), float(coverage)) == min(enough, default=n)


@pytest.mark.parametrize("coverage", [1.2, -0.1, 0.0, math.nan])
def test_what_is_no_rate_has_no_quantile(coverage: float) -> None:
    with refused("coverage-range", RangeError):
        conformal_quantile(np.arange(10.0), coverage)


@pytest.mark.parametrize("n", [5, 10, 14])
@pytest.mark.cases(1)
def test_the_promise_holds_for_few_scores(n: int) -> None:
    """ceil(0.8 (n + 1)) / (n + 1), which is where the new score of n + 1 falls; 20,000 draws, to 0.3 %."""
    scores = np.random.default_rng(n).exponential(size=(20_000, n + 1))
    below = np.mean([row[0] <= conformal_quantile(row[1:], 0.8) for row in scores])
    assert below >= 0.8 - 0.01
    assert below == pytest.approx(math.ceil(0.8 * (n + 1)) / (n + 1), abs=0.01)


def test_no_scores_give_no_interval() -> None:
    with refused("few-groups", InputError):
        conformal_quantile(np.empty(0), 0.9)


@pytest.mark.parametrize(("hits", "n"), [(0, 30), (30, 30), (27, 30), (361, 400)])
def test_the_interval_of_a_rate_is_scipys(hits: int, n: int) -> None:
    other = binomtest(hits, n).proportion_ci(0.95, method="exact")
    assert coverage_interval(hits, n) == pytest.approx((other.low, other.high), abs=1e-12)


def test_rows_of_one_group_widen_the_interval_of_a_rate() -> None:
    rng = np.random.default_rng(3)
    groups = np.repeat(np.arange(40), 25)
    inside = np.repeat(rng.random(40) < 0.9, 25)
    alone = grouped_coverage_interval(inside, np.arange(1000))
    together = grouped_coverage_interval(inside, groups)
    # 25 copies of each answer carry the information of one: the interval is about five times wider.
    assert together[1] - together[0] > 3 * (alone[1] - alone[0])


@pytest.mark.parametrize("correlation", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("count", [2, 3, 5, 8, 15, 30])
@pytest.mark.cases(4)
def test_the_interval_of_a_rate_holds_it_however_few_groups_there_are(count: int, correlation: float) -> None:
    """Groups drawn again hold it in 59 to 68 % with two groups; 400 draws tell 96 % from 92 %."""
    rng, held, widths = np.random.default_rng(count), [], []
    groups, own = np.repeat(np.arange(count), 40), (1 - correlation) / correlation
    for _ in range(400):
        rates = rng.beta(0.9 * own, 0.1 * own, count)[groups]
        low, high = grouped_coverage_interval(rng.random(len(groups)) < rates, groups)
        held.append(low <= 0.9 <= high)
        widths.append(high - low)
    assert np.mean(held) >= 0.94
    assert np.mean(widths) < (0.22 if count >= 15 else 0.95)


def test_one_group_tells_nothing_of_others_and_two_hardly_more() -> None:
    one = grouped_coverage_interval(np.arange(60) < 52, np.zeros(60))
    assert one[0] < 0.05
    assert one[1] > 0.95
    low, high = grouped_coverage_interval(np.tile(np.arange(30) < 26, 2), np.repeat([0, 1], 30))
    assert high - low > 0.8


def test_the_spread_is_held_between_a_fifth_and_five_times_the_typical_error() -> None:
    """A line of log spread, one per scale: 1 at the centre, e one scale up, held where it would run away."""
    line = np.array([[0.0, 1.0, 0.0]])
    spread = ErrorSpread(np.array([10.0]), np.array([2.0]), np.array([0.3]), line)
    places = np.array([[10.0], [12.0], [8.0], [16.0], [4.0]])
    expected = [0.3, 0.3 * np.e, 0.3 / np.e, 5 * 0.3, 0.3 / 5]
    np.testing.assert_allclose(spread.at(places)[:, 0], expected, rtol=1e-12)


@pytest.mark.parametrize("count", [3, 5, 8, 15])
@pytest.mark.cases(2)
def test_a_mean_of_few_groups_that_is_none_is_called_one_in_few_of_a_hundred_draws(count) -> None:
    """In 5 of 100; by groups drawn again with replacement it was in 23, 15, 13 and 8 of 100."""
    rng, wrong = np.random.default_rng(0), 0
    for _ in range(400):
        groups = np.repeat(np.arange(count), rng.integers(5, 30, count))
        values = rng.normal(0, 0.5, count)[groups] + rng.standard_t(3, len(groups))
        low, high = grouped_mean_interval(values, groups)
        wrong += not low <= 0 <= high
    assert 0.02 < wrong / 400 < 0.095  # a rate of 7 % has a standard error of 1.3 %


def test_the_interval_of_a_mean_is_students_where_each_row_is_its_own_group() -> None:
    values = np.random.default_rng(1).normal(2, 1, 12)
    by_hand = stats.t.interval(0.95, 11, values.mean(), stats.sem(values))
    assert grouped_mean_interval(values, np.arange(12)) == pytest.approx(by_hand)
    assert grouped_mean_interval(np.repeat(values, 5), np.repeat(np.arange(12), 5)) == pytest.approx(by_hand)
    assert grouped_mean_interval(values, np.arange(12) % 2) is None
