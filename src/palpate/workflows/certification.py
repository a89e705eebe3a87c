"""Calibrate and report in one go: the folder holds its own page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.fitting import calibrate
from palpate.core import PathText, Progress, silent
from palpate.estimators.certified import read_card
from palpate.estimators.model_card import Card
from palpate.recordings import Run
from palpate.reports.certificate_page import write_report

REPORT_FILE = "report.html"


def certify(
    run: Run | Sequence[Run], plan: CalibrationPlan, out: PathText, progress: Progress = silent
) -> Card:
    """Calibrate, see `calibration.calibrate`, and write the report into the calibration's folder."""
    out = Path(out)
    calibrate(run, plan, out, progress)
    progress("writing the report", 0, 1)
    write_report(out, out / REPORT_FILE)
    progress("writing the report", 1, 1)
    return read_card(out)
