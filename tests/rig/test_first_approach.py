"""The first approach of a session is a guarded search whatever the stage reports; measured as true depth."""

import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.fakes.grbl_parameters import GrblParameters
from tests.refusals import refused
from tests.rig.lab_files import LabFile, lab_file
from tests.rig.rigs import IDEAL, plan, rig

from palpate.core import DeviceError, ForceSensor, Position, PositionUnknownError, Stage, Wrench
from palpate.devices import OperatorCommand, OperatorControl, Reason, Tripped
from palpate.rig import State, open_rig, record
from palpate.rig.plans import Listed
from palpate.rig.press_motion import PressMotion
from palpate.rig.run_progress import Status

MM = 1e-3
STEP_MM = 0.2  # longest move towards the skin (`Limits.step_m`)
RUN_ON_MM = 0.1  # largest way after a stop (`Limits.overshoot_m`)
THRESHOLD_MM = 0.12  # below first touch, where the virtual palm carries the threshold of 0.05 N
RULE_MM = STEP_MM + RUN_ON_MM + THRESHOLD_MM
"""Depth that a guarded search may reach, however late the computer is."""


class MistakenStage:
    """A stage that is `error_m` elsewhere than it reports; `deepest_m` is the largest true z."""

    def __init__(self, stage: Stage, error_m: Position) -> None:
        self._stage, self.error_m, self.deepest_m = stage, error_m, -math.inf

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stage, name)

    def _true(self) -> Position:
        at = self._stage.position_m()
        self.deepest_m = max(self.deepest_m, at[2])
        return at

    def position_m(self) -> Position:
        x, y, z = (a - e for a, e in zip(self._true(), self.error_m, strict=True))
        return x, y, z

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        x, y, z = (a + e for a, e in zip(position_m, self.error_m, strict=True))
        self._stage.move_to((x, y, z), speed_m_s)

    def moving(self) -> bool:
        self._true()
        return self._stage.moving()


def mistaken(error_mm: float, sideways_mm: float = 0.0):
    """A virtual rig whose stage is nearer to the skin than it reports, and the stage."""
    made = rig(variation=IDEAL)
    stage = MistakenStage(made.stage, (sideways_mm * MM, 0.0, error_mm * MM))
    return replace(made, stage=stage), stage


@pytest.mark.parametrize(("error_mm", "sideways_mm"), [(0.6, 0.0), (3.0, 0.0), (6.0, -3.0)])
@pytest.mark.cases(2)
def test_a_stage_nearer_to_the_skin_than_it_reports_touches_it_at_search_speed(
    tmp_path, error_mm, sideways_mm
):
    made, stage = mistaken(error_mm, sideways_mm)
    outcome = record(made, plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.TOUCHED_EARLY), outcome.message
    assert 0.0 < stage.deepest_m / MM <= RULE_MM
    assert stage.position_m()[2] + stage.error_m[2] < 0.0, "lifted at the end"


def one_place(**fields: Any):
    """One press of the small plan, at the usual speeds."""
    centre = Listed(kind="listed", at_mm=((0.0, 0.0),))
    return plan(**{"places": centre, "cycles": 1, "frames": 1} | fields)


LATE_M = 0.15 * MM


class FailsAtContact:
    """A force sensor that is late and fails once, as the probe meets the skin."""

    def __init__(self, force: ForceSensor, stage: MistakenStage) -> None:
        self._force, self._stage, self._failed = force, stage, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._force, name)

    def drain(self) -> list[Wrench]:
        samples = self._force.drain()
        if self._failed or self._stage.deepest_m <= 0:
            return samples
        if self._stage.deepest_m > LATE_M:
            self._failed = True
            raise DeviceError("a gap")
        return []


def test_a_retry_after_contact_in_the_first_approach_accepts_no_wrong_position(tmp_path: Path) -> None:
    made, stage = mistaken(4.0)
    force = FailsAtContact(made.force, stage)
    outcome = record(replace(made, force=force), plan(threshold_N=0.04), tmp_path / "run")
    assert force._failed
    assert outcome.reason is Reason.TOUCHED_EARLY, outcome.message
    assert stage.deepest_m / MM <= RULE_MM


class TurnedStage(MistakenStage):
    """A stage whose z goes the other way than it reports, from where it was opened."""

    def position_m(self) -> Position:
        x, y, z = self._true()
        return x, y, -2.0 * MM - z

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        x, y, z = position_m
        self.fastest_m_s = max(getattr(self, "fastest_m_s", 0.0), speed_m_s)
        self._stage.move_to((x, y, -2.0 * MM - z), speed_m_s)


