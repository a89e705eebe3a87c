"""A calibration: predictions held out by group, resumable, and nothing half-written."""

import json

import numpy as np
import pytest

from palpate.calibration import CalibrationPlan, ReferenceRule, calibrate, evaluate
from palpate.calibration.fitting import representative_fold
from palpate.calibration.training_data import find_untouched
from palpate.core import ExistsError, InputError, LabelError, SplitError
from palpate.estimators import Estimator, read_card
from palpate.recordings import Split
from palpate.recordings.packed_set import pack
from palpate.recordings.preparation import Preparation
from palpate.recordings.table_files import read_table

PLAN = CalibrationPlan(targets=("x_mm", "height_mm"), split="group:press", size_px=(24, 32))


def left_over(tmp_path) -> list[str]:
    return sorted(p.name for p in tmp_path.iterdir() if p.name != "run")


def test_a_calibration_recovers_the_truth_inside_its_intervals(record_spots, tmp_path) -> None:
    calibrate(record_spots("run", 40), PLAN, tmp_path / "cal")
    found = evaluate(Estimator.open(tmp_path / "cal"), record_spots("fresh", 40, seed=1))
    for score in found["targets"].values():
        assert score["mae"] < score["mean_mae"] / 3
        # 200 rows in 40 presses: nine in ten, give or take four standard errors of a calibration and a test.
        assert 0.8 < score["coverage_90"] < 0.99
    assert found["frames_scored"] == 200
    assert not found["learnt_from_this_run"]


def test_held_out_predictions_come_from_the_other_folds(record_spots, tmp_path) -> None:
    calibrate(
        record_spots("run", 10),
        CalibrationPlan(("x_mm",), model="mean", split="group:press"),
        tmp_path / "cal",
    )
    table = read_table(tmp_path / "cal" / "predictions.csv.gz")
    for fold in range(5):
        held = table["held_out_in_fold"] == fold
        assert not set(table["press"][held]) & set(table["press"][~held])
        np.testing.assert_allclose(table["estimate:x_mm"][held], table["x_mm"][~held].mean())


def test_frames_of_the_untouched_sensor_are_not_learnt_from_unless_asked(record_spots, tmp_path) -> None:
    run = record_spots("run", 10)
    calibrate(run, PLAN, tmp_path / "cal")
    assert len(read_table(tmp_path / "cal" / "predictions.csv.gz")) == 50
    with_them = CalibrationPlan(("height_mm",), model="mean", split="group:press", learn_untouched=True)
    calibrate(run, with_them, tmp_path / "cal-all")
    assert len(read_table(tmp_path / "cal-all" / "predictions.csv.gz")) == 60
    assert read_card(tmp_path / "cal-all").targets[0].least == 0


def test_an_interrupted_calibration_goes_on_to_the_same_result(record_spots, tmp_path) -> None:
    run = record_spots("run", 12)
    calibrate(run, PLAN, tmp_path / "whole")

    class Interrupted(Exception):
        pass

    def stop(what: str, done: int, total: int) -> None:
        if what.startswith("fold 4"):
            raise Interrupted

    with pytest.raises(Interrupted):
        calibrate(run, PLAN, tmp_path / "cal", stop)
    assert not (tmp_path / "cal").exists()
    kept = tmp_path / ".cal.work"
    before = {path.name: path.stat().st_mtime_ns for path in kept.glob("fold-*.npy")}
    assert len(before) == 3
    calibrate(run, PLAN, tmp_path / "cal")
    assert not kept.exists()
    first, again = ((tmp_path / name / "predictions.csv.gz").read_bytes() for name in ("whole", "cal"))
    assert first == again


def test_work_towards_another_plan_is_not_taken_over(record_spots, tmp_path) -> None:
    run = record_spots("run", 12)

    def stop(what: str, done: int, total: int) -> None:
        if what.startswith("fold 2"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calibrate(run, PLAN, tmp_path / "cal", stop)
    other = CalibrationPlan(targets=("x_mm",), split="group:press", size_px=(24, 32))
    with pytest.raises(ExistsError, match="unfinished work towards another calibration"):
        calibrate(run, other, tmp_path / "cal")


def test_what_exists_is_never_overwritten(record_spots, tmp_path) -> None:
    (tmp_path / "cal").mkdir()
    with pytest.raises(ExistsError, match="nothing is ever overwritten"):
        calibrate(record_spots("run", 10), PLAN, tmp_path / "cal")
    assert list((tmp_path / "cal").iterdir()) == []


@pytest.mark.parametrize(
    ("plan", "error", "says"),
    [
        (CalibrationPlan(("depth_mm",)), LabelError, "x_mm"),
        (CalibrationPlan(("flat_mm",)), LabelError, "flat_mm"),
        (CalibrationPlan(("x_mm",), split="group:nothing"), SplitError, "press"),
        (CalibrationPlan(("x_mm",), split="group:press", folds=50), SplitError, "at most 10 folds"),
        (CalibrationPlan(("x_mm",), reference=ReferenceRule("weight_g", "0")), LabelError, "weight_g"),
        (CalibrationPlan(("x_mm",), reference=ReferenceRule("press", "none")), LabelError, "press=none"),
    ],
)
def test_a_plan_that_does_not_fit_is_refused_and_leaves_nothing(
    plan, error, says, record_spots, tmp_path
) -> None:
    run = record_spots("run", 10)
    with pytest.raises(error, match=says):
        calibrate(run, plan, tmp_path / "cal")
    assert left_over(tmp_path) == []


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"targets": ()}, "no target"),
        ({"targets": ("x_mm", "x_mm")}, "named twice"),
        ({"targets": ("x_mm", "press")}, "'press' carries no unit"),
        ({"targets": "x_mm, height_mm"}, r"give \('x_mm', 'height_mm',\)"),
        ({"coverage": 1.0}, "coverage"),
        ({"model": "resnet"}, "compact-cnn"),
        ({"split": "by-hand"}, "group:COLUMN"),
        ({"split": "group:"}, "group:COLUMN"),
        ({"folds": 1}, "2 or more"),
        ({"scored_folds": 0}, "at least 1"),
        ({"seed": -1}, "0 or more"),
        ({"size_px": (0, 32)}, "1 px or more"),
        ({"crop_px": (-1, 0, 20, 20)}, "x and y are 0 or more"),
    ],
)
def test_a_plan_without_sense_is_refused(fields, says) -> None:
    with pytest.raises(InputError, match=says):
        CalibrationPlan(**{"targets": ("x_mm",), **fields})


