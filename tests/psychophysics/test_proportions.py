"""Intervals of proportions: as printed, exact, and over participants."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, special, stats
from statsmodels.stats.proportion import confint_proportions_2indep, proportion_confint
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.psychophysics.analysis import (
    clopper_pearson_interval,
    cluster_interval,
    newcombe_interval,
    wald_full_width,
    wald_half_width,
    wald_interval,
    wilson_interval,
)
from palpate.psychophysics.analysis.proportions import beta_binomial_interval, expanded_percentiles


@pytest.mark.parametrize(("mean", "full"), [(0.75, 0.3099), (0.82, 0.2750), (0.79, 0.2915)])
def test_the_printed_intervals_of_rendered_pairs_are_full_widths(mean: float, full: float) -> None:
    assert wald_full_width(mean, 30) == pytest.approx(full, abs=5e-5)
    assert wald_half_width(mean, 30) == pytest.approx(full / 2, abs=5e-5)


def test_wald_collapses_at_thirty_of_thirty_and_the_others_do_not() -> None:
    assert wald_interval(30, 30) == (1.0, 1.0)
    assert wilson_interval(30, 30) == pytest.approx((0.8865, 1.0), abs=5e-5)
    assert clopper_pearson_interval(30, 30) == pytest.approx((0.8843, 1.0), abs=5e-5)
    assert wilson_interval(0, 30) == pytest.approx((0.0, 0.1135), abs=5e-5)


@pytest.mark.parametrize("right", [0, 1, 7, 15, 29, 30])
def test_intervals_are_those_of_statsmodels(right: int) -> None:
    for ours, method in (
        (wilson_interval(right, 30), "wilson"),
        (clopper_pearson_interval(right, 30), "beta"),
    ):
        assert ours == pytest.approx(proportion_confint(right, 30, 0.05, method), abs=1e-9)
    theirs = confint_proportions_2indep(24, 30, right, 30, "newcomb", "diff", 0.05, correction=False)
    assert newcombe_interval((right, 30), (24, 30)) == pytest.approx(theirs, abs=1e-9)


def held_in(share: float, answers: int, sd: float, studies: int, seed: int) -> tuple[float, float, float]:
    """How often intervals of ten people hold the population's share: over people, drawn alone, Wilson's."""
    rng = np.random.default_rng(seed)
    nodes, weights = np.polynomial.hermite_e.hermegauss(41)

    def mean(a: float) -> float:
        return float(weights @ special.expit(a + sd * nodes) / weights.sum())

    a = optimize.brentq(lambda a: mean(a) - share, -20, 20)
    held = np.zeros(3)
    for _ in range(studies):
        k = rng.binomial(answers, special.expit(a + sd * rng.standard_normal(10)))
        means = k[rng.integers(10, size=(600, 10))].mean(axis=1) / answers
        ends = (
            cluster_interval(k, [answers] * 10, rng, draws=600),
            expanded_percentiles(means, 10, 0.95),
            wilson_interval(int(k.sum()), 10 * answers),
        )
        held += [low <= share <= high for low, high in ends]
    return tuple(held / studies)  # type: ignore[return-value]


@pytest.mark.parametrize(("share", "answers", "sd"), [(0.69, 12, 1.5), (0.9, 40, 1.5), (0.95, 3, 0.5)])
@pytest.mark.cases(1)
def test_answers_of_ten_people_are_not_independent_and_the_interval_over_people_covers(
    share: float, answers: int, sd: float
) -> None:
    studies = 120
    people, drawn_alone, independent = held_in(share, answers, sd, studies, seed=1)
    assert people >= stats.binom.ppf(0.001, studies, 0.95) / studies
    if sd > 1:
        assert independent < 0.80  # the control: answers counted as independent
    if share == 0.9:
        assert drawn_alone < 0.91  # the control: few people seldom show a long tail


@pytest.mark.parametrize("right", [0, 3, 8, 9, 10])
def test_of_one_answer_each_the_beta_binomial_posterior_is_jeffreys(right: int) -> None:
    """How alike one person's answers are then has no say: Beta(right + 1/2, wrong + 1/2)."""
    k = np.array([1.0] * right + [0.0] * (10 - right))
    low, high = beta_binomial_interval(k, np.ones(10))
    exact = stats.beta.ppf([0.025, 0.975], right + 0.5, 10 - right + 0.5)
    assert low == pytest.approx(exact[0] if right else 0.0, abs=2e-3)
    assert high == pytest.approx(exact[1] if right < 10 else 1.0, abs=2e-3)


def test_the_beta_binomial_interval_is_turned_round_with_right_and_wrong_and_widens_where_people_differ() -> (
    None
):
    k = np.array([12.0, 11, 10, 12, 8, 9, 12, 11, 12, 10])
    low, high = beta_binomial_interval(k, np.full(10, 12.0))
    assert beta_binomial_interval(12 - k, np.full(10, 12.0)) == pytest.approx((1 - high, 1 - low), abs=1e-6)
    apart = beta_binomial_interval(np.array([12.0] * 8 + [11, 0]), np.full(10, 12.0))  # as many right
    assert apart[1] - apart[0] > 1.5 * (high - low)


def test_percentiles_of_ten_units_lie_as_far_out_as_student_s_t() -> None:
    """sqrt(10 / 9) t(9) = 2.3845, beyond which a Gaussian has 0.855 %."""
    low, high = expanded_percentiles(np.linspace(0.0, 1.0, 10_001), 10, 0.95)
    assert (low, high) == pytest.approx((0.00855, 1 - 0.00855), abs=2e-5)


def test_participants_who_are_all_right_lie_between_one_answer_each_and_all_answers() -> None:
    rng = np.random.default_rng(0)
    low, high = cluster_interval([15] * 10, [15] * 10, rng)
    assert clopper_pearson_interval(10, 10)[0] < low < wilson_interval(150, 150)[0]
    assert high == 1.0
    assert cluster_interval([0] * 10, [15] * 10, rng) == pytest.approx((0.0, 1 - low), abs=1e-6)
    with pytest.raises(InputError, match="best ten"):
        cluster_interval([3], [3], rng)


def test_one_wrong_answer_moves_an_interval_by_little() -> None:
    rng = np.random.default_rng(0)
    lows = [cluster_interval([15] * 9 + [15 - wrong], [15] * 10, rng)[0] for wrong in (0, 1, 2)]
    assert lows[0] > lows[1] > lows[2] > lows[0] - 0.12


def test_counts_that_cannot_be_are_refused() -> None:
    for right, n in ((31, 30), (-1, 30), (0, 0)):
        for interval in (wald_interval, wilson_interval, clopper_pearson_interval):
            with pytest.raises(RangeError):
                interval(right, n)
    with refused("coverage", RangeError):
        wilson_interval(3, 30, 1.0)
