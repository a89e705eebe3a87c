"""The matrix of faults and states: every cell keeps its law, the page is what was measured, none is empty.

The ordinary suite runs every third fault of the rig in one state, by a fixed rule that comes to each
state, and a few cells of the stage; the slow tests run all.
"""

import multiprocessing
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import pytest
from tests.rig.fault_matrix.engine_states import GRBL_STATES, STATES, EngineState, short
from tests.rig.fault_matrix.fault_injection import RigFault, both
from tests.rig.fault_matrix.grbl_faults import GRBL_FAULTS
from tests.rig.fault_matrix.matrix_cell import Cell, faults_of, run_cell, run_grbl_cell
from tests.rig.fault_matrix.matrix_page import (
    CSV,
    FIRMWARES,
    PAGE_FILE,
    from_csv,
    key_of,
    keys,
    outcome,
    page,
)
from tests.rig.fault_matrix.observed_rig import ObservedRig
from tests.rig.fault_matrix.rig_faults import EVERY_FAULT, FAULTS, RECOVERY_FAULTS
from tests.slow_params import mostly_slow

from palpate.devices import MotionGuard
from palpate.devices.force_trust import ForceMonitor
from palpate.devices.motion_limits import ForceWatch
from palpate.rig.virtual.virtual_stage import VirtualStage

STRIDE = 3  # states from one fault's to the next: it comes to all ten
EVERY = 3  # one fault in so many runs in the ordinary suite
NAMED = {(fault.part, fault.name): fault for fault in EVERY_FAULT}
FRAMES = {"camera": 7}  # so that one that repeats itself is found out; one where no camera fails
WHOLE = ("programme", "skin")  # what they do depends on how well the skin's stiffness is known


def ordinary(fault: RigFault, state: EngineState) -> EngineState:
    """The state with a press less and few frames, where that makes no difference."""
    return state if fault.part in WHOLE else short(state, FRAMES.get(fault.part, 1))