class LoadedForce:
    """A force sensor that was not tared, with a tool's weight."""

    def __init__(self, force: ForceSensor, weight_n: Position) -> None:
        self._force, self._weight_n = force, weight_n

    def __getattr__(self, name: str) -> Any:
        return getattr(self._force, name)

    def _loaded(self, one: Wrench) -> Wrench:
        x, y, z = (a + b for a, b in zip(one.force_n, self._weight_n, strict=True))
        return replace(one, force_n=(x, y, z))

    def drain(self) -> list[Wrench]:
        return [self._loaded(one) for one in self._force.drain()]

    def latest(self) -> Wrench:
        return self._loaded(self._force.latest())


@pytest.mark.parametrize("weight_n", [(0.0, 0.0, 0.0), (0.0, 0.0, -5.0), (0.0, 0.0, 5.0), (20.0, 0.0, 0.0)])
def test_a_first_lift_that_leads_into_the_skin_ends_at_search_speed_and_is_not_repeated_deeper(
    tmp_path: Path, weight_n: Position
) -> None:
    made = rig(variation=IDEAL)
    stage = TurnedStage(made.stage, (0.0, 0.0, 0.0))
    chosen = plan(clearance_mm=4.0)
    force = LoadedForce(made.force, weight_n)
    outcome = record(replace(made, stage=stage, force=force), chosen, tmp_path / "run")
    assert outcome.state is State.FAILED
    assert stage.fastest_m_s == pytest.approx(chosen.seek_mm_s * MM)
    assert stage.deepest_m / MM <= 1.0, "of the 4 mm to the clearance"


class SlopedStage(MistakenStage):
    """A stage over a skin that rises along x; `deepest_m` is below that skin, beside the center."""

    slope = 1.0

    def _true(self) -> Position:
        at = self._stage.position_m()
        self.error_m = (0.0, 0.0, self.slope * at[0])
        if at[0] > 0.2 * MM:
            self.deepest_m = max(self.deepest_m, at[2])
        return at

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        x, y, z = position_m
        self._stage.move_to((x, y, z + self.slope * x), speed_m_s)


def test_a_skin_that_is_higher_at_another_place_is_met_at_a_guarded_speed(tmp_path: Path) -> None:
    made = rig(variation=IDEAL)
    stage = SlopedStage(made.stage, (0.0, 0.0, 0.0))
    outcome = record(replace(made, stage=stage), plan(cycles=1, frames=1), tmp_path / "run")
    assert outcome.reason is Reason.TOUCHED_EARLY, outcome.message
    assert outcome.shots > 0, "the first place was pressed"
    assert 0.0 < stage.deepest_m / MM <= RULE_MM


@pytest.mark.parametrize("room_mm", [0.0, 0.3])
def test_a_clearance_without_room_to_prove_the_air_is_refused(tmp_path: Path, room_mm: float) -> None:
    made = rig(variation=IDEAL)
    x, y, _ = made.limits.least_m
    limits = replace(made.limits, least_m=(x, y, -(plan().clearance_mm + room_mm) * MM))
    with refused("soft-limit", Tripped):
        record(replace(made, limits=limits), plan(), tmp_path / "run")


@pytest.mark.parametrize("error_mm", [0.0, 3.0])
def test_at_the_upper_soft_limit_the_air_is_proven_on_the_way_down(tmp_path: Path, error_mm: float) -> None:
    made, stage = mistaken(error_mm)
    x, y, _ = made.limits.least_m
    limits = replace(made.limits, least_m=(x, y, stage.position_m()[2]))
    outcome = record(replace(made, stage=stage, limits=limits), one_place(), tmp_path / "run")
    assert outcome.reason is (Reason.TOUCHED_EARLY if error_mm else None), outcome.message
    assert stage.deepest_m / MM <= (RULE_MM if error_mm else 1.5)


def test_without_the_guarded_search_the_probe_is_driven_into_the_skin(tmp_path: Path, monkeypatch) -> None:
    """Control: the same measure, of motion as it was."""
    monkeypatch.setattr(PressMotion, "_search", lambda self, to, step, speed: self._guard.away(to, 20 * MM))
    made, stage = mistaken(3.0)
    record(made, plan(), tmp_path / "run")
    assert stage.deepest_m / MM > 2 * RULE_MM