def test_too_few_frames_are_refused(record_spots, tmp_path) -> None:
    with pytest.raises(InputError, match="10 or more"):
        calibrate(record_spots("run", 1), PLAN, tmp_path / "cal")


def test_the_difference_from_a_reference_does_not_see_the_lamp(record_spots, tmp_path) -> None:
    plan = CalibrationPlan(("x_mm", "height_mm"), split="group:press", size_px=(24, 32), delta=True)
    calibrate(record_spots("run", 40), plan, tmp_path / "cal")
    brighter = record_spots("brighter", 20, seed=2, lamp=12.0)
    score = evaluate(Estimator.open(tmp_path / "cal"), brighter)["targets"]["height_mm"]
    assert score["mae"] < score["mean_mae"] / 4


def test_each_group_may_have_its_own_reference(record_spots, tmp_path) -> None:
    run = record_spots("run", 6)
    packed = pack(run, tmp_path / "packed", Preparation(None, (24, 32), 1))
    own = CalibrationPlan(("x_mm",), delta=True, reference=ReferenceRule("reference", "true", ("press",)))
    untouched = find_untouched(packed, own)
    assert len(untouched.images) == 6
    for row in (0, 6, 17):
        first = packed.read([row - row % 6])[0].astype(np.float32).transpose(2, 0, 1)
        np.testing.assert_array_equal(untouched.images[untouched.groups[row]], first)


def test_a_difference_needs_a_reference(record_spots, tmp_path) -> None:
    run = record_spots("run", 10)
    packed = pack(run, tmp_path / "packed", Preparation(None, (24, 32), 1))
    packed.table = packed.table.drop(columns="reference")
    with pytest.raises(LabelError, match="--reference COLUMN=VALUE"):
        find_untouched(packed, CalibrationPlan(("x_mm",), delta=True))


def test_leakage_is_found_and_said_on_the_card(record_spots, tmp_path) -> None:
    run = record_spots("run", 12)
    calibrate(run, CalibrationPlan(("x_mm",), model="mean", split="random"), tmp_path / "random")
    calibrate(run, CalibrationPlan(("x_mm",), model="mean", split="group:press"), tmp_path / "grouped")
    assert not read_card(tmp_path / "random").split.clean
    assert "press" in read_card(tmp_path / "random").split.audit
    assert read_card(tmp_path / "grouped").split.clean


def test_the_card_is_json_that_anyone_can_read(record_spots, tmp_path) -> None:
    calibrate(record_spots("run", 12), PLAN, tmp_path / "cal")
    card = json.loads((tmp_path / "cal" / "card.json").read_text())
    assert card["targets"][0]["column"] == "x_mm"
    assert card["targets"][0]["unit"] == "mm"
    assert card["split"]["kind"] == "group:press"
    assert card["agreement"] < 1e-4
    assert len(card["run"]["hash"]) == 64


def test_one_fold_is_held_out_from_the_model_that_is_kept(record_spots, tmp_path) -> None:
    run = record_spots("run", 20)
    plan = CalibrationPlan(("x_mm",), split="group:press", size_px=(24, 32), scored_folds=1)
    split_card = read_card(calibrate(run, plan, tmp_path / "cal")).split
    assert (split_card.rows_scored, split_card.rows_learnt) == (20, 80)
    table = read_table(tmp_path / "cal" / "predictions.csv.gz")
    # The kept model repeats the scored predictions: it is the very one that was scored.
    found = Estimator.open(tmp_path / "cal").read(
        run.frame(int(run.labels.index[run.labels["press"] == table["press"][0]][1]))
    )
    assert found["x_mm"].in_unit("mm").value == pytest.approx(table["estimate:x_mm"][0], rel=1e-3, abs=1e-4)


def test_the_fold_that_stands_for_all_is_the_one_most_like_all() -> None:
    values = np.r_[np.zeros(30), np.linspace(0, 1, 30), np.ones(30)][:, None]
    folds = tuple(np.array_split(np.arange(90), 3))
    assert representative_fold(Split("random", (), None, folds, ""), values) == 1


def test_the_plan_s_name_of_before_still_works_and_says_the_new_one() -> None:
    import palpate
    import palpate.calibration

    for module in (palpate, palpate.calibration):
        with pytest.warns(DeprecationWarning, match="CalibrationPlan"):
            assert module.Plan is CalibrationPlan
    assert "Plan" not in palpate.__all__
