"""A target's score says what its names say, by independent formulas."""

import cv2
import numpy as np
import pandas as pd
import pytest
from sklearn import metrics
from tests.refusals import refused

from palpate.calibration import CalibrationPlan, adapt, calibrate, evaluate
from palpate.calibration.coverage.grouped_rates import coverage_interval, held_out_groups
from palpate.calibration.evaluation import learnt_frames, same_session, score, shifted_labels
from palpate.calibration.near_copies import repeated_presses
from palpate.calibration.sessions import keep_evaluation, read_evaluations, reset_intervals
from palpate.core import CertificateError, InputError
from palpate.estimators import Estimator
from palpate.estimators.model_card import Card, ScoreCard, SplitCard
from palpate.recordings import Manifest, split
from palpate.reports import scores_table
from palpate.reports.evaluation_text import day_text

pytestmark = pytest.mark.usefixtures("changes_untried")


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
    with refused("not-finite", CertificateError):
        evaluate(estimator, run)


def card_of(kind: str, columns: tuple[str, ...] = (), block_rows: int | None = None) -> Card:
    """A card of a split; there is nothing else that groups are told by."""
    about = SplitCard.model_construct(kind=kind, columns=columns, block_rows=block_rows)
    return Card.model_construct(split=about, interval_reset=None)


@pytest.mark.parametrize("spec", ["blocks:20", "blocks:7", "blocks"])
@pytest.mark.parametrize("folds_scored", [5, 2])
@pytest.mark.cases(2)
def test_held_out_blocks_are_found_again_from_the_predictions(spec, folds_scored) -> None:
    """Those that the split made, of two sessions in rows of any order."""
    sessions = np.repeat(["a", "b"], [187, 213])
    parts = split(pd.DataFrame({"session": sessions}), spec, seed=3)
    folds = np.concatenate([np.full(len(rows), k) for k, rows in enumerate(parts.folds[:folds_scored])])
    rows = np.concatenate(parts.folds[:folds_scored])
    table = pd.DataFrame({"session": sessions[rows], "row": rows, "held_out_in_fold": folds})
    table = table.sample(frac=1, random_state=0)
    groups, by = held_out_groups(card_of(spec, block_rows=parts.block_rows), table)
    assert by == "held-out block"
    pairs = set(zip(groups.tolist(), np.array(parts.groups)[table["row"]].tolist(), strict=True))
    assert len(pairs) == len(set(groups.tolist())) == len(np.unique(np.array(parts.groups)[rows]))


def _compressed(image):
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1], -1)


@pytest.mark.parametrize("image", [lambda image: image, _compressed], ids=["equal", "compressed"])
def test_frames_learnt_from_are_no_other_day_under_another_name(
    calibrate_spots, record_spots, rewritten, tmp_path, image
) -> None:
    """Another run's id, hash and session, and the same pixels: no test, and nothing to reset or adapt by."""
    run, folder = calibrate_spots(
        tmp_path / "cal", 16, targets=("x_mm",), model="mean", split="group:press", size_px=(24, 32)
    )
    estimator = Estimator.open(folder)
    copied = rewritten(run, tmp_path / "copied", lambda row: {**row, "session": "Friday"}, image)
    assert same_session(estimator, copied)
    assert evaluate(estimator, copied)["same_session"] == same_session(estimator, copied)
    for use in (reset_intervals, adapt):
        with pytest.raises(InputError, match="learnt from"):
            use(folder, copied, tmp_path / "made")
    assert same_session(estimator, record_spots("other", 16, seed=1)) == ""


