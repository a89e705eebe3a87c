"""The instrument of labels is neither lost nor taken for another's, and judges an interval's length."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from palpate.calibration import CalibrationPlan, adapt, calibrate, evaluate
from palpate.calibration.sessions import keep_evaluation, reset_intervals
from palpate.calibration.sessions.session_findings import read_evaluation
from palpate.estimators import Estimator, read_card
from palpate.recordings import Run, RunWriter
from palpate.recordings.joined_runs import joined
from palpate.recordings.manifest import ReferenceInstrument
from palpate.reports.terminal_text import instrument_lines

pytestmark = pytest.mark.usefixtures("changes_untried")

FORMER = {"x_mm": ReferenceInstrument(instrument="stage A", standard_uncertainty=0.2)}
OTHER = {"x_mm": ReferenceInstrument(instrument="laser B", standard_uncertainty=0.5)}
FINE = {"x_mm": ReferenceInstrument(instrument="fine C", standard_uncertainty=0.01)}
PLAN = {"targets": ("x_mm",), "split": "group:press", "size_px": (12, 16), "model": "pca-ridge"}


def stating(run: Run, instruments: dict[str, ReferenceInstrument]) -> Run:
    """The run, recorded with a manifest that states these instruments."""
    out = run.path.with_name(f"{run.path.name}-{len(list(run.path.parent.iterdir()))}")
    changes = {"run_id": f"{run.manifest.run_id}-stated", "instruments": instruments}
    with RunWriter.create(out, run.manifest.model_copy(update=changes), overflow="wait") as writer:
        for i, row in enumerate(run.labels.to_dict("records")):
            writer.frame(run.frame(i).image, labels=row)
    return Run.open(out)


def kept_instruments(folder, scores) -> dict[str, str] | None:
    """What the file beside a card says of instruments."""
    return read_evaluation(keep_evaluation(folder, scores), read_card(folder)).instruments


def named(card) -> list[tuple[str, float]]:
    return [(t.measured_by.instrument, t.measured_by.standard_uncertainty) for t in card.targets]


@pytest.fixture(scope="module")
def former(record_spots_module, tmp_path_factory) -> Path:
    """A calibration that states its instrument, to be looked at and taken over."""
    out = tmp_path_factory.mktemp("former") / "cal"
    return calibrate(record_spots_module("run", 20), CalibrationPlan(**PLAN, instruments=FORMER), out)


@pytest.mark.slow
@pytest.mark.parametrize("take_over", [adapt, reset_intervals])
def test_a_new_run_s_instrument_goes_before_the_former_which_stands_where_none_is_stated(
    take_over, former, record_spots, tmp_path
) -> None:
    silent, stated = record_spots("silent", 12, seed=1), stating(record_spots("stated", 12, seed=2), OTHER)
    take_over(former, silent, tmp_path / "kept")
    take_over(former, stated, tmp_path / "taken")
    assert named(read_card(tmp_path / "kept")) == [("stage A", 0.2)]
    assert named(read_card(tmp_path / "taken")) == [("laser B", 0.5)]
    assert read_card(tmp_path / "taken").targets[0].measured_by.half_width == pytest.approx(1.6448536 * 0.5)
    assert "x_mm" in read_card(tmp_path / "kept").steps.words[-2]
    (line,) = instrument_lines(read_card(tmp_path / "taken").targets)
    assert re.match(r"x_mm: ±0\.82 mm of its labels' instrument \(laser B\)", line)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.cases(1)
def test_joined_runs_have_the_least_certain_instrument_in_whichever_order(order, record_spots) -> None:
    runs = [stating(record_spots("a", 3), FINE), stating(record_spots("b", 3, seed=1), OTHER)]
    found = joined([runs[k] for k in order]).manifest.instruments["x_mm"]
    assert found.standard_uncertainty == 0.5
    assert found.instrument.startswith("laser B, the least certain of ")
    assert "fine C" in found.instrument


def test_an_interval_that_is_as_long_as_the_range_with_its_instrument_tells_nothing(
    record_spots, tmp_path
) -> None:
    wide = {"x_mm": ReferenceInstrument(instrument="ruler", standard_uncertainty=5.0)}
    run, fresh = record_spots("run", 12), record_spots("fresh", 3, seed=1)
    rows = {}
    for name, instruments in (("bare", {}), ("traced", wide)):
        calibrate(run, CalibrationPlan(**PLAN, instruments=instruments), tmp_path / name)
        estimator = Estimator.open(tmp_path / name)
        rows[name] = evaluate(estimator, fresh)
        reading = estimator.read(fresh.frame(2))["x_mm"]
        assert reading.valid == (name == "bare")
        assert ("this frame does not tell x" in reading.why) == (name == "traced")
    assert rows["bare"]["frames_untold"]["x_mm"] == 0 < rows["bare"]["frames_valid"]
    assert rows["traced"]["frames_untold"]["x_mm"] == rows["traced"]["frames_scored"]
    assert rows["traced"]["frames_valid"] == 0
    # Scores leave the instrument out; of labels by another one, or one not stated, that is said.
    assert rows["bare"]["instruments"] == rows["bare"]["coverage_with_instrument"] == {}
    assert rows["traced"]["coverage_with_instrument"] == {"x_mm": 1.0}  # ±8 mm hold all of a range of 4 mm
    assert rows["traced"]["targets"]["x_mm"] == rows["bare"]["targets"]["x_mm"] | {
        "half_width": pytest.approx(rows["bare"]["targets"]["x_mm"]["half_width"])
    }
    said = rows["traced"]["instruments"]["x_mm"]
    assert kept_instruments(tmp_path / "traced", rows["traced"]) == {"x_mm": said}
    assert "are by laser B" in evaluate(estimator, stating(fresh, OTHER))["instruments"]["x_mm"]
    assert evaluate(estimator, stating(fresh, wide))["instruments"] == {}
