"""A calibration: predictions held out by group, resumable, and nothing half-written."""

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused
from tests.slow_params import mostly_slow

from palpate.calibration import (
    CalibrationPlan,
    ReferenceRule,
    calibrate,
    calibration_job,
    evaluate,
    fitting,
    fold_fits,
)
from palpate.calibration.calibration_job import find_untouched
from palpate.calibration.fold_fits import representative_fold
from palpate.core import ExistsError, InputError, LabelError, SplitError
from palpate.estimators import Estimator, read_card
from palpate.estimators.networks.pixel_models import MeanBaseline
from palpate.recordings import Split, pack, split
from palpate.recordings.label_tables import read_table
from palpate.recordings.preparation import Preparation

pytestmark = pytest.mark.usefixtures("changes_untried")

TWO = ("x_mm", "height_mm")
PLAN = CalibrationPlan(TWO, "pca-ridge", split="group:press", size_px=(24, 32))
RIDGE = replace(PLAN, size_px=(12, 16))
MEAN = CalibrationPlan(("x_mm",), "mean", split="group:press", size_px=(6, 8))


def left_over(tmp_path) -> list[str]:
    return sorted(p.name for p in tmp_path.iterdir() if p.name != "run")


@pytest.fixture(scope="module")
def run(record_spots_module):
    return record_spots_module("run", 10)


@pytest.fixture(scope="module")
def grouped(run, tmp_path_factory):
    """Calibration of the mean with folds by press."""
    return calibrate(run, MEAN, tmp_path_factory.mktemp("grouped") / "cal")


def interrupt(run, plan, out, fold: int = 3) -> None:
    def stop(what: str, done: int, total: int) -> None:
        if what.startswith(f"fold {fold}"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calibrate(run, plan, out, stop)


def test_a_calibration_recovers_the_truth_inside_its_intervals(record_spots, tmp_path) -> None:
    calibrate(record_spots("run", 20), PLAN, tmp_path / "cal")
    found = evaluate(Estimator.open(tmp_path / "cal"), record_spots("fresh", 20, seed=1))
    for score in found["targets"].values():
        assert score["mae"] < score["mean_mae"] / 3
        # nine in ten or more, as every tenth of the range is to be covered so often
        assert 0.8 < score["coverage_90"] < 1
    assert found["frames_scored"] == 100
    assert not found["learnt_from_this_run"]


def test_held_out_predictions_come_from_the_other_folds(grouped) -> None:
    table = read_table(grouped / "predictions.csv.gz")
    assert len(table) == 50  # frames without contact are not trained on
    for fold in range(5):
        held = table["held_out_in_fold"] == fold
        assert not set(table["press"][held]) & set(table["press"][~held])
        np.testing.assert_allclose(table["estimate:x_mm"][held], table["x_mm"][~held].mean())


def test_frames_of_the_untouched_sensor_are_not_learnt_from_unless_asked(run, tmp_path) -> None:
    with_them = replace(MEAN, targets=("height_mm",), learn_untouched=True)
    calibrate(run, with_them, tmp_path / "cal-all")
    assert len(read_table(tmp_path / "cal-all" / "predictions.csv.gz")) == 60
    assert read_card(tmp_path / "cal-all").targets[0].least == 0


def test_an_interrupted_calibration_goes_on_to_the_same_result(run, tmp_path) -> None:
    calibrate(run, RIDGE, tmp_path / "whole")
    interrupt(run, RIDGE, tmp_path / "cal", fold=4)
    assert not (tmp_path / "cal").exists()
    kept = tmp_path / ".cal.work"
    before = {path.name: path.stat().st_mtime_ns for path in kept.glob("fold-*.npy")}
    assert len(before) == 3
    calibrate(run, RIDGE, tmp_path / "cal")
    assert not kept.exists()
    first, again = ((tmp_path / name / "predictions.csv.gz").read_bytes() for name in ("whole", "cal"))
    assert first == again


def fitted_folds(run, plan, out) -> list[str]:
    """Return the folds that a calibration computes, by its progress up to the guard."""
    seen: dict[str, None] = {}

    def watch(what: str, done: int, total: int) -> None:
        seen.setdefault(what.partition(":")[0])
        if what == "learning what frames look like":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calibrate(run, plan, out, watch)
    return [what for what in seen if what.startswith("fold")]


DAMAGES = {
    "another shape": lambda path: np.save(path, np.zeros((1, 2))),
    "no number": lambda path: np.save(path, np.full_like(np.load(path), np.nan)),
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-9]),
    "empty": lambda path: path.write_bytes(b""),
    "pickled": lambda path: np.save(path, np.array([{}], object), allow_pickle=True),
    "text": lambda path: path.write_bytes(b"\xff no array"),
}


