"""The page says what the card says, and says when a model does not read a target."""

import html

import pytest

from palpate.calibration import CalibrationPlan, calibrate
from palpate.core import CertificateError
from palpate.core.provenance import Provenance
from palpate.estimators import read_card
from palpate.reports import render_report, scores_table, verdict, write_report

pytestmark = pytest.mark.usefixtures("figures_drawn_once", "changes_untried")


@pytest.fixture
def calibration(calibrate_spots, tmp_path):
    plan = {
        "targets": ("x_mm", "height_mm"),
        "split": "group:press",
        "size_px": (12, 16),
        "channels": 3,
        "model": "pca-ridge",
    }
    return calibrate_spots(tmp_path / "cal", colour=True, **plan)[1]


def test_the_page_shows_every_target_and_the_audit(calibration, tmp_path) -> None:
    page = write_report(calibration, tmp_path / "page.html").read_text()
    card = read_card(calibration)
    for target in card.targets:
        assert verdict(target, groups=16).split(":")[0][:30] in page
    assert card.split.audit_text in html.unescape(page)
    assert page.count("<svg") >= 3 * len(card.targets)
    assert page.count("data:image/png") >= 6 + 2  # worst cases, an example and the untouched sensor
    assert "<script" not in page
    assert "http" not in page


@pytest.mark.parametrize(
    ("update", "simulated"),
    [
        ({"provenance": Provenance.MEASURED, "origin": "shear was not measured"}, False),
        ({"provenance": Provenance.SIMULATED, "origin": "rendered by our simulator"}, True),
        ({"provenance": None, "origin": "a bench"}, False),
        ({"provenance": None, "origin": "a virtual rig; virtual, not measured"}, True),
    ],
)
def test_the_head_of_the_page_says_where_the_recording_was_simulated(calibration, update, simulated) -> None:
    card = read_card(calibration)
    told = card.model_copy(update={"run": card.run.model_copy(update=update)})
    head = render_report(calibration, told).split("<section")[0]
    assert ("not measured" in head) == simulated


def test_a_page_is_not_written_from_altered_predictions(calibration, tmp_path) -> None:
    with (calibration / "predictions.csv.gz").open("ab") as file:
        file.write(b"\0")
    with pytest.raises(CertificateError, match=r"predictions.csv.gz"):
        write_report(calibration, tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_a_target_that_the_model_does_not_read_is_called_so(record_spots, tmp_path) -> None:
    plan = CalibrationPlan(("x_mm",), model="mean", split="group:press", size_px=(6, 8))
    card = read_card(calibrate(record_spots("run", 10), plan, tmp_path / "cal"))
    assert "model does" in verdict(card.targets[0])
    assert "model does" in scores_table({"x_mm": card.targets[0].score})


def test_the_verdict_is_that_of_the_coverage_over_all_rows_and_in_each_tenth(calibration) -> None:
    target = read_card(calibration).targets[0]

    def said(low: float, high: float, p: float = 1.0) -> str:
        ends = {"coverage_90": (low + high) / 2, "coverage_90_low": low, "coverage_90_high": high}
        tenths = tuple(one.model_copy(update={"p": p}) for one in target.over_range.tenths)
        changes = {
            "score": target.score.model_copy(update=ends),
            "over_range": target.over_range.model_copy(update={"tenths": tenths}),
        }
        return verdict(target.model_copy(update=changes))

    assert "less often" in said(0.7, 0.85)
    assert "cannot judge" in said(0.65, 0.95)
    assert "whole range" in said(0.85, 0.95, p=1e-6)
    assert "they are wide" in said(0.92, 0.98)
    assert "as promised" in said(0.85, 0.95)
