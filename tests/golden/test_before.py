"""Certificates, calibrations and runs that were written before open, and give the same numbers.

`before.zip` was written by `write_before.py.txt` at commit d58013a, on another layout of the code; `tip.npz`,
`press.npz`, and `touch.json` at 9939dc0c, of the references rigid, 7.6, and 1.1 N/mm with three trials each.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused
from tests.rig.rigs import CLOCK_NS, keys, plan, rig, wanted
from typer.testing import CliRunner

from palpate.calibration import evaluate
from palpate.calibration.certificate import read_predictions
from palpate.calibration.compliance.compliance_calibration import ComplianceCalibration
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.cli import app
from palpate.core.clock import ManualClock
from palpate.core.units import split_column
from palpate.estimators import Estimator, read_card
from palpate.estimators.compliance.pin_press import PinPress
from palpate.recordings import Run, check
from palpate.reports import write_report
from palpate.rig import State, record
from palpate.rig.plans import Listed

# Another processor sums float32 products in another order; here the numbers are equal to the last bit.
FLOAT32 = 1e-5


@pytest.fixture(scope="module")
def before(tmp_path_factory) -> Path:
    """The files as they were written."""
    folder = tmp_path_factory.mktemp("before")
    with ZipFile(Path(__file__).with_name("before.zip")) as archive:
        archive.extractall(folder)
    return folder


def stored(path: Path):
    return json.loads(path.read_text(encoding="utf-8"))


def test_what_sense_prints_of_a_certificate_of_before_is_the_same_but_for_later_fields(before) -> None:
    printed = CliRunner().invoke(app, ["read", str(before / "run"), "--with", str(before / "cal"), "--json"])
    assert printed.exit_code == 0, printed.output
    found = [json.loads(line) for line in printed.stdout.splitlines()]
    for line in found:
        assert line.pop("simulated")
        for reading in line["readings"].values():
            assert reading.pop("drift") == line["drift"]
            assert (reading.pop("code") == "") == reading["valid"]
    known = (before / "sense.jsonl").read_text(encoding="utf-8")
    assert found == [json.loads(line) for line in known.splitlines()]


def test_a_certificate_of_before_reads_the_same_values_and_intervals(before) -> None:
    estimator, run = Estimator.open(before / "cal", threads=1), Run.open(before / "run")
    for frame, expected in zip(run.frames(), stored(before / "readings.json"), strict=True):
        readings = estimator.read(frame)
        assert list(readings) == list(expected)
        for name, ends in expected.items():
            reading = readings[split_column(name)[0]]  # in SI, as the numbers were written
            assert_allclose([reading.value, reading.low, reading.high], ends, rtol=FLOAT32, atol=1e-9)


def test_a_certificate_of_before_scores_the_same(before) -> None:
    scores = evaluate(Estimator.open(before / "cal", threads=1), Run.open(before / "run"))
    expected = stored(before / "scores.json")
    for column, target in expected.pop("targets").items():
        score = scores["targets"][column]
        assert score.pop("unit") == target.pop("unit")
        assert score == pytest.approx(target, rel=FLOAT32, abs=1e-9), column
    assert {name: scores[name] for name in expected} == expected


def test_held_out_predictions_of_before_give_the_scores_on_their_card(before) -> None:
    pytest.importorskip("pyarrow", reason="needs pyarrow: tables were Parquet then")
    card = read_card(before / "cal")
    table = read_predictions(before / "cal", card)
    for target in card.targets:
        error = table[f"estimate:{target.column}"] - table[target.column]
        assert float(error.abs().mean()) == pytest.approx(target.score.mae, rel=1e-12)
    assert write_report(before / "cal", before / "again.html").stat().st_size > 0


def test_the_report_of_a_certificate_of_before_says_what_to_install(before, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    told = CliRunner().invoke(app, ["report", str(before / "cal"), "--out", str(before / "none.html")])
    assert told.exit_code == 2
    assert "pip install 'palpate[parquet]'" in " ".join(told.output.split())
    assert not (before / "none.html").exists()


def test_a_tip_calibrated_before_reads_a_press_the_same(before) -> None:
    with np.load(before / "press.npz") as held:
        press = PinPress(**{k: float(v) if v.ndim == 0 else v for k, v in held.items()}, flaws=())
    calibration = ComplianceCalibration.load(before / "tip.npz")
    touch = read_touch(calibration, [press], "new")
    expected = stored(before / "touch.json")
    assert {reading.quantity for reading in touch.readings} == set(expected)
    for reading in touch.readings:
        told = expected[reading.quantity]
        ends = [told["value"], told["low"], told["high"]]
        assert_allclose([reading.value, reading.low, reading.high], ends, rtol=1e-9)
        assert [reading.unit, reading.valid, reading.why] == [told["unit"], told["valid"], told["why"]]
        assert reading.calibration == calibration.id


def test_a_tip_calibrated_by_a_version_without_the_seating_is_refused_with_that_version(before) -> None:
    with refused("certificate", match=r"version of palpate 0\.1\.0"):
        ComplianceCalibration.load(before / "tip-earlier.npz")


def test_a_recording_stopped_before_is_checked_alike_and_goes_on(before) -> None:
    verdict = json.loads(json.dumps(check(before / "stopped").to_dict()))
    del verdict["path"]
    said = stored(before / "check.json")
    assert {name: verdict[name] for name in said} == said
    since = {"orphan_frames": 0, "orphan_records": 0, "void_frames": 0, "zero_moved_N": None}
    assert {name: verdict[name] for name in verdict.keys() - said.keys()} == since, "and what is told since"
    first = keys(Run.open(before / "stopped"))
    small = plan(places=Listed(kind="listed", at_mm=((6.0, -4.0),)), depth_mm=0.4)
    assert set(first) < wanted(small)
    resumed = record(rig(clock=ManualClock(100 * CLOCK_NS)), small, before / "stopped")
    assert resumed.state is State.DONE
    run = Run.open(before / "stopped")
    assert keys(run)[: len(first)] == first
    assert set(keys(run)) == wanted(small)
    assert len(keys(run)) == len(wanted(small))
