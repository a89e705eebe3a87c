import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate_reproductions.palm.palm_published import interval_of_mean, scores_of

COLUMNS = ("x_mm", "y_mm", "force_N")


def table(errors: np.ndarray, places: int) -> pd.DataFrame:
    rng = np.random.default_rng(0)
    true = rng.uniform(0, 10, errors.shape)
    made: dict[str, object] = {"location": [f"p{i % places}" for i in range(len(errors))]}
    for j, column in enumerate(COLUMNS):
        made |= {column: true[:, j], f"estimate:{column}": true[:, j] + errors[:, j]}
        made[f"half_width:{column}"] = np.full(len(errors), 1.0)
    return pd.DataFrame(made)


def test_errors_are_averaged_and_places_by_their_distance():
    found = scores_of(table(np.tile([3.0, -4.0, 0.5], (20, 1)), 5), COLUMNS)
    assert found["place_mm"]["mae"] == pytest.approx(5.0)
    assert found["x_mm"]["mae"] == pytest.approx(3.0)
    assert found["y_mm"]["rmse"] == pytest.approx(4.0)
    assert found["force_N"]["coverage"] == 1.0
    assert found["x_mm"]["coverage"] == 0.0
    assert found["force_N"]["groups"] == 5


@given(st.integers(0, 1000))
def test_a_mean_distance_lies_between_the_root_of_squares_and_the_sum(seed):
    errors = np.random.default_rng(seed).standard_normal((30, 3))
    found = scores_of(table(errors, 6), COLUMNS)
    x, y, away = (found[name]["mae"] for name in ("x_mm", "y_mm", "place_mm"))
    assert math.hypot(x, y) - 1e-9 <= away <= x + y + 1e-9


def test_frames_of_one_place_count_as_one():
    """Of errors that are the place's own, many frames a place make the interval no narrower."""
    rng = np.random.default_rng(1)
    own = np.abs(rng.standard_normal(10))
    few = interval_of_mean(own, np.arange(10))
    many = interval_of_mean(np.repeat(own, 50), np.repeat(np.arange(10), 50))
    assert many == pytest.approx(few)
    alone = interval_of_mean(np.repeat(own, 50), np.arange(500))
    assert alone[1] - alone[0] < 0.3 * (many[1] - many[0])


def test_intervals_of_a_mean_hold_it():
    """Of 95 % percentile intervals over 30 groups, 88 % or more hold the mean of 1000 draws' own law."""
    rng = np.random.default_rng(2)
    held = 0
    for i in range(200):
        values = rng.exponential(1.0, 30)
        low, high = interval_of_mean(values, np.arange(30), seed=i, draws=500)
        held += low <= 1.0 <= high
    assert held >= 176


def test_rows_that_were_not_read_are_left_out_and_none_is_refused():
    errors = np.tile([0.1, 0.1, 0.1], (8, 1))
    some = table(errors, 4)
    some.loc[0, "estimate:force_N"] = np.nan
    assert scores_of(some, COLUMNS)["force_N"]["n"] == 7
    some["estimate:force_N"] = np.nan
    with refused("no-reading", InputError):
        scores_of(some, COLUMNS)
