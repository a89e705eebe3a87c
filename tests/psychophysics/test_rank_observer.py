"""Rank observers: rank matrices against other ways to them."""

import math

import numpy as np
import pytest
from scipy import special
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.psychophysics import judgements
from palpate.psychophysics.analysis import confusion_of_places
from palpate.psychophysics.judgements import RankObserver, gaussian_matrix


def test_two_stimuli_are_ranked_as_a_pair_is_told() -> None:
    one = RankObserver((0.0, 1.3))
    right = special.ndtr(1.3 / math.sqrt(2))
    assert one.rank_matrix() == pytest.approx(np.array([[right, 1 - right], [1 - right, right]]), abs=1e-9)
    assert one.pair_accuracy(0, 1) == one.pair_accuracy(1, 0) == pytest.approx(right)


def test_more_nodes_change_a_matrix_by_less_than_its_stated_error(monkeypatch) -> None:
    places = np.array([0.0, 4.0, 5.0, 8.5, 9.0])
    ours = gaussian_matrix(places)
    monkeypatch.setattr(judgements, "NODES_OF_PERCEPT", 160)
    assert np.abs(gaussian_matrix(places) - ours).max() < judgements.MATRIX_ERROR


@pytest.mark.parametrize(("lapse", "reversal"), [(0.0, 0.0), (0.2, 0.0), (0.1, 0.25)])
def test_a_matrix_is_what_drawn_rankings_come_to_and_sums_to_one(lapse: float, reversal: float) -> None:
    one = RankObserver((0.0, 0.5, 1.6, 2.0, 3.1), lapse, reversal)
    matrix, n = one.rank_matrix(), 40_000
    places = one.drawn_places(n, np.random.default_rng(1))
    found = confusion_of_places(("S1", "S2", "S3", "S4", "S5"), places).counts / n
    assert np.abs(found - matrix).max() < 4.5 * 0.5 / math.sqrt(n)
    assert matrix.sum(axis=0) == pytest.approx(np.ones(5), abs=1e-6)
    assert matrix.sum(axis=1) == pytest.approx(np.ones(5))
    assert one.total_accuracy() == pytest.approx(np.trace(matrix) / 5)


def test_observers_that_cannot_be_are_refused() -> None:
    with refused("too-few-stimuli", InputError):
        RankObserver((1.0,))
    with pytest.raises(RangeError, match="not finite"):
        RankObserver((1.0, math.nan))
    with refused("lapse-and-reversal", RangeError):
        RankObserver((0.0, 1.0), 0.6, 0.5)