ORDINARY = [
    (fault, ordinary(fault, STATES[(STRIDE * i + 1) % len(STATES)])) for i, fault in enumerate(FAULTS)
]
GOES_ON = ORDINARY[1 :: len(ORDINARY) // 3]
RECOVERED = [
    (fault, short(state))
    for fault, names in zip(RECOVERY_FAULTS, ("press", "slide", "pause", "idle", "idle", "idle"), strict=True)
    for state in STATES
    if state.name in names
]
ORDINARY_GRBL = [
    (GRBL_FAULTS[STRIDE * i % len(GRBL_FAULTS)], state, FIRMWARES[i % 2])
    for i, state in enumerate(GRBL_STATES)
    if i % 5 == 1
]


def state_of(name: str, states=STATES):
    return next(state for state in states if state.name == name)


@pytest.mark.parametrize(
    ("fault", "state"),
    mostly_slow(ORDINARY, lambda i: i % EVERY == 0),
    ids=[f"{f.part}: {f.name} / {s.name}" for f, s in ORDINARY],
)
@pytest.mark.cases(3)
def test_a_fault_is_stopped_named_and_lifted(fault: RigFault, state) -> None:
    assert faults_of(run_cell(fault, state, goes_on=False), fault) == []


@pytest.mark.parametrize(
    ("fault", "state"), GOES_ON, ids=[f"{f.part}: {f.name} / {s.name}" for f, s in GOES_ON]
)
@pytest.mark.cases(1)
def test_after_a_fault_the_same_command_goes_on_to_the_plan_s_frames(fault: RigFault, state) -> None:
    assert run_cell(fault, state).went_on == ""


@pytest.mark.parametrize(
    ("fault", "state", "firmware"),
    ORDINARY_GRBL,
    ids=[f"{f.part}: {f.name} / {s.name}, {w}" for f, s, w in ORDINARY_GRBL],
)
@pytest.mark.cases(1)
def test_a_fault_of_the_stage_is_stopped_named_lifted_and_recorded_on(fault, state, firmware):
    assert faults_of(run_grbl_cell(fault, state, firmware), fault) == []


@pytest.mark.parametrize(
    ("fault", "state"), RECOVERED, ids=[f"{f.part}: {f.name} / {s.name}" for f, s in RECOVERED]
)
@pytest.mark.cases(1)
def test_a_fault_is_overcome_by_a_repeated_press_or_shown_by_the_first(fault: RigFault, state) -> None:
    assert faults_of(run_cell(fault, state), fault) == []


def test_the_rule_gives_each_fault_one_state_and_each_state_some_faults() -> None:
    per_state = Counter(state.name for _, state in ORDINARY)
    assert set(per_state) == {state.name for state in STATES}
    assert min(per_state.values()) >= 4
    usual = ORDINARY[::EVERY]
    assert {state.name for _, state in usual} == {state.name for state in STATES}
    assert {fault.part for fault, _ in usual} == {fault.part for fault in FAULTS}


class TestControls:
    """What the law must notice."""

    def cell(self, part: str, name: str, state: str) -> tuple[Cell, RigFault]:
        fault = NAMED[part, name]
        return run_cell(fault, short(state_of(state)), goes_on=False), fault

    def broken(self, part: str, name: str, state: str) -> str:
        return " ".join(faults_of(*self.cell(part, name, state)))

    def test_a_guard_that_believes_every_force_goes_on_too_far(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(ForceMonitor, "take", lambda self, sample: None)
        broken = self.broken("force", "stuck", "press")
        assert "ended as" in broken or "went on" in broken

    def test_a_guard_that_does_not_look_at_ages_goes_on_too_far(self, monkeypatch):
        monkeypatch.setattr(ForceWatch, "check_age", lambda self, age_s: None)
        monkeypatch.setattr(ForceMonitor, "oldest_s", property(lambda self: 1e9))
        assert "went on" in self.broken("force", "no sample any more", "seek")

    def test_a_guard_that_does_not_stop_the_stage_is_noticed(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def deaf(rig: ObservedRig) -> None:
            monkeypatch.setattr(MotionGuard, "halt", lambda self: None)

        fault = NAMED["force", "does not answer"]
        fault = replace(fault, begin=both(fault.begin, deaf))
        broken = " ".join(faults_of(run_cell(fault, short(state_of("press")), goes_on=False), fault))
        assert "went on" in broken

    def test_a_probe_that_is_not_lifted_is_noticed(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("palpate.rig.engine.Engine._lift_if_possible", lambda self: "")
        assert "probe stays" in self.broken("force", "saturates, or any fault bit", "hold")

    def test_a_stage_twice_as_late_as_it_states_is_beyond_its_bound(self, monkeypatch):
        stop = VirtualStage.stop

        def late(self: VirtualStage) -> None:
            clock = self._world.clock
            clock.sleep(self.travel.latency_s)
            stop(self)

        monkeypatch.setattr(VirtualStage, "stop", late)
        assert "the bound" in self.broken("force", "does not answer", "press")

    def test_the_bound_is_no_wider_than_it_must_be_and_another_run_or_end_is_noticed(self) -> None:
        cell, fault = self.cell("force", "does not answer", "press")
        assert faults_of(cell, fault) == []
        v, a, late_s = 2.0, 500.0, 0.004  # mm/s, mm/s^2 and s of the virtual stage
        assert cell.bound_mm == pytest.approx(v**2 / (2 * a) + v * late_s)
        for less in (v**2 / (2 * a), v * late_s, v**2 / (4 * a) + v * late_s):
            assert "the bound" in " ".join(faults_of(replace(cell, bound_mm=less), fault))
        assert faults_of(replace(cell, went_on="frames that are not the plan's"), fault)
        assert faults_of(replace(cell, ended="storage"), fault)


class TestPage:
    def test_no_cell_is_empty(self) -> None:
        cells = from_csv(CSV.read_text(encoding="utf-8"))
        assert [key_of(cell) for cell in cells] == [key for key, _ in keys()]

    def test_every_cell_that_is_written_keeps_the_law(self) -> None:
        faults = dict(keys())
        cells = from_csv(CSV.read_text(encoding="utf-8"))
        assert not {
            key_of(cell): broken for cell in cells if (broken := faults_of(cell, faults[key_of(cell)]))
        }

    def test_the_page_says_what_was_measured(self) -> None:
        cells = from_csv(CSV.read_text(encoding="utf-8"))
        assert PAGE_FILE.read_text(encoding="utf-8") == page(cells)


def _run(key: tuple[str, str, str]) -> Cell:
    fault, (part, _, state) = dict(keys())[key], key
    if ", " in part:
        return run_grbl_cell(fault, state_of(state, GRBL_STATES), part.split(", ")[1])
    return run_cell(fault, state_of(state))


@pytest.mark.slow
@pytest.mark.parametrize("where", ["virtual", *FIRMWARES])
def test_every_cell_keeps_the_law_and_the_page_says_so(where: str) -> None:
    faults = {
        key: fault
        for key, fault in keys()
        if key[0].endswith(f", {where}") or (where == "virtual" and ", " not in key[0])
    }
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(min(2, os.cpu_count() or 1), mp_context=context) as pool:
        cells = list(pool.map(_run, faults))
    broken = {key_of(cell): wrong for cell in cells if (wrong := faults_of(cell, faults[key_of(cell)]))}
    assert not broken
    if where == "virtual":
        written = {key_of(cell): outcome(cell) for cell in from_csv(CSV.read_text(encoding="utf-8"))}
        assert {key_of(cell): outcome(cell) for cell in cells} == {key: written[key] for key in faults}
