"""Rank tests against their closed forms, and what they must warn of."""

from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import rankdata
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate.psychophysics import compare, fit_line, mean_interval


def single(values) -> list[list[float]]:
    return [[float(v)] for v in values]


SEPARATED = {"S1": single(range(10)), "S2": single(range(10, 20)), "S3": single(range(20, 30))}


def test_three_separated_groups_of_ten_give_the_known_p_values() -> None:
    found = compare(SEPARATED)
    assert_allclose(found.kruskal_h, 25.806, atol=5e-4)
    assert_allclose(found.pair("S1", "S2").dunn_p, 0.011085, atol=5e-7)
    assert_allclose(found.pair("S2", "S3").dunn_p, 0.011085, atol=5e-7)


def test_dunn_is_its_formula(rng) -> None:
    groups = {name: single(rng.normal(k, 1, 7)) for k, name in enumerate("abc")}
    ranks = np.argsort(np.argsort(np.concatenate([np.ravel(g) for g in groups.values()]))) + 1
    a, b = ranks[:7].mean(), ranks[7:14].mean()
    z = abs(a - b) / np.sqrt(21 * 22 / 12 * (1 / 7 + 1 / 7))
    from scipy.stats import norm

    assert_allclose(compare(groups).pair("b", "a").dunn_p, 2 * norm.sf(z), rtol=1e-9)


TIED = [
    ([1, 1, 1, 2], [3, 3, 4, 4]),
    ([1, 1, 1], [1, 2, 2, 2, 2, 3]),
    ([1, 2, 2, 5], [2, 2, 3]),
    ([1, 1], [2] * 9),
]


@pytest.mark.parametrize(("a", "b"), TIED)
def test_with_ties_the_rank_sum_test_of_small_groups_counts_every_order(a, b) -> None:
    pair = compare({"a": single(a), "b": single(b)}).pair("a", "b")
    ranks = rankdata(a + b)
    sums = [sum(chosen) for chosen in combinations(ranks, len(a))]
    found = sum(ranks[: len(a)])
    tail = min(np.mean([one <= found for one in sums]), np.mean([one >= found for one in sums]))
    assert_allclose(pair.rank_sum_p, min(1, 2 * tail))
    assert pair.rank_sum_p >= pair.least_p


@pytest.mark.parametrize(("n", "m"), [(2, 600), (9, 9), (8, 490)])
def test_no_rank_sum_p_lies_below_the_least_there_is(n, m) -> None:
    pair = compare({"a": single([1] * n), "b": single([2] * m)}).pair("a", "b")
    assert pair.rank_sum_p >= pair.least_p


def test_a_trial_is_one_value_however_many_samples_it_has(rng) -> None:
    trials = {name: [rng.normal(k, 1, 100) for _ in range(5)] for k, name in enumerate("ab")}
    assert compare(trials).n == {"a": 5, "b": 5}
    assert not compare(trials).warnings
    pooled = compare(trials, pooled=True)
    assert pooled.n == {"a": 500, "b": 500}
    assert "pseudo-replication" in pooled.warnings[0]
    assert pooled.pair("a", "b").rank_sum_p < compare(trials).pair("a", "b").least_p


@pytest.mark.slow
def test_lilliefors_test_keeps_its_level_and_finds_an_exponential(rng) -> None:
    """Of 200 Gaussian samples 5 % are refused, to within three standard errors of that rate."""
    gaussian = compare({str(k): single(rng.normal(3.1, 0.4, 12)) for k in range(200)}).lilliefors_p
    assert abs(np.mean([p < 0.05 for p in gaussian.values()]) - 0.05) < 3 * np.sqrt(0.05 * 0.95 / 200)
    skewed = compare({"a": single(rng.exponential(1, 60)), "b": single(rng.normal(0, 1, 60))})
    assert skewed.lilliefors_p["a"] < 0.01
    assert np.isnan(compare({"a": single(range(3)), "b": single(range(4))}).lilliefors_p["a"])


def test_what_cannot_be_compared_is_refused() -> None:
    with refused("too-few-groups", InputError):
        compare({"a": single([1, 2])})
    with refused("too-few-values", InputError):
        compare({"a": single([1]), "b": single([1, 2])})
    with pytest.raises(InputError, match="not finite"):
        compare({"a": single([1, np.nan]), "b": single([1, 2])})


def test_a_line_gives_its_slope_and_what_a_new_point_may_be(rng) -> None:
    hits = 0
    for _ in range(300):
        x = rng.uniform(0, 10, 12)
        line = fit_line(x, 2 * x + 1 + rng.normal(0, 1, 12))
        new_x = rng.uniform(0, 10)
        _, low, high = line.at(new_x)
        hits += low <= 2 * new_x + 1 + rng.normal() <= high
    assert_allclose(hits / 300, 0.9, atol=0.05)
    exact = fit_line(np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0, 5.0]))
    assert_allclose([exact.slope, exact.start, exact.adjusted_r2], [2, 1, 1])


@pytest.mark.parametrize("count", [2, 3, 5])
def test_an_interval_of_few_trials_holds_the_mean_as_often_as_it_says(rng, count) -> None:
    """In 90 % of 2000; the normal law's 1.645 for Student's quantile would in 64, 77 and 83 %."""
    held = [low <= 4.0 <= high for low, high in (
        mean_interval(list(4.0 + 0.3 * rng.standard_normal(count)), 0.9) for _ in range(2000)
    )]  # fmt: skip
    assert abs(np.mean(held) - 0.9) < 0.02


def test_an_interval_contains_an_error_that_all_trials_share(rng) -> None:
    """Scatter of 0.1, a shared error of 0.3, means of three: held in 90 % of 2000, in under half without."""
    held = np.zeros(2)
    for _ in range(2000):
        values = list(0.3 * rng.standard_normal() + 0.1 * rng.standard_normal(3))
        for i, sd in enumerate((0.3, 0.0)):
            low, high = mean_interval(values, 0.9, known_sd=sd)
            held[i] += low <= 0 <= high
    assert abs(held[0] / 2000 - 0.9) < 0.02
    assert held[1] / 2000 < 0.5


def test_an_interval_needs_two_finite_values() -> None:
    for values in ([1.0], [1.0, np.nan]):
        with refused("too-few-values", InputError):
            mean_interval(values)
    assert mean_interval([2.0, 2.0]) == (2.0, 2.0)
