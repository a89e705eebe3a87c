"""Columns that name no sessions are refused; sessions that show nothing of another day are said to."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest
from tests.refusals import refused

from palpate.calibration import CalibrationPlan, calibrate
from palpate.calibration.calibration_job import check_sessions
from palpate.calibration.sessions.session_findings import label_findings
from palpate.core import SplitError
from palpate.estimators import read_card
from palpate.estimators.findings import FindingCode
from palpate.recordings import Split

pytestmark = pytest.mark.usefixtures("changes_untried")

PLAN = CalibrationPlan(("x_mm", "height_mm"), "mean", "session", size_px=(24, 32))


def table_of(sessions, rng) -> pd.DataFrame:
    return pd.DataFrame({"session": sessions, "x_mm": rng.uniform(-1, 1, len(sessions))})


def refused_sessions(code: str, table: pd.DataFrame, columns: list[str]) -> None:
    parts = Split("session", ("session",), table["session"].to_numpy(), (), "")
    values = table[columns].to_numpy(float)
    with refused(code, SplitError) if code else nullcontext():
        check_sessions(table, values, columns, parts)


def test_a_session_that_repeats_a_target_is_refused(rng) -> None:
    depths = np.repeat([0.5, 1.0, 1.5], 20)
    table = table_of(depths, rng).assign(depth_mm=depths)
    refused_sessions("session-is-target", table, ["x_mm", "depth_mm"])
    refused_sessions("", table, ["x_mm"])


@pytest.mark.parametrize(
    ("code", "names"),
    [
        ("session-numbers-rows", [f"s{i}" for i in range(60)]),
        ("", [f"s{i // 3}" for i in range(60)]),
        ("session-spelling", np.repeat(["Day1", "day1"], 20)),
        ("session-spelling", np.repeat(["Day1", "Day1 "], 20)),
        ("session-spelling", np.repeat(["Day1", "day 1"], 20)),
        ("", np.repeat(["Day1", "Day2"], 20)),
        ("", np.repeat(["2026-11-21", "2026-11-22"], 20)),
    ],
)
def test_labels_that_name_no_sessions_are_refused(code, names, rng) -> None:
    refused_sessions(code, table_of(names, rng), ["x_mm"])


def codes(sessions, rng, **columns) -> list[FindingCode]:
    table = table_of(sessions, rng).assign(**columns)
    targets = ["x_mm", *columns]
    return [one.code for one in label_findings(table, table[targets].to_numpy(float), targets)]


def test_what_speaks_against_sessions_is_named_and_nothing_of_two_good_days(rng) -> None:
    two = np.repeat(["mon", "tue"], 30)
    assert codes(two, rng) == []
    assert FindingCode.SESSION_OF_FEW_ROWS in codes([*two, "wed"], rng)
    assert codes(["mon", "tue"] * 30, rng) == [FindingCode.SESSIONS_ALTERNATE]
    still = np.r_[np.ones(30), rng.uniform(0, 5, 30)]
    assert FindingCode.CONSTANT_IN_SESSION in codes(two, rng, force_N=still)
    angle = np.r_[rng.uniform(-180, 180, 30), rng.uniform(-np.pi, np.pi, 30)]
    assert codes(two, rng, angle_deg=angle) == [FindingCode.UNIT_OF_SESSION]


def test_all_but_one_row_in_a_session_leave_nothing_to_learn_from_and_are_refused(
    record_spots, rewritten, tmp_path
) -> None:
    run = record_spots("long", 10)
    sessions = iter(["mon"] * (len(run) - 1) + ["tue"])
    uneven = rewritten(run, tmp_path / "uneven", lambda row: {**row, "session": next(sessions)})
    with refused("split-trains-few", SplitError):
        calibrate(uneven, PLAN, tmp_path / "cal")


def test_one_session_under_two_names_is_said_on_the_card(record_spots, rewritten, tmp_path) -> None:
    """Frames of one mounting with other noise, which are no copies to the last byte."""
    rng = np.random.default_rng(0)
    first = record_spots("monday", 6)

    def noisy(image):
        return np.clip(image + rng.integers(-1, 2, image.shape), 0, 255).astype(np.uint8)

    second = rewritten(first, tmp_path / "again", image=noisy)
    card = read_card(calibrate([first, second], PLAN, tmp_path / "cal"))
    assert FindingCode.SESSIONS_COPIED in {finding.code for finding in card.sessions.findings}