def test_the_same_presses_simulated_again_are_no_other_day(
    calibrate_spots, record_spots, rewritten, tmp_path, monkeypatch
) -> None:
    """Each press is held still for five frames; a second simulation differs in its noise alone."""

    def held(run, name: str, seed: int, lamp: int = 0):
        rng, place = np.random.default_rng(seed), iter(range(len(run)))

        def noisy(_):
            row = next(place)
            shown = run.frame(row if row % 6 == 0 else row - row % 6 + 1).image
            return np.clip(shown + lamp + rng.normal(0, 0.7, shown.shape), 0, 255).astype(np.uint8)

        return rewritten(run, tmp_path / name, image=noisy)

    presses, others = record_spots("presses", 16), record_spots("others", 16, seed=1)
    plan = CalibrationPlan(targets=("x_mm",), model="mean", split="group:press", size_px=(24, 32))
    folder = calibrate(held(presses, "learnt", 2), plan, tmp_path / "cal")
    estimator, again = Estimator.open(folder), held(presses, "again", 3)
    assert same_session(estimator, again) == ""  # two days of a real sensor
    for about in (Card, Manifest):
        monkeypatch.setattr(about, "is_simulated", property(lambda self: True))
    found = evaluate(estimator, again)
    assert found["learnt_frames"] == {"compared": 80, "equal": 0, "presses": 16, "repeated": 14}
    assert "14 of 16 presses" in day_text(found)  # two of the others are nearly the same press
    keep_evaluation(folder, found)
    assert not read_evaluations(folder, estimator.card)[0].of_another_session
    for other in (held(others, "other seed", 3), held(presses, "other light", 3, lamp=6)):
        assert learnt_frames(estimator, other).repeated == 0
        assert same_session(estimator, other) == ""


def test_presses_near_dense_ones_by_chance_are_not_those_again() -> None:
    """Along one line, where a kept press is never far; ten presses among two hundred are the hardest case."""
    rng = np.random.default_rng(0)
    line = rng.normal(size=256)

    def frames(places):
        return np.repeat(np.outer(places, line), 3, axis=0) + rng.normal(0, 0.3, (3 * len(places), 256))

    kept, groups = np.sort(rng.uniform(0, 2000, 200)), np.repeat(np.arange(10), 3)
    fresh = frames(rng.uniform(0, 2000, 10))
    assert repeated_presses(fresh, groups, frames(kept), 10 / 200)[1] <= 3
    assert repeated_presses(frames(kept[::20]), groups, frames(kept), 10 / 200) == (10, 10)


def test_labels_outside_what_was_calibrated_are_no_failed_day(
    calibrate_spots, record_spots, rewritten, tmp_path
) -> None:
    """In micrometres the labels lie far beyond; in millimetres, and beyond in a few rows, they do not."""
    _, folder = calibrate_spots(
        tmp_path / "cal", 16, targets=("x_mm",), model="mean", split="group:press", size_px=(24, 32)
    )
    estimator, run = Estimator.open(folder), record_spots("other", 6, seed=1)
    thousandfold = rewritten(run, tmp_path / "um", lambda row: {**row, "x_mm": 1000 * row["x_mm"] + 10_000})
    found = evaluate(estimator, thousandfold)
    assert set(found["labels_outside"]) == {"x_mm"}
    assert found["same_session"] == found["labels_outside"]["x_mm"]
    assert found["findings"] == [found["same_session"]]
    assert found["findings_of"] == {}
    said = scores_table({"x_mm": ScoreCard(**found["targets"]["x_mm"])}, outside=found["labels_outside"])
    assert "does not read it" not in said
    assert evaluate(estimator, run)["labels_outside"] == {}


@pytest.mark.parametrize("lag", [-2, 3])
@pytest.mark.cases(1)
def test_labels_shifted_against_their_images_are_told(calibrate_spots, tmp_path, lag) -> None:
    _, folder = calibrate_spots(
        tmp_path / "cal", 16, targets=("x_mm",), model="mean", split="group:press", size_px=(24, 32)
    )
    card, rng = Estimator.open(folder).card, np.random.default_rng(0)
    label = rng.uniform(-2, 2, (100, 1))
    fitting = np.roll(label[:, 0], -lag) + rng.normal(0, 0.2, 100)  # image i shows row i + lag
    (said,) = shifted_labels(card, label, pd.DataFrame({"estimate:x_mm": fitting}))
    assert f"row i {'+' if lag > 0 else '-'} {abs(lag)} " in said
    for estimate in (label[:, 0] + rng.normal(0, 0.2, 100), rng.uniform(-2, 2, 100), np.zeros(100)):
        assert shifted_labels(card, label, pd.DataFrame({"estimate:x_mm": estimate})) == []


def test_labels_without_variance_have_no_share_explained() -> None:
    found = score("mm", np.full(5, 2.0), np.full(5, 2.5), np.ones(5), 2.0, np.arange(5))
    assert (found.r2, found.mae, found.bias, found.coverage_90) == (0.0, 0.5, 0.5, 1.0)
