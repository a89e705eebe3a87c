"""Conditions over participants: models as independent codes have them, tests at their rate."""

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import special, stats
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.psychophysics.analysis import (
    ConditionCounts,
    PlannedStudy,
    fit_mixed_logistic,
    marginal_log_odds,
    mixed_log_likelihood,
    participants_needed,
    share_differences,
    sign_flip_p,
    simulated_power,
)

CONDITIONS = ("I", "K", "C")


def drawn(rng: np.random.Generator, log_odds, sd: float, people: int = 10, n: int = 12) -> ConditionCounts:
    b = sd * rng.standard_normal((people, 1))
    right = rng.binomial(n, special.expit(np.asarray(log_odds) + b)).astype(float)
    names = tuple(f"P{i}" for i in range(people))
    return ConditionCounts(CONDITIONS[: len(log_odds)], names, right, np.full_like(right, n))


def test_the_estimating_equation_is_that_of_statsmodels() -> None:
    counts = drawn(np.random.default_rng(1), (1.5, 0.3, 0.8), 0.7)
    rows = [
        (answer, c, s)
        for s in range(10) for c in range(3)
        for answer in [1] * int(counts.right[s, c]) + [0] * int(counts.n[s, c] - counts.right[s, c])
    ]  # fmt: skip
    y, c, s = np.array(rows).T
    design = np.column_stack([np.ones(len(y)), c == 1, c == 2]).astype(float)
    theirs = sm.GEE(
        y, design, groups=s, family=sm.families.Binomial(), cov_struct=sm.cov_struct.Independence()
    ).fit()
    first = marginal_log_odds(counts)[0]
    assert (first.first, first.second) == ("I", "K")
    assert first.value == pytest.approx(theirs.params[1], rel=1e-5)
    error = theirs.bse[1] * np.sqrt(10 / 9) * stats.t.ppf(0.975, 9)
    assert first.high - first.value == pytest.approx(error, rel=1e-4)


def by_dense_nodes(counts: ConditionCounts, beta: np.ndarray, sd: float) -> float:
    """The mixed likelihood by the trapezium rule, 0.0045 of the scatter apart."""
    u = np.linspace(-9, 9, 4001)
    eta = beta + sd * u[:, None]
    each = counts.right @ special.log_expit(eta).T + (counts.n - counts.right) @ special.log_expit(-eta).T
    return float(special.logsumexp(each + stats.norm.logpdf(u) + np.log(u[1] - u[0]), axis=1).sum())


@pytest.mark.parametrize(
    ("answers", "sd"), [(3, 0.5), (12, 2.0), (40, 2.0), (280, 0.5), (280, 2.0), (2000, 2.0)]
)
def test_the_mixed_likelihood_is_the_integral_of_many_answers_as_of_few(answers: int, sd: float) -> None:
    counts = drawn(np.random.default_rng(7), (0.0, 0.5, 1.0), sd, n=answers)
    beta = np.array([0.1, 0.4, 0.9])
    assert mixed_log_likelihood(counts, beta, sd) == pytest.approx(by_dense_nodes(counts, beta, sd), abs=1e-6)


def test_without_scatter_the_mixed_model_is_plain_and_with_it_the_scatter_is_found() -> None:
    alike = drawn(np.random.default_rng(3), (1.2, -0.4), 0.0, people=40, n=40)
    fit = fit_mixed_logistic(alike)
    k, n = alike.right.sum(axis=0), alike.n.sum(axis=0)
    assert fit.log_odds == pytest.approx(special.logit((k + 0.5) / (n + 1)), abs=0.02)
    assert fit.intercept_sd < 0.25
    fit = fit_mixed_logistic(drawn(np.random.default_rng(4), (1.2, -0.4), 1.5, people=80, n=40))
    assert fit.intercept_sd == pytest.approx(1.5, rel=0.25)
    assert fit.converged


@pytest.mark.parametrize("studies", [25, pytest.param(100, marks=pytest.mark.slow)])
def test_intervals_of_both_models_hold_the_truth_and_no_difference_is_seldom_found(studies: int) -> None:
    rng, held, found = np.random.default_rng(5), 0, 0
    for _ in range(studies):
        pair = fit_mixed_logistic(drawn(rng, (1.2, 0.4), 0.8)).pairs[0]
        held += pair.low <= -0.8 <= pair.high
        found += marginal_log_odds(drawn(rng, (0.5, 0.5), 0.8))[0].p < 0.05
    assert held >= stats.binom.ppf(0.001, studies, 0.95)
    assert found <= stats.binom.ppf(0.999, studies, 0.06)


def test_a_condition_that_is_all_right_is_told_by_what_stays_finite() -> None:
    counts = ConditionCounts(
        ("I", "K"), tuple("ABCDEFGHIJ"), np.column_stack([np.full(10, 3.0), [2, 1, 2, 3, 1, 2, 2, 1, 2, 2]]),
        np.full((10, 2), 3.0),
    )  # fmt: skip
    assert marginal_log_odds(counts) == ()
    fit = fit_mixed_logistic(counts)
    assert np.isfinite(fit.log_odds).all()
    assert fit.pairs[0].high < 0
    (one,) = share_differences(counts)
    assert one.p == pytest.approx(2 / 2**9)  # nine differ, all downwards, and the tenth not at all
    assert one.least_p == pytest.approx(2 / 2**10)
    assert one.low < one.value < one.high < 0


def test_signs_flip_exactly_and_the_sign_of_a_difference_is_the_second_less_the_first() -> None:
    assert sign_flip_p([1.0] * 5) == 2 / 32
    assert sign_flip_p([1.0, -1.0]) == 1.0
    assert sign_flip_p(np.ones(20)) == pytest.approx(0.0, abs=1e-3)
    counts = ConditionCounts(("I", "K"), ("A", "B"), np.array([[3.0, 1], [3, 2]]), np.full((2, 2), 3.0))
    assert share_differences(counts)[0].value == pytest.approx(-0.5)
    with pytest.raises(InputError, match="1 participant"):
        share_differences(ConditionCounts(("I", "K"), ("A",), np.ones((1, 2)), np.ones((1, 2))))
    with pytest.raises(RangeError, match="more right"):
        ConditionCounts(("I",), ("A",), np.array([[2.0]]), np.array([[1.0]]))


def test_a_planned_study_has_its_power_and_none_where_nothing_differs() -> None:
    rng = np.random.default_rng(6)
    null = simulated_power(PlannedStudy(0.6, 0.6, 12), 10, rng, studies=200)
    assert null.low <= 0.05
    needed = participants_needed(PlannedStudy(0.6, 0.8, 12), rng, studies=150)
    assert 4 < needed.participants < 20
    assert needed.high > 0.75
    assert simulated_power(PlannedStudy(0.6, 0.8, 12), 5, rng, studies=150).power < needed.power
    with refused("sample-size", RangeError):
        participants_needed(PlannedStudy(0.6, 0.601, 1), rng, studies=40)


def test_where_the_effect_differs_between_people_more_of_them_are_needed() -> None:
    rng = np.random.default_rng(9)
    alike, own = (
        simulated_power(PlannedStudy(0.6, 0.8, 12, effect_sd=sd), 10, rng, studies=600) for sd in (0.0, 1.5)
    )
    assert own.high < alike.low
    null = simulated_power(PlannedStudy(0.7, 0.7, 12, effect_sd=1.5), 10, rng, studies=600)
    assert null.low <= 0.05  # signs keep their rate
    with refused("study-design", RangeError):
        PlannedStudy(0.6, 0.8, 12, effect_sd=-1.0)