@pytest.mark.parametrize("damage", mostly_slow(list(DAMAGES), lambda i: i in (1, 4)))
def test_a_damaged_fold_of_an_interrupted_calibration_is_computed_again(damage, run, tmp_path) -> None:
    interrupt(run, RIDGE, tmp_path / "cal")
    fold = tmp_path / ".cal.work" / "fold-0.npy"
    kept = np.load(fold)
    DAMAGES[damage](fold)
    interrupt(run, RIDGE, tmp_path / "cal")
    np.testing.assert_allclose(np.load(fold), kept, rtol=1e-9)


@pytest.mark.parametrize("note", [b"\xff\xfe", b"", b'{"run": '])
@pytest.mark.cases(1)
def test_work_whose_note_is_damaged_begins_anew(note, run, tmp_path) -> None:
    interrupt(run, RIDGE, tmp_path / "cal")
    (tmp_path / ".cal.work" / "plan.json").write_bytes(note)
    assert len(fitted_folds(run, RIDGE, tmp_path / "cal")) == 5


def test_work_by_another_version_or_with_other_folds_begins_anew(run, tmp_path, monkeypatch) -> None:
    for module, name, value in (
        (fitting, "__version__", "0.0.9"),
        (calibration_job, "split", lambda *a, **k: split(*a, **{**k, "seed": 1})),
    ):
        with monkeypatch.context() as patched:
            patched.setattr(module, name, value)
            interrupt(run, RIDGE, tmp_path / name)
        assert len(fitted_folds(run, RIDGE, tmp_path / name)) == 5


@pytest.mark.parametrize("name", ["notes.txt", "fold-0", "model.npz"])
def test_a_work_folder_with_a_file_of_the_user_s_is_not_removed(name, run, tmp_path) -> None:
    (tmp_path / ".cal.work").mkdir()
    (tmp_path / ".cal.work" / name).write_text("mine")
    with refused("foreign-file", ExistsError, name):
        calibrate(run, RIDGE, tmp_path / "cal")
    assert (tmp_path / ".cal.work" / name).read_text() == "mine"


def test_a_model_that_predicts_no_number_is_refused_by_its_fold(run, tmp_path, monkeypatch) -> None:
    fit = MeanBaseline.fit

    def lost(self, data, rows, *, seed, **others):
        fitted = fit(self, data, rows, seed=seed, **others)
        return replace(fitted, offset=fitted.offset * np.nan) if seed in (2, 4) else fitted

    monkeypatch.setattr(MeanBaseline, "fit", lost)
    plan = MEAN
    with pytest.raises(InputError, match=r"mean, fold 2"):
        calibrate(run, plan, tmp_path / "cal")


def test_a_fit_sees_no_labels_of_rows_held_out_and_cannot_change_any(run, tmp_path, monkeypatch) -> None:
    fit, held_out = MeanBaseline.fit, []

    def watched(self, data, rows, **others):
        others_rows = np.setdiff1d(np.arange(len(data.values)), rows)
        held_out.append((len(others_rows), bool(np.isnan(data.values[others_rows]).all())))
        for array in (data.values, data.groups):
            with pytest.raises(ValueError, match="read-only"):
                array[:] = array[0]
        return fit(self, data, rows, **others)

    monkeypatch.setattr(MeanBaseline, "fit", watched)
    plan = MEAN
    calibrate(run, plan, tmp_path / "cal")
    assert held_out == [(10, True)] * 5 + [(0, True)]


def test_work_towards_another_plan_is_not_taken_over(run, tmp_path) -> None:

    interrupt(run, PLAN, tmp_path / "cal", fold=2)
    other = CalibrationPlan(targets=("x_mm",), split="group:press", size_px=(24, 32))
    with refused("other-work", ExistsError):
        calibrate(run, other, tmp_path / "cal")


def test_what_exists_is_never_overwritten(run, tmp_path) -> None:
    (tmp_path / "cal").mkdir()
    with refused("exists", ExistsError):
        calibrate(run, PLAN, tmp_path / "cal")
    assert list((tmp_path / "cal").iterdir()) == []


