"""Intervals of proportions: as printed, exact, and over participants."""

import numpy as np
import pytest
from scipy import optimize, special, stats
from statsmodels.stats.proportion import confint_proportions_2indep, proportion_confint
from tests.refusals import refused

from palpate.core import RangeError
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
    studies = 120 if share > 0.69 else 30  # the others are slow
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


def test_counts_that_cannot_be_are_refused() -> None:
    for right, n in ((31, 30), (-1, 30), (0, 0)):
        for interval in (wald_interval, wilson_interval, clopper_pearson_interval):
            with pytest.raises(RangeError):
                interval(right, n)
    with refused("coverage", RangeError):
        wilson_interval(3, 30, 1.0)
