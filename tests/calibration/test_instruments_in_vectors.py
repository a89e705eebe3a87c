"""Joint regions hold the truth where the labels' own instrument is uncertain, and are scored without it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from palpate.calibration.coverage.conformal import fit_intervals, vector_cards
from palpate.core import Reading
from palpate.estimators.intervals import joint_reach, vector_reading
from palpate.estimators.model_card import InstrumentCard
from palpate.estimators.reference_uncertainty import reference_half_width

pytestmark = pytest.mark.usefixtures("changes_untried")

MODEL = 0.3  # standard deviation of the model's errors [N]


def instrument(u: float) -> InstrumentCard:
    return InstrumentCard(
        instrument="scale", certificate="", certified_on="", standard_uncertainty=u, resolution=0.0,
        backlash=0.0, bias_removed=0.0, half_width=reference_half_width(u, 0.9),
    )  # fmt: skip


def reading(value: float) -> Reading:
    return Reading(
        quantity="f", value=value, low=value - 1, high=value + 1, unit="N", coverage=0.9,
        calibrated_range=(0.0, 10.0), valid=True, why="", drift=None, calibration="", frame="", time_s=0.0,
    )  # fmt: skip


def normal(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return rng.standard_normal(shape)


def bounded(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Errors of standard deviation 1 whose region is smaller than a normal one's."""
    return rng.uniform(-(3**0.5), 3**0.5, shape)


@cache
def calibrated(k: int, errors, seed: int):
    """Intervals and a joint region for `k` quantities, from 500 rows."""
    columns, rng = ("f_x_N", "f_y_N", "f_z_N")[:k], np.random.default_rng(seed)
    labels = rng.uniform(0, 10, (500, k))
    outputs = labels + MODEL * errors(rng, (500, k))
    intervals = fit_intervals(outputs, labels, np.arange(500), 0.9)
    return intervals, *vector_cards({"f_N": columns}, columns, intervals, outputs, labels, np.arange(500))


def covered(k: int, u: float, errors, factor: float = 1.0) -> float:
    """Share of truths in the region, each with an instrument of its own; `factor` times u is told to it."""
    shares = []
    for seed in range(5):
        (intervals, card), rng = calibrated(k, errors, seed), np.random.default_rng(100 + seed)
        true = rng.uniform(0, 10, (120, k))
        shown = true + u * rng.standard_normal((120, k)) + MODEL * errors(rng, (120, k))
        for truth, value, spread in zip(true, shown, intervals.spread.at(shown), strict=True):
            parts = [reading(float(v)) for v in value]
            region = vector_reading(card, parts, spread, [instrument(factor * u)] * k)
            shares.append(region.contains(truth))
    return float(np.mean(shares))


@pytest.mark.parametrize("errors", [normal, bounded])
@pytest.mark.parametrize("ratio", [1, 3, 10])
@pytest.mark.parametrize("k", [2, 3])
@pytest.mark.cases(3)
def test_a_joint_region_holds_the_truth_whose_instrument_is_uncertain(k, ratio, errors) -> None:
    """600 truths: the rate varies by 1.2 %, and by 0.7 % with the five calibrations."""
    assert 0.865 < covered(k, ratio * MODEL, errors) < 0.935


@pytest.mark.parametrize("k", [2, 3])
@pytest.mark.cases(1)
def test_the_reach_of_one_quantity_would_not_hold_several(k) -> None:
    """The negative control: u told smaller, so that the region holds 1.645 u of each."""
    assert covered(k, 3 * MODEL, normal, joint_reach(1, 0.9) / joint_reach(k, 0.9)) < 0.8


def test_several_quantities_reach_farther_than_one_as_balls_of_normal_errors_do(rng) -> None:
    drawn = rng.standard_normal((200_000, 4))
    for k in (1, 2, 3, 4):
        inside = np.linalg.norm(drawn[:, :k], axis=1) <= joint_reach(k, 0.9)
        assert inside.mean() == pytest.approx(0.9, abs=0.003)
    assert joint_reach(1, 0.9) == pytest.approx(reference_half_width(1.0, 0.9), rel=1e-9)
