"""Two calibrations side by side: compared row by row where they can be, and else told why not."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from palpate.calibration import CalibrationPlan, calibrate
from palpate.cli import app
from palpate.core import ExistsError, InputError
from palpate.recordings.table_files import read_table
from palpate.reports.comparison_page import compare_calibrations, comparison_text, judgement, write_comparison


@pytest.fixture
def calibrated(record_spots, tmp_path):
    """A function that calibrates on a run of a name, with changes to the plan."""
    runs = {}

    def make(out: str, run: str = "run", **changes):
        if run not in runs:
            runs[run] = record_spots(run, 16, seed=len(runs))
        plan = {"targets": ("x_mm", "height_mm"), "split": "group:press", "size_px": (24, 32)} | changes
        return calibrate(runs[run], CalibrationPlan(**plan), tmp_path / out)

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
    assert "the first errs less, by" in said
    assert "-" not in said  # how much less, and its interval, are said of the better one: as positive numbers
    other_way = compare_calibrations(tmp_path / "mean", tmp_path / "good").targets[0]
    assert other_way.paired.difference == pytest.approx(-pair.difference)
    assert judgement(other_way) == said.replace("first", "second")


def test_a_calibration_beside_its_twin_is_not_called_better(calibrated) -> None:
    found = compare_calibrations(calibrated("one"), calibrated("two"))
    assert found.obstacles == ()
    assert "do not tell which errs less" in judgement(found.targets[0])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"run": "another"}, "different recordings"),
        ({"split": "random"}, "held out in different ways, group:press and random"),
        ({"scored_folds": 2}, "different rows: 80 and"),
        ({"seed": 5}, "the folds differ"),
    ],
)
def test_scores_of_different_rows_are_not_compared(calibrated, changes, says) -> None:
    found = compare_calibrations(calibrated("one"), calibrated("two", **changes))
    assert says in " ".join(found.obstacles)
    assert all(one.paired is None for one in found.targets)
    assert "errs less" not in comparison_text(found)
    assert "NOT COMPARABLE" in comparison_text(found)


def test_targets_are_matched_by_column_and_the_others_named(calibrated) -> None:
    found = compare_calibrations(calibrated("one"), calibrated("two", targets=("height_mm",)))
    assert [one.column for one in found.targets] == ["height_mm"]
    assert found.only == (("x_mm",), ())
    assert found.targets[0].first.column == found.targets[0].second.column == "height_mm"


def test_calibrations_without_a_target_in_common_are_refused(calibrated) -> None:
    first, second = calibrated("one", targets=("x_mm",)), calibrated("two", targets=("height_mm",))
    with pytest.raises(InputError, match="no target in common"):
        compare_calibrations(first, second)


def test_the_verb_prints_and_writes_the_comparison_once(calibrated, tmp_path) -> None:
    words = ["compare", str(calibrated("one")), str(calibrated("two", seed=5)), "--json"]
    result = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "page.html")])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["comparable"] is False
    assert set(found["targets"]) == {"x_mm", "height_mm"}
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "cannot be compared" in page
    assert "http" not in page
    assert CliRunner().invoke(app, [*words, "--out", str(tmp_path / "page.html")]).exit_code == 2
    with pytest.raises(ExistsError):
        write_comparison(compare_calibrations(words[1], words[2]), tmp_path / "page.html")
