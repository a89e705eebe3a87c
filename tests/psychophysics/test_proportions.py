"""Intervals of proportions: as printed, exact, and over participants."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.proportion import confint_proportions_2indep, proportion_confint

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
from palpate.psychophysics.analysis.proportions import expanded_percentiles


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


def held_in(sd: float, studies: int, seed: int) -> tuple[float, float]:
    """Share of studies of ten participants whose interval holds the population's: clusters', Wilson's."""
    rng = np.random.default_rng(seed)
    nodes, weights = np.polynomial.hermite_e.hermegauss(41)
    truth = float(weights @ (1 / (1 + np.exp(-0.8 - sd * nodes))) / weights.sum())
    held = np.zeros(2)
    for _ in range(studies):
        k = rng.binomial(12, 1 / (1 + np.exp(-0.8 - sd * rng.standard_normal(10))))
        ends = cluster_interval(k, [12] * 10, rng, draws=600), wilson_interval(int(k.sum()), 120)
        held += [low <= truth <= high for low, high in ends]
    return tuple(held / studies)  # type: ignore[return-value]


def test_thirty_answers_of_ten_people_are_not_thirty_and_drawing_people_covers() -> None:
    clusters, answers = held_in(1.5, 400, seed=1)
    low = stats.binom.ppf(0.001, 400, 0.95) / 400
    assert clusters > low - 0.02  # of ten participants the bootstrap holds a little less than it claims
    assert answers < 0.80  # the control: answers counted as independent


def test_percentiles_of_ten_units_lie_as_far_out_as_student_s_t() -> None:
    """sqrt(10 / 9) t(9) = 2.3845, beyond which a Gaussian has 0.855 %."""
    low, high = expanded_percentiles(np.linspace(0.0, 1.0, 10_001), 10, 0.95)
    assert (low, high) == pytest.approx((0.00855, 1 - 0.00855), abs=2e-5)


def test_participants_who_are_all_right_count_as_one_answer_each() -> None:
    rng = np.random.default_rng(0)
    assert cluster_interval([3] * 10, [3] * 10, rng) == clopper_pearson_interval(10, 10)
    assert cluster_interval([0] * 10, [3] * 10, rng) == clopper_pearson_interval(0, 10)
    with pytest.raises(InputError, match="best ten"):
        cluster_interval([3], [3], rng)


def test_counts_that_cannot_be_are_refused() -> None:
    for right, n in ((31, 30), (-1, 30), (0, 0)):
        for interval in (wald_interval, wilson_interval, clopper_pearson_interval):
            with pytest.raises(RangeError):
                interval(right, n)
    with pytest.raises(RangeError, match=r"coverage of 1"):
        wilson_interval(3, 30, 1.0)