def test_a_session_that_begins_in_the_skin_does_not_go_deeper_or_aside(tmp_path: Path) -> None:
    made, stage = mistaken(0.0)
    start = stage.position_m()
    stage.error_m = (0.0, 0.0, 1.0 * MM - start[2])
    made.stage._stage.move_to((start[0], start[1], 1.0 * MM), 1 * MM)
    while stage.moving():
        made.clock.sleep(0.01)
    outcome = record(made, plan(), tmp_path / "run")
    assert outcome.reason is Reason.TOUCHED_EARLY, outcome.message
    assert stage.deepest_m / MM == pytest.approx(1.0, abs=0.01)
    assert stage._stage.position_m()[:2] == pytest.approx(start[:2], abs=1e-6)


class PausedOnce(OperatorControl):
    """Pauses once shots are recorded; the carriage is pushed meanwhile."""

    def __init__(self, stage: MistakenStage, push_m: Position) -> None:
        super().__init__()
        self._stage, self._push, self._asked = stage, push_m, False

    def see(self, status: Status) -> None:
        if status.shots >= 3 and not self._asked:
            self._asked = True
            self.ask(OperatorCommand.PAUSE)

    def wait_while_paused(self, seconds: float) -> bool:
        if self.command is OperatorCommand.PAUSE:
            self._stage.deepest_m = -math.inf
            self._stage.error_m = self._push
            self.resume()
        return False


def test_a_carriage_pushed_during_a_pause_is_met_at_search_speed(tmp_path: Path) -> None:
    made, stage = mistaken(0.0)
    control = PausedOnce(stage, (0.0, 0.0, 3.0 * MM))
    stage_free = stage.position_m()[2]
    outcome = record(made, one_place(clearance_mm=4.0), tmp_path / "run", control=control, watch=control.see)
    assert control._asked
    assert stage_free < 0
    assert outcome.state in (State.FAILED, State.DONE)
    assert stage.deepest_m / MM <= max(RULE_MM, 1.2 + 3 * RUN_ON_MM), "no deeper than a press of the plan"


# The fake GRBL stage with its motors, a spring under the probe, real time.

RELEASED, HELD = {1: 25}, {1: 255}


@pytest.fixture(params=[RELEASED, HELD], ids=["released", "held"])
def lab(request, tmp_path: Path):
    settings = {120: 500, 121: 500, 122: 500, 20: 0, 22: 0, **request.param}
    model = GrblParameters(homed=True, start_mm=(-50.0, -50.0, -20.0), settings=settings)
    with lab_file(tmp_path, model=model) as lab:
        lab.fields["stage"] |= {
            "require_homed": False,
            "reference": [-50, 50, 20],
            "least_mm": [-95, 5, 5],
            "greatest_mm": [-5, 95, 36],
        }
        yield lab


def test_a_reopened_rig_knows_where_it_was_left_or_refuses(lab: LabFile) -> None:
    with closing(open_rig(lab.write(), supervised=False, position="reference")) as opened:
        opened.stage.move_to((-50 * MM, 50 * MM, 26 * MM), 20 * MM)
        while opened.stage.moving():
            opened.clock.sleep(0.01)
    before = len(lab.stage.received)
    if lab.stage.settings[1] == 255:
        with closing(open_rig(lab.write(), supervised=False)) as opened:
            assert opened.stage.position_m()[2] / MM == pytest.approx(26.0, abs=0.02)
    else:
        with refused("motors-released", PositionUnknownError):
            open_rig(lab.write(), supervised=False)
    assert b"$J" not in bytes(lab.stage.received[before:]), "opening moves nothing"


@pytest.mark.parametrize(
    ("position", "turned"), [("stored", False), ("reference", True), ("touch-off", False), ("nowhere", True)]
)
@pytest.mark.cases(2)
def test_a_controller_of_another_scale_or_direction_than_the_rig_file_states_is_refused(
    lab, position, turned
):
    steps = [lab.stage.settings[number] for number in (100, 101, 102)]
    path = lab.write(stage={"steps_per_mm": steps})
    with closing(open_rig(path, supervised=False, position="reference")) as opened:
        assert opened.stage.steps_per_mm == pytest.approx(steps)
    path = lab.write(stage={"steps_per_mm": steps, "direction_mask": 0})
    number = 3 if turned else 102
    lab.stage.settings[number] = 4 if turned else 2 * steps[2]
    with pytest.raises(DeviceError, match="direction_mask" if turned else "steps_per_mm"):
        open_rig(path, supervised=False, position=position)
    assert not lab.jogged
