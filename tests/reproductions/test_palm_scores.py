import numpy as np
import pandas as pd
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
