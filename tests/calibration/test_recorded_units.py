"""Rows recorded at one go are told from rows in order, and order is asked within each session."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from palpate.calibration.calibration_job import presses_of, recordings_of
from palpate.calibration.confounds.confound_audit import order_not_tested
from palpate.calibration.confounds.row_order import OrderCheck, order_checks, recorded_units
from palpate.estimators.findings import FindingCode
from palpate.recordings.splits import split


def checked(
    label: np.ndarray, sessions: np.ndarray | None = None, presses: np.ndarray | None = None, seed: int = 0
) -> OrderCheck:
    values = label[:, None]
    units = recorded_units(values, presses, sessions)
    return order_checks(values, units, np.arange(float(len(label))), seed)[0]


def held(rng: np.random.Generator, presses: int, rows: int) -> np.ndarray:
    """Presses held at 1 to 10 N in random order, each row with a jitter of 0.03 N."""
    return np.repeat(rng.uniform(1, 10, presses), rows) + rng.normal(0, 0.03, presses * rows)


def test_units_are_the_groups_or_stretches_of_equal_labels() -> None:
    values = np.array([[1.0], [1.0], [2.0], [1.0]])
    assert recorded_units(values).of.tolist() == [0, 0, 1, 2]
    assert recorded_units(values, np.array(["b", "a", "b", "a"])).of.tolist() == [1, 0, 1, 0]
    assert recorded_units(values, np.arange(4)).of.tolist() == [0, 0, 1, 2]
    assert recorded_units(values, np.array(["b", "a", "b", "a"])).kind == "presses"


@pytest.mark.parametrize(("presses", "rows"), [(10, 30), (20, 20), (60, 5)])
def test_held_presses_in_random_order_need_no_column_to_raise_no_alarm(presses, rows) -> None:
    """At a level of 1 %, 2 or more of 20 alarm in 2 % of tests that are right."""
    rng = np.random.default_rng(3)
    checks = [checked(held(rng, presses, rows), seed=i) for i in range(20)]
    assert sum(check.follows for check in checks) <= 1
    counts = [recorded_units(held(rng, presses, rows)[:, None]).count for _ in range(20)]
    assert 0.9 * presses <= np.mean(counts) <= presses
    assert {check.units for check in checks} == {"stretches of nearly equal labels"}


@pytest.mark.parametrize("n", [20, 80, 300])
def test_single_rows_in_order_are_no_holds(n) -> None:
    """However they lie: evenly, crowded at small forces, or in two clusters."""
    rng = np.random.default_rng(4)
    even, clusters = rng.uniform(1, 10, n), np.r_[rng.uniform(1, 2, n // 2), rng.uniform(8, 9, n - n // 2)]
    for label in (even, clusters, rng.lognormal(0, 1, n)):
        check = checked(np.sort(label))
        assert check.follows
        assert check.units == "rows"
    assert not checked(rng.permutation(even)).follows


@pytest.mark.parametrize("sessions", range(1, 10))
@pytest.mark.cases(2)
def test_labels_in_order_in_each_session_are_found_and_others_are_not(sessions) -> None:
    """A saw-tooth rises in each session; a zigzag rises in one and falls in the next."""
    rng = np.random.default_rng(sessions)
    of = np.repeat(np.arange(sessions), 30)
    rising = np.concatenate([np.sort(rng.uniform(1, 10, 30)) for _ in range(sessions)])
    zigzag = np.concatenate([rising[of == k][:: 1 - 2 * (k % 2)] for k in range(sessions)])
    for label in (rising, zigzag, rising + 5 * of):
        check = checked(label, of)
        assert check.follows
        assert check.share > 0.9
    assert checked(rising + 100 * of, of).rank_correlation == pytest.approx(1)
    assert checked(rising, of).share == pytest.approx(checked(rising + 50 * of, of).share)
    alarms = [checked(rng.uniform(1, 10, len(of)) + 5 * of, of, seed=i).follows for i in range(12)]
    assert sum(alarms) <= 1


def test_of_forty_clean_recordings_of_three_sessions_one_alarms_at_most() -> None:
    """Of single rows; of 24 presses, whose few orders a level of 1 % lets by."""
    rng = np.random.default_rng(6)
    offsets = np.repeat(rng.normal(0, 2, (40, 3)), 40, axis=1)
    rows = [
        checked(rng.uniform(1, 10, 120) + offsets[i], np.repeat(np.arange(3), 40), seed=i) for i in range(40)
    ]
    assert sum(check.follows for check in rows) <= 1
    of = np.repeat(np.arange(24), 5)
    presses = [checked(rng.uniform(1, 10, 24)[of] + offsets[i], of // 8, of, i) for i in range(40)]
    assert sum(check.follows for check in presses) <= 2


def test_order_is_asked_from_six_presses_of_one_session_on() -> None:
    """Five have 120 orders; two sessions of five have 14,400."""
    for presses, sessions, asked in ((5, 1, False), (6, 1, True), (5, 2, True), (3, 2, False)):
        of = np.repeat(np.arange(presses * sessions), 10)
        label, session = (of % presses).astype(float), of // presses
        check = checked(label, session, of)
        assert check.asked == check.follows == asked
        notes = order_not_tested(recorded_units(label[:, None], of, session))
        assert [note.code for note in notes] == ([] if asked else [FindingCode.ORDER_OF_FEW])


def test_sessions_and_blocks_are_no_presses_and_what_a_split_names_otherwise_is() -> None:
    table = pd.DataFrame({"session": list("aaabbb"), "press": [1, 1, 2, 1, 2, 2], "grip": list("xxyyzz")})
    assert recordings_of(table).tolist() == list("aaabbb")
    assert recordings_of(table[["press"]]) is None
    assert presses_of(table, split(table, "session")).tolist() == [0, 0, 1, 2, 3, 3]
    bare = table[["session", "grip"]]
    assert presses_of(bare, split(bare, "session")) is None
    assert presses_of(bare, split(bare, "blocks:2", folds=2)) is None
    assert presses_of(bare, split(bare, "group:grip", folds=2)).tolist() == [0, 0, 1, 1, 2, 2]
