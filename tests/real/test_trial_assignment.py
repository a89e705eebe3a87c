"""Trials assigned to objects, each by all others, and how likely luck does as well."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.real.trial_assignment import assign, nearest
from tests.refusals import refused

from palpate.core.errors import InputError

BALLS = ["soft"] * 3 + ["middling"] * 3 + ["hard"] * 3


def trials(rng, apart: float, features: int = 1) -> np.ndarray:
    """Nine trials whose means lie so many standard deviations apart."""
    return rng.normal(np.repeat([0.0, 1.0, 2.0], 3)[:, None] * apart, 1.0, (9, features))


def by_hand(x: np.ndarray, labels: list[str]) -> list[str]:
    """The rule as its sentence says it, one trial after the other."""
    found = []
    names = sorted(set(labels))
    for i in range(len(x)):
        rest = {n: np.array([x[j] for j in range(len(x)) if j != i and labels[j] == n]) for n in names}
        spread = sum(((v - v.mean(0)) ** 2).sum(0) for v in rest.values()) / (len(x) - 1 - len(names))
        found.append(min(names, key=lambda n: (((x[i] - rest[n].mean(0)) ** 2) / spread).sum()))
    return found


def test_objects_far_apart_are_all_told_and_luck_could_not(rng) -> None:
    found = assign(trials(rng, 100.0), BALLS, rng)
    assert found.assigned == found.labels
    assert found.right == 9
    assert found.exact
    # 9! / 3!^3 labellings, of which the 3! that swap names score the same
    assert found.labellings == 1680
    assert_allclose(found.p, 6 / 1680)
    assert_allclose(found.least_p, 6 / 1680)


@pytest.mark.parametrize("features", [1, 2, 3])
def test_the_rule_is_its_sentence(rng, features) -> None:
    for _ in range(10):
        x = trials(rng, 1.5, features)
        assert list(assign(x, BALLS, rng).assigned) == by_hand(x, BALLS)


def test_objects_that_do_not_differ_are_told_no_better_than_by_chance(rng) -> None:
    """Leaving one out is a little below a third: the trial's own object has lost one of its own."""
    right = [assign(rng.normal(size=9), BALLS, rng).right for _ in range(40)]
    # 40 x 9 trials at about 0.3: three standard errors are 0.07
    assert 0.2 < np.mean(right) / 9 < 0.4


def test_p_is_small_no_more_often_than_it_says_where_objects_do_not_differ(rng) -> None:
    p = np.array([assign(rng.normal(size=9), BALLS, rng).p for _ in range(100)])
    for level in (0.05, 0.2):
        # three standard errors of 100 draws above the level
        assert (p <= level).mean() <= level + 3 * math.sqrt(level * (1 - level) / 100)


def test_units_and_origins_of_features_do_not_matter(rng) -> None:
    x = trials(rng, 2.0, 2)
    turned = x * [1e6, 1e-9] + [5.0, -3.0]
    assert assign(x, BALLS, rng).assigned == assign(turned, BALLS, rng).assigned


def test_order_of_trials_does_not_matter(rng) -> None:
    x, order = trials(rng, 1.5, 2), rng.permutation(9)
    shuffled = assign(x[order], [BALLS[i] for i in order], rng)
    straight = assign(x, BALLS, rng)
    assert shuffled.assigned == tuple(straight.assigned[i] for i in order)
    assert_allclose(shuffled.p, straight.p)


def test_many_labellings_are_drawn_and_p_is_never_zero(rng) -> None:
    labels = [name for name in "abcde" for _ in range(3)]
    found = assign(np.repeat(np.arange(5.0), 3) + rng.normal(0, 1e-3, 15), labels, rng, draws=200)
    assert not found.exact
    assert found.right == 15
    assert_allclose([found.p, found.least_p], 1 / 201)


def test_drawn_and_exact_p_agree(rng, monkeypatch) -> None:
    x = trials(rng, 1.0)
    exact = assign(x, BALLS, rng)
    monkeypatch.setattr("tests.real.trial_assignment.EXACT_UP_TO", 10)
    drawn = assign(x, BALLS, rng, draws=4000)
    assert_allclose(drawn.p, exact.p, atol=4 * math.sqrt(exact.p * (1 - exact.p) / 4000) + 1 / 4000)


def test_another_trial_goes_to_the_object_that_it_is_like(rng) -> None:
    x = trials(rng, 50.0)
    assert nearest(x, BALLS, [1.0, 51.0, 1000.0]) == ("soft", "middling", "hard")


def test_repeats_that_are_all_alike_are_told(rng) -> None:
    assert assign(np.repeat([1.0, 2.0, 3.0], 3), BALLS, rng).right == 9


@pytest.mark.parametrize(
    ("features", "labels", "code"),
    [
        ([1.0, 2.0, np.nan], ["a", "a", "b"], "lengths-differ"),
        ([1.0, 2.0], ["a", "a", "b"], "lengths-differ"),
        ([1.0, 2.0, 3.0], ["a", "a", "b"], "too-few-trials"),
        ([1.0, 2.0, 3.0], ["a", "a", "a"], "too-few-trials"),
        ([1.0, 1.0, 1.0, 1.0], ["a", "a", "b", "b"], "feature-constant"),
    ],
)
def test_what_cannot_be_assigned_is_refused(rng, features, labels, code) -> None:
    with refused(code, InputError):
        assign(features, labels, rng)


def test_others_with_other_features_are_refused(rng) -> None:
    with refused("feature-count", InputError):
        nearest(trials(rng, 1.0), BALLS, [[1.0, 2.0]])
