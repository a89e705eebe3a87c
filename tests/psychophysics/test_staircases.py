"""Staircases settle where their rule says, and the Bayesian placement asks where an answer tells most."""

import math

import numpy as np
import pytest
from scipy.special import ndtr
from tests.refusals import refused

from palpate.core import InputError
from palpate.psychophysics.experiments import StaircaseRule
from palpate.psychophysics.experiments.adaptive_placement import Placement, begin_staircase, step_staircase


@pytest.mark.parametrize(("right", "share"), [(1, 0.5), (2, 0.70711), (3, 0.79370), (4, 0.84090)])
def test_one_up_n_down_settles_at_levitt_s_shares(right: int, share: float) -> None:
    assert StaircaseRule(right).converges_to == pytest.approx(share, abs=5e-6)
    # The other way round it is the mirror: n wrong answers for a step away.
    assert StaircaseRule(1, right).converges_to == pytest.approx(1 - share, abs=5e-6)


@pytest.mark.parametrize(
    "rule", [(1, 1, 1), (2, 1, 1), (3, 1, 1), (4, 1, 1), (1, 1, 3), (2, 1, 2), (3, 2, 1), (1, 2, 1)]
)
def test_the_answers_of_a_long_staircase_are_right_as_often_as_its_rule_says(rule) -> None:
    right, wrong, ratio = rule
    places = 1200
    law = StaircaseRule(right, wrong, (1,), ratio, reversals=10**9, max_trials=10**9)
    rng = np.random.default_rng(5)
    draws, answers = rng.random(40_000), 0
    chance = ndtr((np.arange(places) - 600) / 120.0)  # so wide that a step changes next to nothing
    state = begin_staircase(places)
    for k, draw in enumerate(draws):
        got = bool(draw < chance[state.place])
        answers += got if k >= 5000 else 0
        state = step_staircase(law, places, state, got)
        state = type(state)(state.place, state.trials, (), state.way, state.in_row)
    assert answers / 35_000 == pytest.approx(law.converges_to, abs=0.02)


def followed(rule: StaircaseRule, places: int, answers: str) -> tuple[list[int], object]:
    state = begin_staircase(places)
    went = [state.place]
    for one in answers:
        state = step_staircase(rule, places, state, one == "r")
        went.append(state.place)
    return went, state


def test_a_two_down_one_up_track_goes_as_by_hand() -> None:
    rule = StaircaseRule(2, 1, (3, 1), 1, reversals=4, max_trials=99)
    went, state = followed(rule, 10, "rrrrwrrwrw")
    #         r  r  r  r  w  r  r  w  r  w    begins at 9: two right, 3 nearer; a wrong one turns it
    assert went == [9, 9, 6, 6, 3, 4, 4, 3, 4, 4, 5]
    assert state.reversals == (3, 4, 3)
    assert not state.ended
    assert state.threshold == pytest.approx(3.5), "the first reversal is left out, and an even number kept"
    _, state = followed(rule, 10, "rrrrwrrwrwrr")
    assert state.reversals == (3, 4, 3, 5)
    assert state.threshold == pytest.approx(4.0), "of 4, 3 and 5 the last two"
    assert state.ended
    with refused("staircase-ended", InputError):
        step_staircase(rule, 10, state, True)


def test_an_end_of_the_set_is_no_reversal_and_max_trials_end_a_track() -> None:
    rule = StaircaseRule(1, 1, (1,), 1, reversals=4, max_trials=6)
    went, state = followed(rule, 3, "wwrrrr")
    assert went == [2, 2, 2, 1, 0, 0, 0]
    assert state.reversals == (2,)
    assert state.ended
    assert math.isnan(state.threshold)
    with refused("staircase-comparison", InputError):
        begin_staircase(0)
    with refused("staircase-rule", InputError):
        StaircaseRule(reversals=1)


def test_a_known_observer_is_found_and_asked_near_the_middle() -> None:
    x = np.linspace(-50.0, 50.0, 20)
    rng = np.random.default_rng(2)
    means, spreads = [], []
    for _ in range(6):
        placement = Placement.of_differences(x.tolist())
        asked = []
        for _ in range(60):
            k = placement.next
            asked.append(abs(x[k] - 8.0))
            placement = placement.after(k, bool(rng.random() < ndtr((x[k] - 8.0) / 12.0)))
        means.append(placement.mean[0])
        spreads.append(placement.mean[1])
        assert np.median(asked) < 20.0
    assert np.mean(means) == pytest.approx(8.0, abs=1.5)
    assert np.mean(spreads) == pytest.approx(12.0, rel=0.2)


@pytest.mark.parametrize("x", [[1.0], [1.0, 0.0], []])
def test_a_placement_without_two_comparisons_is_refused(x) -> None:
    with pytest.raises(InputError, match="two comparisons"):
        Placement.of_differences(x)


def test_thirty_placements_and_the_posterior_are_those_of_questplus() -> None:
    # Made once by questplus 2023.1 (GPL, and so no part of this project), function norm_cdf, the same grid of
    # m and s, lower asymptote and lapse rate 0.01: the comparison that these answers ask for.
    x = [-60.0, -35.0, -18.0, -6.0, 7.0, 15.0, 33.0, 52.0]
    answers = "nynynynynnnnyynnnnnyynnnynynyy"
    asked = [
        -6, 7, -6, 7, -6, 7, -6, 7, -6, 7, 15, -35, 33, 33, 33, -35, -35, -35, -35, 52, 33, 33, -35, -35, 52,
        -18, 52, -18, 52, 33,
    ]  # fmt: skip
    whole = Placement.of_differences(x)
    kept = whole.lapse == 0.02
    even = np.full(kept.sum(), 1 / kept.sum())
    placement = Placement(whole.x, whole.equality[kept], whole.spread[kept], whole.lapse[kept], even)
    for one, answer in zip(asked, answers, strict=True):
        assert x[placement.next] == one
        placement = placement.after(placement.next, answer == "y")
    assert placement.mean[0] == pytest.approx(14.817541228430716, rel=1e-9)
    assert placement.weight @ placement.spread == pytest.approx(25.117306302464563, rel=1e-9)