@pytest.mark.parametrize(
    ("plan", "error", "code"),
    [
        (CalibrationPlan(("depth_mm",)), LabelError, "label"),
        (CalibrationPlan(("x_mm",), split="group:nothing"), SplitError, "split"),
        (CalibrationPlan(("x_mm",), split="group:press", folds=50), SplitError, "few-groups"),
        (CalibrationPlan(TWO, vectors={"p q": TWO}), InputError, "vector-name"),
        (CalibrationPlan(TWO, vectors={"flat": TWO}), InputError, "name-taken"),
        (CalibrationPlan(("x_mm",), reference=ReferenceRule("weight_g", "0")), LabelError, "label"),
    ],
)
def test_a_plan_that_does_not_fit_is_refused_and_leaves_nothing(plan, error, code, run, tmp_path) -> None:
    with refused(code, error):
        calibrate(run, plan, tmp_path / "cal")
    assert left_over(tmp_path) == []


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"targets": ()}, "no-target"),
        ({"targets": ("x_mm", "x_mm")}, "target-twice"),
        ({"targets": ("x_mm", "press")}, "no-unit"),
        ({"targets": "x_mm, height_mm"}, "input"),
        ({"coverage": 1.0}, "plan-range"),
        ({"model": "resnet"}, "unknown-name"),
        ({"split": "by-hand"}, "split"),
        ({"folds": 1}, "plan-range"),
        ({"scored_folds": 0}, "plan-range"),
        ({"seed": -1}, "plan-range"),
        ({"size_px": (0, 32)}, "plan-range"),
        ({"crop_px": (-1, 0, 20, 20)}, "plan-range"),
    ],
)
def test_a_plan_without_sense_is_refused(fields, code) -> None:
    with refused(code, InputError):
        CalibrationPlan(**{"targets": ("x_mm",), **fields})


def test_the_difference_from_a_reference_does_not_see_the_lamp(record_spots, tmp_path) -> None:
    calibrate(record_spots("run", 16), replace(PLAN, delta=True), tmp_path / "cal")
    brighter = record_spots("brighter", 8, seed=2, lamp=12.0)
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


def test_leakage_is_found_and_stated_on_the_card(run, grouped, tmp_path) -> None:
    card = read_card(calibrate(run, replace(MEAN, split="random"), tmp_path / "random"))
    assert not card.split.clean
    assert "press" in card.split.audit_text
    assert read_card(grouped).split.clean


def test_one_fold_is_held_out_from_the_model_that_is_kept(run, tmp_path) -> None:
    plan = replace(RIDGE, targets=("x_mm",), scored_folds=1)
    split_card = read_card(calibrate(run, plan, tmp_path / "cal")).split
    assert (split_card.rows_scored, split_card.rows_learnt) == (10, 40)
    table = read_table(tmp_path / "cal" / "predictions.csv.gz")
    # The kept model repeats the scored predictions: it is the very one that was scored.
    found = Estimator.open(tmp_path / "cal").read(
        run.frame(int(run.labels.index[run.labels["press"] == table["press"][0]][1]))
    )
    assert found["x_mm"].in_unit("mm").value == pytest.approx(table["estimate:x_mm"][0], rel=1e-3, abs=1e-4)


def test_the_scored_fold_of_several_targets_is_one_if_chosen_by_the_same_labels(
    record_spots, tmp_path, monkeypatch
) -> None:
    run, chosen = record_spots("run", 12), []

    def choose(parts: Split, values: np.ndarray) -> int:
        chosen.append(representative_fold(parts, values))
        raise KeyboardInterrupt

    monkeypatch.setattr(fold_fits, "representative_fold", choose)
    for fold_by in ((), TWO):
        for target in TWO:
            plan = replace(MEAN, targets=(target,), scored_folds=1, fold_by=fold_by)
            with pytest.raises(KeyboardInterrupt):
                calibrate(run, plan, tmp_path / f"{target}-{len(fold_by)}")
    assert chosen[0] != chosen[1]
    assert chosen[2] == chosen[3]


def test_the_fold_that_stands_for_all_is_the_one_most_like_all() -> None:
    values = np.r_[np.zeros(30), np.linspace(0, 1, 30), np.ones(30)][:, None]
    folds = tuple(np.array_split(np.arange(90), 3))
    assert representative_fold(Split("random", (), None, folds, ""), values) == 1


def test_the_plan_s_name_of_before_still_works_and_says_the_new_one() -> None:
    import palpate

    with pytest.warns(DeprecationWarning, match="CalibrationPlan"):
        assert palpate.Plan is CalibrationPlan
    assert "Plan" not in palpate.__all__


def test_too_few_frames_are_refused(record_spots, tmp_path) -> None:
    with refused("few-frames", InputError):
        calibrate(record_spots("run", 1), PLAN, tmp_path / "cal")
