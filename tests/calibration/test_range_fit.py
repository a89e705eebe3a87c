"""Intervals keep their rate in every tenth of the range, and a tenth that does not is named."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, norm

from palpate.calibration.certificate import interval_fields
from palpate.calibration.coverage.conformal import (
    conformal_quantile,
    fit_intervals,
    grouped_quantile,
    pooled_quantile,
)
from palpate.calibration.coverage.range_scores import (
    chance_of_so_few,
    failing,
    range_cards,
    range_scores,
    usual_reach,
)
from palpate.estimators.intervals import ErrorCells, Intervals, intervals_of
from palpate.estimators.model_card import Card, ScoreCard, TargetCard, TenthCard

SCORE = ScoreCard(
    unit="mm", n=1, mae=1, rmse=1, bias=0, r2=0, mean_mae=2,
    coverage_90=1, coverage_90_low=0, coverage_90_high=1, half_width=1,
)  # fmt: skip


def drawn_to_the_middle(
    rng: np.random.Generator, n: int, per: int, share: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimates, truths from 0 to 10, and groups: errors skewed, growing with the truth, alike in a group."""
    groups, true = np.repeat(np.arange(n // per), per), rng.uniform(0, 10, (n, 1))
    noise = rng.standard_normal((n, 1))
    if per > 1:
        noise = 0.6 * noise + 0.8 * rng.standard_normal((n // per, 1))[groups]
    skewed = np.exp(0.7 * noise) - np.exp(0.7**2 / 2)
    return 5 + share * (true + (0.2 + 0.1 * true) * skewed - 5), true, groups


def rates(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Coverage of the tenths of the rows, from the least of some values to the greatest."""
    return np.array([inside[rows].mean() for rows in np.array_split(np.argsort(values), 10)])


@pytest.mark.parametrize(("n", "per", "share"), [(2000, 1, 0.8), (700, 7, 0.8), (2000, 1, 0.05)])
@pytest.mark.cases(1)
def test_every_tenth_of_truths_and_of_estimates_is_covered_at_the_stated_rate(n, per, share) -> None:
    """One width for all is the negative control: it fails at an end by more than 8 %."""
    new, old = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        intervals = fit_intervals(*drawn_to_the_middle(rng, n, per, share), 0.9)
        fresh, true, _ = drawn_to_the_middle(rng, 7000, per, share)
        held = intervals.hold(fresh, true)[:, 0]
        one_width = (np.abs(fresh - true) <= intervals.half_widths(fresh))[:, 0]
        for inside, found in ((held, new), (one_width, old)):
            found.append([rates(true[:, 0], inside), rates(fresh[:, 0], inside)])
    assert np.mean(old, axis=0).min() < 0.82
    assert np.mean(new, axis=0).min() > 0.9 - 2 * 0.017
    assert np.mean(new) < 0.97


def test_truths_that_cells_keep_are_those_found_by_trying_each() -> None:
    cells = ErrorCells(np.array([2.0, 6.0]), np.array([0.5, -0.2, -3.0]), np.array([1.0, 0.0, 0.5]))
    estimate, spread = np.linspace(-3, 12, 61), np.linspace(0.2, 2.0, 61)
    low, high = cells.of_truths(estimate, spread)
    tried = np.linspace(-30, 40, 70_001)
    at = cells.cells(tried)
    for k in range(61):
        kept = np.abs((tried - estimate[k]) / spread[k] - cells.centre[at]) <= cells.half[at]
        kept = tried[kept & (cells.half[at] > 0)]
        if len(kept):
            assert (low[k], high[k]) == pytest.approx((kept.min(), kept.max()), abs=2e-3)
        else:
            assert low[k] > high[k] or high[k] - low[k] < 2e-3


def test_each_press_counts_once_however_many_rows_it_has() -> None:
    """One press of 400 rows that errs ten times as much sets no quantile of thirty presses."""
    rng = np.random.default_rng(0)
    scores = np.append(rng.normal(1, 0.1, 29 * 4), rng.normal(10, 0.1, 400))
    groups = np.append(np.repeat(np.arange(29), 4), np.full(400, 29))
    for found in (grouped_quantile(scores, groups, 0.9), pooled_quantile(scores, groups, 0.9)):
        assert 1.0 < found < 1.5
    assert conformal_quantile(scores, 0.9) > 9


@pytest.mark.parametrize("rows", [(4, 60), (60, 4)])
@pytest.mark.parametrize("count", [15, 60])
@pytest.mark.cases(1)
def test_intervals_hold_in_a_new_press_where_presses_that_err_more_have_other_sizes(count, rows) -> None:
    """Rows pooled, the negative control, hold 77 % where presses that err more are short, 97 % where long."""
    rng, new, old = np.random.default_rng(7), [], []
    for _ in range(300):
        bad = rng.random(count) < 0.2
        groups = np.repeat(np.arange(count), np.where(bad, *rows))
        scores = np.abs(rng.standard_normal(len(groups))) * np.where(bad, 3.0, 0.5)[groups]
        for quantile, found in (
            (pooled_quantile(scores, groups, 0.9), new),
            (conformal_quantile(scores, 0.9), old),
        ):
            found.append(0.2 * (2 * norm.cdf(quantile / 3) - 1) + 0.8 * (2 * norm.cdf(quantile / 0.5) - 1))
    assert np.mean(new) == pytest.approx(0.9, abs=0.015)
    assert abs(np.mean(old) - 0.9) > 0.05


def card_of(intervals: Intervals, estimate: np.ndarray, true: np.ndarray, groups: np.ndarray) -> TargetCard:
    (over,) = range_cards(intervals, estimate, true, groups, [(0.0, 10.0)])
    return TargetCard(
        column="depth_mm", quantity="depth", unit="mm", training_mean=5.0, score=SCORE,
        least=float(true.min()), greatest=float(true.max()), **interval_fields(intervals, 0, over),
    )  # fmt: skip


def test_a_card_gives_the_same_intervals_again() -> None:
    data = drawn_to_the_middle(np.random.default_rng(6), 2000, 1, 0.6)
    intervals = fit_intervals(*data, 0.9)
    target = TargetCard.model_validate_json(card_of(intervals, *data).model_dump_json())
    again = intervals_of(Card.model_construct(targets=(target,), coverage=0.9))
    assert again.by_range[0] is not None
    for was, now in zip(intervals.ends(data[0]), again.ends(data[0]), strict=True):
        np.testing.assert_array_equal(was, now)


def test_few_hits_are_as_probable_as_the_binomial_says_and_groups_count_once() -> None:
    inside = np.arange(40) < 30
    assert chance_of_so_few(inside, np.arange(40), 0.85) == pytest.approx(binom.cdf(30, 40, 0.85))
    # Rows that always agree within their groups of four are ten rows, nearly: 7.5 of 10 groups.
    grouped = chance_of_so_few(np.repeat(np.arange(8) < 6, 5), np.repeat(np.arange(8), 5), 0.85)
    assert grouped == pytest.approx(binom.cdf(6, 8, 0.85), abs=0.08)
    assert grouped > 3 * chance_of_so_few(np.arange(40) < 30, np.arange(40), 0.85)
    assert chance_of_so_few(np.ones(5, bool), np.arange(5), 0.85) == 1


def tenth(p: float, start: float = 0.0, bias: float = -3.0) -> TenthCard:
    return TenthCard(start=start, end=start + 1, n=20, groups=20, covered=14, bias=bias, p=p)


def test_holm_names_the_tenths_that_fail_and_no_others() -> None:
    assert failing([tenth(0.012), tenth(0.2), tenth(0.016), tenth(0.5)]) == (tenth(0.012), tenth(0.016))
    assert failing([tenth(0.013), tenth(0.2), tenth(0.5), tenth(0.001)]) == (tenth(0.013), tenth(0.001))
    assert failing([tenth(0.02), tenth(0.2), tenth(0.5), tenth(0.9)]) == ()


@pytest.mark.parametrize(("count", "per", "correlation"), [(15, 100, 0.1), (40, 50, 0.1), (20, 30, 0.2)])
@pytest.mark.cases(1)
def test_tenths_of_few_presses_that_keep_the_rate_are_seldom_named(count, per, correlation) -> None:
    """A tenth has two to four presses: their own scatter as the design effect names up to 20 % of targets."""
    rng, own, named = np.random.default_rng(count), (1 - correlation) / correlation, 0
    for _ in range(300):
        rates, true = rng.beta(0.85 * own, 0.15 * own, count), rng.uniform(0, 1, count)
        true, groups = np.repeat(true, per), np.repeat(np.arange(count), per)
        inside = rng.uniform(size=count * per) < rates[groups]
        named += bool(failing(range_scores(true, true * 0, inside, groups, (0.0, 1.0), 0.9)))
    assert named / 300 <= 0.06


@pytest.mark.parametrize("rows_a_group", [1, 3])
@pytest.mark.parametrize("at_the_end", [0, 1, 4, 20])
@pytest.mark.cases(1)
def test_good_frames_at_an_end_with_few_groups_are_refused_at_the_promised_rate(at_the_end, rows_a_group):
    """Labels crowd in the lower half; the frames are of the last tenth of the range, and of its very end."""
    rng, refused = np.random.default_rng(4), []
    for _ in range(200):
        true = np.append(rng.uniform(0, 5, 200 - at_the_end), rng.uniform(9.5, 10, at_the_end))
        true, groups = np.repeat(true, rows_a_group), np.repeat(np.arange(200), rows_a_group)
        estimate = true + 0.3 * rng.standard_normal(len(true))
        _, above = usual_reach(true, estimate, estimate, groups, (0.0, 10.0))
        below, _ = usual_reach(10 - true, 10 - estimate, 10 - estimate, groups, (0.0, 10.0))
        assert below == pytest.approx(above)
        fresh = np.array([rng.uniform(9, 10, 400), np.full(400, 10.0), np.full(400, 11.2)])
        refused.append(np.mean(fresh + 0.3 * rng.standard_normal(fresh.shape) - 10 > above, axis=1))
    in_the_tenth, at_the_very_end, beyond = np.mean(refused, axis=0)
    assert in_the_tenth < at_the_very_end <= 0.033
    assert at_the_very_end > 0.005  # or it would refuse nothing
    assert beyond > 0.9
