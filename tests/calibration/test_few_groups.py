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


def rates(groups: int, growth: float, seeds: int = 10) -> np.ndarray:
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
        worlds = (world(np.random.default_rng(seed), 40, growth) for seed in range(10))
        return float(np.mean([spread_terms(p, np.abs(t - p), g)[0] > 1 for p, t, g in worlds]))

    assert follows(0.0) < 0.15
    assert follows(8.0) > 0.9


def test_of_several_targets_the_errors_that_grow_are_followed_by_fewer_terms_where_all_are_too_many() -> None:
    """A quadratic of three has ten terms, too many for thirty groups; one width held 0.8 of the top third."""
    high = []
    for seed in range(6):
        rng = np.random.default_rng(seed)

        def drawn(groups: int, rng=rng):
            parts = [world(rng, groups, 8.0) for _ in range(3)]
            return *(np.concatenate([part[k] for part in parts], axis=1) for k in (0, 1)), parts[0][2]

        intervals = fit_intervals(*drawn(30), 0.9)
        estimate, true, _ = drawn(200)
        high.append(intervals.hold(estimate, true)[estimate > 2 / 3].mean())
    assert 0.87 < np.mean(high) < 0.95


def test_so_few_groups_that_a_rank_of_rows_promises_too_much_are_not_held_to_one_scale() -> None:
    """Rows of a group err alike, and the quantile's rank is raised by a row alone: of five groups 0.83."""
    held = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        error = np.repeat(rng.standard_normal(5), ROWS)[:, None]
        estimate = np.repeat(rng.uniform(0, 1, 5), ROWS)[:, None]
        intervals = fit_intervals(estimate, estimate + error, np.repeat(np.arange(5), ROWS), 0.9)
        fresh = rng.uniform(0, 1, (200, 1))
        held.append(intervals.hold(fresh, fresh + rng.standard_normal((200, 1))).mean())
    assert 0.87 < np.mean(held) < 0.93


def test_each_target_has_a_width_of_its_own_and_many_groups_follow_always() -> None:
    rng = np.random.default_rng(1)
    predicted, true, group = world(rng, 40, 0.0)
    steady = np.abs(true - predicted)
    grown = steady * (1 + 8 * np.clip(predicted, 0, 1))
    first, second = spread_terms(predicted, np.concatenate([steady, grown], axis=1), group)
    assert (first, second > 1) == (1, True)
    predicted, true, group = world(rng, MANY_GROUPS, 0.0)
    assert spread_terms(predicted, np.abs(true - predicted), group) == (3,)
