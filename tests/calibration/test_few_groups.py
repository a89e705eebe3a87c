"""Widths of few groups: one width where following the estimate foretells nothing, following where it does."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.calibration.coverage.conformal import MANY_GROUPS, fit_intervals, spread_terms

ROWS = 8  # of a group


def world(rng: np.random.Generator, groups: int, growth: float):
    """Estimates, truths and groups, whose errors go together and grow with the estimate."""
    group = np.repeat(np.arange(groups), ROWS)
    estimate = np.repeat(rng.uniform(0, 1, groups), ROWS) + 0.02 * rng.standard_normal(groups * ROWS)
    drawn = 0.8 * np.repeat(rng.standard_normal(groups), ROWS) + 0.6 * rng.standard_normal(groups * ROWS)
    true = estimate + 0.1 * drawn * (1 + growth * np.clip(estimate, 0, 1))
    return estimate[:, None], true[:, None], group


def rates(groups: int, growth: float, seeds: int = 40) -> np.ndarray:
    """Share held of all new rows, of those in the lowest and in the highest third; and of what was scored."""
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        learnt = world(rng, groups, growth)
        estimate, true, _ = world(rng, 300, growth)
        intervals = fit_intervals(*learnt, 0.9)
        held = intervals.hold(estimate, true)[:, 0]
        x = estimate[:, 0]
        found.append((held.mean(), held[x < 1 / 3].mean(), held[x > 2 / 3].mean()))
    return np.mean(found, axis=0)


@pytest.mark.parametrize("growth", [0.0, 8.0])
def test_forty_groups_hold_new_rows_at_their_rate_in_each_part_of_the_range(growth: float) -> None:
    whole, low, high = rates(40, growth)
    assert 0.88 < whole < 0.945
    assert 0.86 < low < 0.955
    assert 0.86 < high < 0.955


def test_one_width_is_taken_where_errors_do_not_follow_and_a_following_one_where_they_do() -> None:
    def follows(growth: float) -> float:
        worlds = (world(np.random.default_rng(seed), 40, growth) for seed in range(40))
        return float(np.mean([spread_terms(p, np.abs(t - p), g)[0] > 1 for p, t, g in worlds]))

    assert follows(0.0) < 0.15
    assert follows(8.0) > 0.9


def test_each_target_has_a_width_of_its_own_and_many_groups_follow_always() -> None:
    rng = np.random.default_rng(1)
    predicted, true, group = world(rng, 40, 0.0)
    steady = np.abs(true - predicted)
    grown = steady * (1 + 8 * np.clip(predicted, 0, 1))
    assert spread_terms(predicted, np.concatenate([steady, grown], axis=1), group) == (1, 3)
    predicted, true, group = world(rng, MANY_GROUPS, 0.0)
    assert spread_terms(predicted, np.abs(true - predicted), group) == (3,)
