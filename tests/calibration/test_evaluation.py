"""A target's score says what its names say, by independent formulas."""

import numpy as np
import pytest
from sklearn import metrics

from palpate.calibration import CalibrationPlan, calibrate, evaluate
from palpate.calibration.coverage.grouped_rates import coverage_interval
from palpate.calibration.evaluation import score
from palpate.core import CertificateError
from palpate.estimators import Estimator


def test_each_number_of_a_score_is_that_of_its_name() -> None:
    rng = np.random.default_rng(0)
    true = rng.normal(2.0, 1.0, 300)
    predicted = true + rng.normal(0.1, 0.3, 300)
    half = rng.uniform(0.2, 0.8, 300)
    found = score("mm", true, predicted, half, 1.5, np.arange(300))
    assert (found.unit, found.n) == ("mm", 300)
    assert found.mae == pytest.approx(metrics.mean_absolute_error(true, predicted))
    assert found.rmse == pytest.approx(metrics.root_mean_squared_error(true, predicted))
    assert found.r2 == pytest.approx(metrics.r2_score(true, predicted))
    assert found.bias == pytest.approx(np.mean(predicted) - np.mean(true))
    assert found.mean_mae == pytest.approx(metrics.mean_absolute_error(true, np.full(300, 1.5)))
    hits = sum(t - h <= p <= t + h for t, p, h in zip(true, predicted, half, strict=True))
    assert found.coverage_90 == pytest.approx(hits / 300)
    assert (found.coverage_90_low, found.coverage_90_high) == pytest.approx(coverage_interval(int(hits), 300))
    assert found.half_width == pytest.approx(half.mean())


def test_labels_without_variance_have_no_share_explained() -> None:
    found = score("mm", np.full(5, 2.0), np.full(5, 2.5), np.ones(5), 2.0, np.arange(5))
    assert (found.r2, found.mae, found.bias, found.coverage_90) == (0.0, 0.5, 0.5, 1.0)


@pytest.mark.parametrize("small", [1e-3, 1e-6])
def test_the_share_explained_has_no_unit(small: float) -> None:
    """In metres as in millimetres."""
    true, predicted = np.array([1.0, 2.0, 3.0]), np.array([1.1, 2.0, 2.8])
    half, groups = np.ones(3), np.arange(3)
    whole = score("mm", true, predicted, half, 2.0, groups).r2
    scaled = score("m", small * true, small * predicted, small * half, small * 2.0, groups).r2
    assert scaled == pytest.approx(whole)


def test_a_network_that_gives_no_number_is_not_scored_on_the_others(
    record_spots, tmp_path, monkeypatch
) -> None:
    run, values = record_spots("run", 10), Estimator.values
    plan = CalibrationPlan(("x_mm",), model="mean", split="group:press", size_px=(12, 16))
    estimator = Estimator.open(calibrate(run, plan, tmp_path / "cal"))
    bright = np.median([run.frame(row).image.mean() for row in range(len(run))])

    def of_dark_frames(self, inputs):
        return values(self, inputs) + np.where(inputs.mean() > bright, np.nan, 0)

    monkeypatch.setattr(Estimator, "values", of_dark_frames)
    with pytest.raises(CertificateError, match="no finite number"):
        evaluate(estimator, run)
