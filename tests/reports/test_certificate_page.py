"""The page says what the card says, and says when a model does not read a target."""

import html

import numpy as np
import pandas as pd
import pytest

from palpate.calibration import CalibrationPlan, calibrate
from palpate.calibration.evaluation import score
from palpate.core import CertificateError
from palpate.core.provenance import Provenance
from palpate.estimators import read_card
from palpate.reports import render_report, scores_table, verdict, write_report
from palpate.reports.sections import MIN_TOLD, outer_ranges

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


def held_out(card, missed_at_the_top: int, rng: np.random.Generator, n: int = 500):
    """A target's card and held-out rows: truth 0 to 6 mm, 450 of 500 covered."""
    true = np.linspace(0, 6, n)
    missed = np.zeros(n, bool)
    missed[rng.choice(np.arange(n - 50, n), missed_at_the_top, replace=False)] = True
    missed[rng.choice(np.arange(n - 50), n // 10 - missed_at_the_top, replace=False)] = True
    estimate = true - np.where(missed, 0.3, 0.02)
    half = np.full(n, 0.1)
    found = score("mm", true, estimate, half, 3.0, np.arange(n))
    target = card.targets[0].model_copy(update={"column": "depth_mm", "quantity": "depth", "score": found})
    return target.model_copy(update={"unit": "mm"}), pd.DataFrame(
        {"depth_mm": true, "estimate:depth_mm": estimate, "half_width:depth_mm": half}
    )


def test_as_promised_is_said_where_both_outer_ranges_cover(calibration, rng) -> None:
    target, table = held_out(read_card(calibration), 5, rng)
    ends = outer_ranges(target, table, np.arange(len(table)))
    assert [end.n for end in ends] == [50, 50]
    assert "as promised" in verdict(target, ends)


def test_ends_with_too_few_rows_are_not_judged(calibration, rng) -> None:
    target, table = held_out(read_card(calibration), 5, rng)
    few = table.iloc[::15]
    assert outer_ranges(target, few, np.arange(len(few))) == ()
    assert "too few" in verdict(target)


@pytest.mark.parametrize("missed", [0, 1, 3])
@pytest.mark.cases(1)
def test_one_press_at_an_end_is_never_enough_to_judge_it(calibration, rng, missed) -> None:
    target, table = held_out(read_card(calibration), 0, rng)
    table.loc[table.index[len(table) - missed :], "estimate:depth_mm"] -= 1.0
    presses = np.minimum(np.arange(len(table)), len(table) - 50)
    (_, end) = ends = outer_ranges(target, table, presses)
    assert (end.n, end.covered) == (50, 50 - missed)
    assert end.low < MIN_TOLD
    assert end.high > 0.9
    assert "above 5.41" in verdict(target, ends)
