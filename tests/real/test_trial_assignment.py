"""Trials assigned to objects, each by all others, and how likely luck does as well."""

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


def test_another_trial_goes_to_the_object_that_it_is_like(rng) -> None:
    x = trials(rng, 50.0)
    assert nearest(x, BALLS, [1.0, 51.0, 1000.0]) == ("soft", "middling", "hard")


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
