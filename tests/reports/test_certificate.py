"""The page says what the card says, and says when a model does not read a target."""

import html

import pytest

from palpate.calibration import Plan, calibrate
from palpate.core import CertificateError
from palpate.estimators import read_card
from palpate.reports import scores_table, verdict, write_report
from palpate.reports.text import latency_line


@pytest.fixture
def calibration(record_spots, tmp_path):
    plan = Plan(("x_mm", "height_mm"), split="group:press", size_px=(24, 32), channels=3)
    return calibrate(record_spots("run", 16, colour=True), plan, tmp_path / "cal")


def test_the_page_shows_every_target_and_the_audit(calibration, tmp_path) -> None:
    page = write_report(calibration, tmp_path / "page.html").read_text()
    card = read_card(calibration)
    for target in card.targets:
        assert verdict(target).split(":")[0][:30] in page
    assert card.split.audit in html.unescape(page)
    assert page.count("data:image/png") >= len(card.targets) + 6
    assert "<script" not in page


def test_a_page_is_not_written_from_altered_predictions(calibration, tmp_path) -> None:
    with (calibration / "predictions.parquet").open("ab") as file:
        file.write(b"\0")
    with pytest.raises(CertificateError, match=r"predictions.parquet"):
        write_report(calibration, tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_a_target_that_the_model_does_not_read_is_called_so(record_spots, tmp_path) -> None:
    plan = Plan(("x_mm",), model="mean", split="group:press")
    card = read_card(calibrate(record_spots("run", 16), plan, tmp_path / "cal"))
    assert "This model does not read x" in verdict(card.targets[0])
    assert "this model does not read it" in scores_table({"x_mm": card.targets[0].score})


def test_the_first_frame_s_warm_up_is_left_out_of_the_latency() -> None:
    assert "median 2.00 ms" in latency_line([1.0, 0.002, 0.002, 0.002])
