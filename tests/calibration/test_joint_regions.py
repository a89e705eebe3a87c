"""Vectors are covered whole at the stated rate, by a region that follows how their errors go together."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.refusals import refused

from palpate.calibration import CalibrationPlan, calibrate, evaluate
from palpate.calibration.coverage.conformal import fit_intervals, vector_cards
from palpate.core import InputError, VectorReading
from palpate.core.reading import ReasonCode, Refusal
from palpate.estimators import Estimator, read_card
from palpate.estimators.intervals import component_names, mahalanobis

VECTOR = {"place_mm": ("x_mm", "y_mm", "z_mm")}


def world(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimates and truths of three components: errors that go together, and grow with the first estimate."""
    groups = np.repeat(np.arange(n // 4), 4)
    estimate = rng.uniform(0, 1, (n, 3))
    mixing = np.array([[1.0, 0, 0], [0.9, 0.3, 0], [-0.7, 0.2, 0.5]])
    drawn = 0.7 * rng.standard_normal((n, 3)) + 0.7 * rng.standard_normal((n // 4, 3))[groups]
    return estimate, estimate + (0.1 + 0.4 * estimate[:, :1]) * (drawn @ mixing.T), groups


def inside(card, intervals, estimate, true) -> np.ndarray:
    scaled = (estimate - true) / intervals.spread.at(estimate)
    return mahalanobis(scaled, np.array(card.correlation)) <= card.radius


def test_all_components_at_once_are_covered_at_the_stated_rate() -> None:
    """Single intervals of the same rate are the negative control: all at once they cover less."""
    joint, single = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        data = world(rng, 800)
        intervals = fit_intervals(*data, 0.9)
        (card,) = vector_cards(VECTOR, ("x_mm", "y_mm", "z_mm"), intervals, *data)
        fresh, true, _ = world(rng, 4000)
        joint.append(inside(card, intervals, fresh, true).mean())
        single.append((np.abs(fresh - true) <= intervals.half_widths(fresh)).all(axis=1).mean())
        assert card.covered == pytest.approx(0.905, abs=0.006)
        assert card.low < card.covered < card.high
    assert np.mean(joint) == pytest.approx(0.905, abs=0.012)
    assert np.mean(single) < 0.86


def test_the_region_follows_errors_that_go_together() -> None:
    """The ellipsoid has less than half the volume of one that took the errors as independent."""
    data = world(np.random.default_rng(0), 2000)
    intervals = fit_intervals(*data, 0.9)
    (card,) = vector_cards(VECTOR, ("x_mm", "y_mm", "z_mm"), intervals, *data)
    moments = np.array(card.correlation)
    scaled = (data[0] - data[1]) / intervals.spread.at(data[0])
    alone = np.diag(np.diag(moments))
    radius = np.quantile(mahalanobis(scaled, alone), 0.9)
    volume = card.radius**3 * np.sqrt(np.linalg.det(moments))
    assert volume < 0.5 * radius**3 * np.sqrt(np.linalg.det(alone))


@pytest.mark.slow
def test_a_vector_is_read_scored_and_told(record_spots, tmp_path) -> None:
    run = record_spots("run", 30)
    plan = CalibrationPlan(
        ("x_mm", "height_mm"), split="group:press", size_px=(24, 32), vectors={"bump": ("x_mm", "height_mm")}
    )
    assert plan.vectors == {"bump_mm": ("x_mm", "height_mm")}
    calibrate(run, plan, tmp_path / "cal")
    card, estimator = read_card(tmp_path / "cal"), Estimator.open(tmp_path / "cal")
    (vector,) = card.vectors
    assert vector.components == ("x", "height")
    fresh = record_spots("fresh", 30, seed=1)
    found = evaluate(estimator, fresh)["vectors"]["bump_mm"]
    held = []
    for i in range(len(fresh)):
        readings = estimator.read(fresh.frame(i))
        reading = readings["bump_mm"]
        assert isinstance(reading, VectorReading)
        truth = fresh.labels.iloc[i][["x_mm", "height_mm"]].to_numpy(float)
        np.testing.assert_allclose(reading.value, [readings["x_mm"].value, readings["height_mm"].value])
        assert readings["bump_mm"].unit == "mm"
        assert readings["bump"].unit == "m"
        assert reading.valid == (readings["x_mm"].valid and readings["height_mm"].valid)
        if not fresh.labels["reference"][i]:
            held.append(reading.contains(truth))
    assert (len(held), np.mean(held)) == (found["n"], pytest.approx(found["covered"], abs=1e-9))
    assert 0.8 < found["covered"] <= 1
    assert json.dumps(readings["bump_mm"].to_dict())
    blind = estimator.unread("lost", 0.0, Refusal(ReasonCode.UNREADABLE, "damaged"))["bump_mm"]
    assert (blind.valid, blind.code, blind.why) == (False, "unreadable_frame", "damaged")


@pytest.mark.parametrize(
    ("vectors", "code"),
    [
        ({"force": ("x_N",)}, "vector-size"),
        ({"force": ("x_N", "x_N")}, "vector-size"),
        ({"force": ("x_N", "w_N")}, "no-target"),
        ({"force": ("x_N", "depth_mm")}, "vector-units"),
        ({"z": ("x_N", "y_N")}, "name-taken"),
        ({"": ("x_N", "y_N")}, "vector-name"),
        ({"turn": ("a_deg", "b_deg")}, "circular-component"),
        ({"force": ("x_N", "y_N"), "force_N": ("y_N", "x_N")}, "name-taken"),
        ({"touch": ("x_N", "y_N")}, "name-taken"),
    ],
)
def test_a_vector_that_is_none_is_refused(vectors, code) -> None:
    targets = ("x_N", "y_N", "z_N", "depth_mm", "a_deg", "b_deg")
    with refused(code, InputError):
        CalibrationPlan(targets, vectors=vectors, circular={"a_deg": 360.0}, classes={"touch_N": ()})


def test_components_are_called_by_what_follows_the_vector_s_name() -> None:
    assert component_names("force_N", ("force_x_N", "force_y_N")) == ("x", "y")
    assert component_names("place_mm", ("x_mm", "forced_mm")) == ("x", "forced")
