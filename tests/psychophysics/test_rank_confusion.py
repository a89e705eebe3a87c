"""Rankings: confusions add up, accuracies come from counts, correlations are exact."""

from itertools import permutations

import numpy as np
import pytest
from scipy import stats
from tests.refusals import refused

from palpate.core import InputError
from palpate.psychophysics import Condition, Judgement, Presentation, Stimulus, Task
from palpate.psychophysics.analysis import (
    RankConfusion,
    confusion_of_places,
    rank_confusion,
    rank_correlation,
)

NAMES = ("SS1", "SS2", "SS3", "SS4", "SS5")
STIMULI = {name: Stimulus(name, 100.0 - 10 * i, -1, "kPa") for i, name in enumerate(NAMES)}


def ranking(answer: str, trial: int = 1, presented: tuple[str, ...] = NAMES) -> Judgement:
    order = tuple(f"SS{i}" for i in answer)
    return Judgement(
        "P1", Condition.INTEGRATED, Presentation.DIRECT, Task.RANK, 1, trial, presented[::-1], order
    )


def test_a_matrix_counts_true_places_in_rows_and_places_given_in_columns() -> None:
    found = rank_confusion([ranking("12345"), ranking("31245", 2)], STIMULI)
    assert found.names == NAMES
    assert found.counts.tolist() == [
        [1, 1, 0, 0, 0], [0, 1, 1, 0, 0], [1, 0, 1, 0, 0], [0, 0, 0, 2, 0], [0, 0, 0, 0, 2],
    ]  # fmt: skip
    assert (found.rankings, found.right, found.total_accuracy) == (2, 7, 0.7)
    assert found.relative_accuracy.tolist() == [0.5, 0.5, 0.5, 1.0, 1.0]


def test_a_matrix_that_no_rankings_make_is_refused() -> None:
    counts = np.full((5, 5), 6)
    RankConfusion(NAMES, counts)
    for change in ((0, 1, 1), (2, 2, -1)):
        wrong = counts.copy()
        wrong[change[0], change[1]] += change[2]
        with refused("matrix-sums", InputError):
            RankConfusion(NAMES, wrong)
    with refused("matrix-shape", InputError):
        RankConfusion(NAMES, counts[:4])
    with refused("not-a-permutation", InputError):
        confusion_of_places(NAMES, np.array([[0, 1, 2, 3, 3]]))


def test_rankings_of_other_stimuli_are_not_mixed() -> None:
    with refused("stimuli-differ", InputError):
        rank_confusion([ranking("12345"), ranking("123", 2, NAMES[:3])], STIMULI)


def test_correlations_of_a_ranking_are_scipy_s_and_their_p_counts_all_orders() -> None:
    orders = np.array(list(permutations(range(5))))
    taus = np.array([stats.kendalltau(range(5), one).statistic for one in orders])
    for places in ([0, 1, 2, 3, 4], [1, 0, 2, 3, 4], [4, 3, 2, 1, 0], [2, 0, 4, 1, 3]):
        found = rank_correlation(places)
        assert found.tau == pytest.approx(stats.kendalltau(range(5), places).statistic)
        assert found.rho == pytest.approx(stats.spearmanr(range(5), places).statistic)
        assert found.tau_p == pytest.approx(np.mean(np.abs(taus) >= abs(found.tau) - 1e-9))
        rhos = np.array([1 - 6 * np.sum((one - np.arange(5)) ** 2) / 120 for one in orders])
        assert found.rho_p == pytest.approx(np.mean(np.abs(rhos) >= abs(found.rho) - 1e-9))
    assert rank_correlation([0, 1, 2, 3, 4]).tau_p == pytest.approx(2 / 120)
    assert rank_correlation([4, 3, 2, 1, 0]).tau == pytest.approx(-1)
    with refused("not-a-permutation", InputError):
        rank_correlation([0, 0, 1])
