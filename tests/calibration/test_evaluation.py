"""A target's score says what its names say, by independent formulas."""

import numpy as np
import pandas as pd
import pytest
from sklearn import metrics

from palpate.calibration import CalibrationPlan, calibrate, evaluate
from palpate.calibration.coverage.grouped_rates import coverage_interval
from palpate.calibration.evaluation import counted_groups, counted_text, held_out_groups, score
from palpate.core import CertificateError
from palpate.estimators import Estimator
from palpate.estimators.model_card import Card, SplitCard
from palpate.recordings import split


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


def card_of(kind: str, columns: tuple[str, ...] = (), reason: str = "") -> Card:
    """A card of a split; there is nothing else that groups are told by."""
    about = SplitCard.model_construct(kind=kind, columns=columns, reason=reason)
    return Card.model_construct(split=about, interval_reset=None)


@pytest.mark.parametrize("spec", ["blocks:20", "blocks:7", "blocks"])
@pytest.mark.parametrize("folds_scored", [5, 2])
def test_held_out_blocks_are_found_again_from_the_predictions(spec, folds_scored) -> None:
    """Those that the split made, of two sessions in rows of any order."""
    sessions = np.repeat(["a", "b"], [187, 213])
    parts = split(pd.DataFrame({"session": sessions}), spec, seed=3)
    folds = np.concatenate([np.full(len(rows), k) for k, rows in enumerate(parts.folds[:folds_scored])])
    rows = np.concatenate(parts.folds[:folds_scored])
    table = pd.DataFrame({"session": sessions[rows], "row": rows, "held_out_in_fold": folds})
    table = table.sample(frac=1, random_state=0)
    groups, by = held_out_groups(card_of(spec, reason=parts.reason), table)
    assert by == "held-out block"
    pairs = set(zip(groups.tolist(), np.array(parts.groups)[table["row"]].tolist(), strict=True))
    assert len(pairs) == len(set(groups.tolist())) == len(np.unique(np.array(parts.groups)[rows]))


def test_a_split_that_names_no_group_counts_presses_where_rows_name_them() -> None:
    """Press 3 of one session is not press 3 of another; rows count by themselves where nothing is named."""
    table = pd.DataFrame({"session": ["a"] * 8 + ["b"] * 4, "press": [1, 1, 2, 2, 3, 3, 4, 4, 1, 1, 2, 2]})
    for card in (card_of("blocks:20"), card_of("random"), card_of("group:location", ("location",))):
        groups, by = counted_groups(card, table)
        assert groups.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
        assert by == "press"
        groups, by = counted_groups(card, table[["session"]])
        assert counted_text(len(np.unique(groups)), by) == "12 rows, each its own group"
    groups, by = counted_groups(card_of("session", ("session",)), table)
    assert (len(np.unique(groups)), by) == (2, "session")
