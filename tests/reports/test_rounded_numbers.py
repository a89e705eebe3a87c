"""Digits of a number are those that its interval bears out."""

import math

import numpy as np
import pytest

from palpate.core.units import decimals_for, half_width_text, rounded
from palpate.estimators.model_card import ScoreCard
from palpate.reports.terminal_text import explained_half_width, mean_error_half_width, percent


@pytest.mark.parametrize(
    ("value", "half", "shown"),
    [
        (1.83456, 0.2137, "1.83"),
        (1.83456, 6.2, "1.8"),
        (183.456, 620, "180"),
        (12355, 340, "12360"),
        (5.0, 0.0999, "5.00"),  # 0.0999 rounds to 0.10
        (5.0, 0.0994, "5.000"),
        (-0.004, 0.12, "0.00"),
        (0.3, math.inf, "0.3"),
        (math.nan, 0.1, "–"),
    ],
)
def test_a_value_ends_where_its_interval_s_second_digit_does(value, half, shown) -> None:
    assert rounded(value, half) == shown


def test_a_half_width_keeps_two_digits_at_every_size(rng) -> None:
    for half in 10 ** rng.uniform(-6, 6, 500):
        shown = half_width_text(half)
        assert float(shown) == pytest.approx(half, rel=0.05)
        digits = shown.replace(".", "").lstrip("0")
        assert len(digits) == 2 or (half >= 99.5 and set(digits[2:]) == {"0"})


def test_what_is_cut_off_is_less_than_a_tenth_of_the_interval(rng) -> None:
    for value, half in zip(rng.normal(0, 100, 500), 10 ** rng.uniform(-4, 3, 500), strict=True):
        off = abs(float(rounded(value, half)) - value)
        assert off <= 0.0501 * half
        assert 10.0 ** -decimals_for(half) >= 0.01 * half


def score(error: np.ndarray, r2: float = 0.9) -> ScoreCard:
    return ScoreCard(
        unit="mm", n=len(error), mae=float(np.abs(error).mean()), rmse=float(np.sqrt((error**2).mean())),
        bias=0.0, r2=r2, mean_mae=1.0, coverage_90=0.9, coverage_90_low=0.86, coverage_90_high=0.94,
        half_width=0.5,
    )  # fmt: skip


def test_a_mean_error_s_interval_holds_it_at_its_rate() -> None:
    """Of 400 recordings of 100 errors, 95 % of the intervals hold the mean size of a normal error."""
    rng, truth = np.random.default_rng(1), math.sqrt(2 / math.pi)
    found = [score(rng.normal(size=100)) for _ in range(400)]
    held = sum(abs(one.mae - truth) <= mean_error_half_width(one, 100) for one in found)
    assert 0.92 <= held / 400 <= 0.98


def test_rows_of_one_group_do_not_make_a_mean_error_surer() -> None:
    one = score(np.random.default_rng(0).normal(size=400))
    assert mean_error_half_width(one, 25) == pytest.approx(4 * mean_error_half_width(one, 400))
    assert mean_error_half_width(one, 10_000) == mean_error_half_width(one, 400)  # no more groups than rows


def test_r_squared_s_interval_holds_it_at_its_rate() -> None:
    rng, truth = np.random.default_rng(2), 0.8
    held = 0
    for _ in range(400):
        true = rng.normal(size=200)
        error = rng.normal(0, math.sqrt(1 - truth), 200)
        r2 = 1 - (error**2).mean() / true.var()
        held += abs(r2 - truth) <= explained_half_width(score(error, r2), 200)
    assert 0.92 <= held / 400 <= 0.98


def test_a_share_is_written_to_the_place_of_its_interval() -> None:
    assert percent(0.8963, 0.862, 0.924) == "89.6"
    assert percent(0.8963, 0.5, 0.99) == "90"
    assert percent(0.8963, 0.8951, 0.8975) == "89.6"  # a second decimal of a rate is read by nobody
