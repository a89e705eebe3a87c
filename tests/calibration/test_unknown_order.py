"""Rows in the order of their images' names: nothing is said of an order in which nobody took them."""

import cv2
import numpy as np
import pandas as pd
import pytest
from tests.conftest import spots

from palpate.calibration import CalibrationPlan, calibrate
from palpate.calibration.confounds.confound_audit import order_not_tested
from palpate.calibration.confounds.row_order import recorded_units
from palpate.calibration.sessions.session_findings import label_findings
from palpate.estimators.certified import read_card
from palpate.estimators.findings import FindingCode
from palpate.recordings import Run, import_images

pytestmark = pytest.mark.usefixtures("changes_untried")


@pytest.fixture
def named_by_place(tmp_path):
    """Spots pressed in random order, whose names hold their place, and a number by which they were taken."""
    folder = tmp_path / "pressed"
    folder.mkdir()
    images, places, _ = spots(60, np.random.default_rng(0))
    for i, (image, place) in enumerate(zip(images, places, strict=True)):
        cv2.imwrite(str(folder / f"{place + 3:.4f}_{i}.png"), image)
    return folder, "{x_mm}_{shot}.png"


def test_order_of_names_is_no_order_of_recording(named_by_place, tmp_path) -> None:
    folder, pattern = named_by_place
    import_images(folder, tmp_path / "run", name_pattern=pattern)
    run = Run.open(tmp_path / "run")
    assert run.labels["x_mm"].is_monotonic_increasing
    assert run.manifest.order == "names"
    plan = CalibrationPlan(("x_mm",), model="mean", split="random", size_px=(24, 32))
    card = read_card(calibrate(run, plan, tmp_path / "cal"))
    assert [one.code for one in card.confounds.findings] == [FindingCode.ORDER_UNKNOWN]
    assert [one.neighbors_r2 for one in card.confounds.targets] == [None]


def test_sorted_rows_and_alternating_sessions_are_findings_only_of_an_order_of_recording() -> None:
    table = pd.DataFrame({"session": ["cup", "pin"] * 30, "x_mm": np.arange(60.0)})
    values = table[["x_mm"]].to_numpy()
    alternate = FindingCode.SESSIONS_ALTERNATE
    assert alternate in {one.code for one in label_findings(table, values, ["x_mm"])}
    assert alternate not in {one.code for one in label_findings(table, values, ["x_mm"], False)}
    assert order_not_tested(recorded_units(values)) == []
