"""Labels called as the code calls columns of its own: they are kept, and the code's stand beside them."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.calibration import CalibrationPlan, calibrate, evaluate
from palpate.calibration.evaluation import predictions
from palpate.core import LabelError, ManualClock
from palpate.estimators import Estimator
from palpate.recordings import Manifest, Run, RunWriter
from palpate.recordings.label_tables import read_table
from palpate.reports import write_report

pytestmark = pytest.mark.usefixtures("changes_untried")

NAMES = (
    "row",
    "frame",
    "index",
    "time_s",
    "fold",
    "split",
    "location",
    "held_out_in_fold",
    "valid",
    "why",
    "name",
)


def recorded(path, names=NAMES, frames: int = 24) -> Run:
    """A spot whose place is a label, beside numbers of the given names."""
    labels = {"x_mm": "number", "reference": "flag", **dict.fromkeys(names, "number")}
    rng, clock = np.random.default_rng(frames), ManualClock()
    columns = np.arange(32)
    with RunWriter.create(
        path, Manifest.new(sensor="s", labels=labels), clock=clock, overflow="wait"
    ) as writer:
        for i in range(frames):
            clock.sleep(0.1)
            x_mm = float(rng.uniform(-2, 2))
            line = 40 + 150 * np.exp(-((columns - 16 - 4 * x_mm) ** 2) / 20)
            image = (line + rng.normal(0, 2, (24, 32))).clip(0, 255).astype(np.uint8)
            numbers = {name: float(7 * k + i // 4) for k, name in enumerate(names)}
            writer.frame(image, labels={"x_mm": x_mm, "reference": i % 4 == 0, **numbers})
    return Run.open(path)


@pytest.mark.parametrize("split", ["auto", "group:row", "group:frame", "group:fold", "leave-one-out:index"])
@pytest.mark.cases(1)
def test_every_label_s_name_goes_through_a_calibration_and_keeps_its_values(split, tmp_path) -> None:
    run = recorded(tmp_path / "run")
    plan = CalibrationPlan(("x_mm",), model="mean", split=split, size_px=(12, 16), folds=3)
    calibrate(run, plan, tmp_path / "cal")
    table = read_table(tmp_path / "cal" / "predictions.csv.gz")
    learnt = np.flatnonzero(~run.labels["reference"].to_numpy(bool))[table["own:row"]]
    for name in NAMES:
        np.testing.assert_array_equal(table[name], run.labels[name][learnt], err_msg=name)
    assert table["own:frame"].tolist() == [run.frame(int(row)).name for row in learnt]
    if split.startswith("group:"):
        column = split.partition(":")[2]
        assert table.groupby(column)["own:held_out_in_fold"].nunique().max() == 1
    write_report(tmp_path / "cal", tmp_path / "cal.html")
    estimator = Estimator.open(tmp_path / "cal")
    told = predictions(estimator, run)
    assert told["own:valid"].dtype == bool
    np.testing.assert_array_equal(told["valid"], run.labels["valid"][learnt])
    assert evaluate(estimator, run)["frames_valid"] == told["own:valid"].sum()


@pytest.mark.parametrize("name", ["own:row", "estimate:x_mm", "half_width:x_mm", "frame:name"])
def test_a_label_that_begins_as_the_code_s_own_is_refused_before_anything_is_packed(name, tmp_path) -> None:
    run = recorded(tmp_path / "run", names=(name,))
    with pytest.raises(LabelError, match="rename it"):
        calibrate(run, CalibrationPlan(("x_mm",), model="mean", split="random"), tmp_path / "cal")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
