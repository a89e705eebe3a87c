"""Two calibrations side by side: compared row by row where they can be, and else told why not."""

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.calibration import evaluate
from palpate.calibration.sessions import keep_evaluation
from palpate.core import CertificateError, InputError
from palpate.estimators import Estimator, read_card
from palpate.estimators.findings import Finding, FindingCode
from palpate.estimators.model_card import sealed
from palpate.recordings.label_tables import read_table
from palpate.reports.comparison_page import (
    compare_calibrations,
    comparison_text,
    headline,
    judgement,
    write_comparison,
)

pytestmark = pytest.mark.usefixtures("changes_untried", "figures_blank")


@pytest.fixture
def calibrated(calibrate_spots, tmp_path):
    """A function that calibrates on a run of a name, with changes to the plan."""
    runs = {"run": 0}

    def make(out: str, run: str = "run", **changes):
        plan = {"targets": ("x_mm", "height_mm"), "model": "pca-ridge", "split": "group:press"}
        plan |= {"size_px": (12, 16)} | changes
        return calibrate_spots(tmp_path / out, run_seed=runs.setdefault(run, len(runs)), **plan)[1]

    return make


def test_the_better_of_two_on_the_same_rows_is_named_with_its_interval(calibrated, tmp_path) -> None:
    found = compare_calibrations(calibrated("good"), calibrated("mean", model="mean"))
    assert found.obstacles == ()
    errors = []
    for name in ("good", "mean"):
        table = read_table(tmp_path / name / "predictions.csv.gz").sort_values("own:row")
        errors.append(np.abs(table["estimate:x_mm"] - table["x_mm"]).to_numpy())
    pair = found.targets[0].paired
    assert pair.rows == 80
    assert pair.groups == 16
    assert pair.difference == pytest.approx((errors[1] - errors[0]).mean())
    assert 0 < pair.low < pair.difference < pair.high
    said = judgement(found.targets[0])
    assert "first errs" in said
    assert "-" not in said  # how much less, and its interval, are said of the better one: as positive numbers
    other_way = compare_calibrations(tmp_path / "mean", tmp_path / "good").targets[0]
    assert other_way.paired.difference == pytest.approx(-pair.difference)
    assert judgement(other_way) == said.replace("first", "second")


def test_a_calibration_beside_its_twin_is_not_called_better(calibrated) -> None:
    found = compare_calibrations(calibrated("one"), calibrated("two"))
    assert found.obstacles == ()
    assert "tell which" in judgement(found.targets[0])
    few = replace(found.targets[0].paired, groups=2, difference=-1.0, low=None, high=None)
    told = judgement(replace(found.targets[0], paired=few))
    assert told == "x: these rows cannot tell which errs less (2 groups of press; 3 or more are needed)."


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"run": "another"}, "recordings-differ"),
        ({"split": "random"}, "split-differs"),
        ({"scored_folds": 2}, "rows-differ"),
        ({"seed": 5}, "folds-differ"),
    ],
)
def test_scores_of_different_rows_are_not_compared(calibrated, changes, code) -> None:
    found = compare_calibrations(calibrated("one"), calibrated("two", **changes))
    assert code in [one.code for one in found.obstacles]
    assert all(one.paired is None for one in found.targets)
    assert "errs less" not in comparison_text(found)
    assert "NOT COMPARABLE" in comparison_text(found)


def test_calibrations_without_a_target_in_common_are_refused(calibrated) -> None:
    first, second = calibrated("one", targets=("x_mm",)), calibrated("two", targets=("height_mm",))
    with refused("no-common-target", InputError):
        compare_calibrations(first, second)


def test_errors_of_an_angle_and_of_a_plain_number_are_not_compared(calibrated) -> None:
    found = compare_calibrations(
        calibrated("one", targets=("x_mm",)), calibrated("two", targets=("x_mm",), circular={"x_mm": 9.0})
    )
    assert "period-differs" in [one.code for one in found.obstacles]
    assert found.targets[0].paired is None


def test_what_both_gave_on_another_run_and_whose_audit_failed_is_shown(
    calibrated, record_spots, tmp_path
) -> None:
    folders = [calibrated("one"), calibrated("two", seed=5)]
    other = record_spots("other", 10, seed=8)
    for folder in folders:
        keep_evaluation(folder, evaluate(Estimator.open(folder), other))
    keep_evaluation(folders[1], evaluate(Estimator.open(folders[1]), record_spots("own", 10, seed=9)))
    found = compare_calibrations(*folders)
    ((first, second),) = found.shared_runs
    assert first.run == second.run
    assert first.run["hash"] == other.hash
    assert [len(kept) for kept in found.to_dict()["evaluations"]] == [1, 2]
    assert found.to_dict()["sessions"][0]["names"] == ["run-16-0-False"]
    assert "another session" in comparison_text(found)
    assert found.warnings == ()
    page = write_comparison(found, tmp_path / "compared.html").read_text()
    assert "same recording" in page
    card = read_card(folders[0])
    finding = Finding(code=FindingCode.ROWS_SHIFTED, target="x_mm")
    confounds = card.confounds.model_copy(update={"findings": (finding,), "failed": True})
    text = sealed(card.model_dump(exclude={"id"}) | {"confounds": confounds}).model_dump_json()
    (folders[0] / "card.json").write_text(text)
    again = compare_calibrations(*folders)
    warning, left_out = again.warnings
    assert "its scores" in warning
    assert again.targets[0].column == "x_mm"
    assert f"held-out errors cannot decide, as the audit of {read_card(folders[0]).id} failed" in headline(
        again, again.targets[0]
    )
    assert headline(again, again.targets[1]) == judgement(again.targets[1])
    assert left_out.startswith("Left out: ")  # the evaluation names the card as it was
    assert next(folders[0].glob("evaluation-*.json")).name in left_out


def test_a_calibration_whose_network_was_altered_is_not_compared(calibrated) -> None:
    folders = [calibrated("one"), calibrated("two", model="mean")]
    network = folders[1] / "model.onnx"
    network.write_bytes(network.read_bytes()[:-1] + b"x")
    with refused("file-hash", CertificateError):
        compare_calibrations(*folders)
