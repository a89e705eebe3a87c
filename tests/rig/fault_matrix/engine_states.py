"""States of the engine in which a fault sets in: the plan that comes through each, and when it is there."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from tests.rig.fault_matrix.observed_rig import LEVEL_M, ObservedRig

from palpate.devices import OperatorCommand
from palpate.rig.plans import Listed, StepHold
from palpate.rig.plans.plan_files import Dwell, Lateral
from palpate.rig.plans.recording_plan import Aside, Burst, Depth, Over, Seek
from palpate.rig.run_progress import State

CLEARANCE_MM = 0.4
MIDDLE = 0.3  # share of a move, from which a fault sets in
Due = Callable[[ObservedRig, str], bool]


def plan_with(**changes: Any) -> StepHold:
    """Two places a little apart, one press each to 1.2 mm in two steps: six shots, 30 frames."""
    fields: dict[str, Any] = {
        "name": "matrix",
        "places": Listed(kind="listed", at_mm=((0.0, 0.0), (2.0, -1.0))),
        "cycles": 1,
        "depth_mm": 1.2,
        "step_mm": 0.6,
        "frames": 7,  # so that a camera that repeats itself is found within a shot
        "reference_frames": 1,
        "clearance_mm": CLEARANCE_MM,
        "taps": 0,
    }
    return StepHold(**{**fields, **changes})


@dataclass(frozen=True)
class EngineState:
    """State of the engine, by the plan that comes through it.

    `due` tells whether the engine is there: in the second of its presses where there are two, so that the
    force's stiffness is known. Where it `pauses`, the operator does in the second press. `before` is a fault
    that sets in before the recording is begun, on devices that are open.
    """

    name: str
    plan: StepHold
    due: Due
    pauses: bool = False
    before: bool = False


def _last(rig: ObservedRig, step: type) -> bool:
    return len(rig.places) >= min(2, len(rig.plan.places.places())) and isinstance(rig.step, step)


def _moves(rig: ObservedRig, call: str, step: type) -> bool:
    return call == "stage.moving" and _last(rig, step)


def _travels(rig: ObservedRig, call: str) -> bool:
    if not _moves(rig, call, Over):
        return False
    start_m, target_m = rig.ends_m
    return start_m[:2] != target_m[:2] and MIDDLE < rig.share < 1


def _seeks(rig: ObservedRig, call: str) -> bool:
    return _moves(rig, call, Seek) and rig.leads_down_m > LEVEL_M and rig.place_m[2] > -0.1e-3


def _presses(rig: ObservedRig, call: str) -> bool:
    leads = _moves(rig, call, Depth) and rig.leads_down_m > LEVEL_M and MIDDLE < rig.share < 1
    return leads and rig.place_m[2] > 0.75e-3


def _holds(rig: ObservedRig, call: str) -> bool:
    step = rig.step
    return call == "force.drain" and _last(rig, Burst) and step.shot.phase == "hold"


def _slides(rig: ObservedRig, call: str) -> bool:
    return _moves(rig, call, Aside) and MIDDLE < rig.share < 1


def _retreats(rig: ObservedRig, call: str) -> bool:
    leads = _moves(rig, call, Depth) and rig.leads_down_m < -LEVEL_M and MIDDLE < rig.share < 1
    return leads and rig.place_m[2] > 0.5e-3


def _taps(rig: ObservedRig, call: str) -> bool:
    tapping = call == "stage.moving" and rig.taps and rig.step is None
    return tapping and rig.leads_down_m > LEVEL_M and rig.place_m[2] > 0.1e-3


def _pauses(rig: ObservedRig, call: str) -> bool:
    return call == "status" and rig.status is not None and rig.status.state is State.PAUSED


def _resumes(rig: ObservedRig, call: str) -> bool:
    return call == "status" and rig.status is not None and rig.status.message == "resumed"


STATES = (
    EngineState("idle", plan_with(), lambda rig, call: False, before=True),
    EngineState("travel", plan_with(), _travels),
    EngineState("seek", plan_with(), _seeks),
    EngineState("press", plan_with(), _presses),
    EngineState("hold", plan_with(dwell=Dwell(depths_mm=(0.6,), seconds=0.8, frames=8)), _holds),
    EngineState("slide", plan_with(lateral=Lateral(depths_mm=(0.6,), to_mm=((0.3, 0.0),), steps=1)), _slides),
    EngineState("retreat", plan_with(unloading=True), _retreats),
    EngineState("taps", plan_with(taps=4, places=Listed(kind="listed", at_mm=((0.0, 0.0),))), _taps),
    EngineState("pause", plan_with(), _pauses, pauses=True),
    EngineState("resume", plan_with(), _resumes, pauses=True),
)
"""All states, in the order of the table's columns."""


def short(state: EngineState, frames: int = 1) -> EngineState:
    """The same with one press, but to travel, and few frames: the skin's stiffness is known from a touch."""
    changes: dict[str, Any] = {"frames": frames}
    if state.name != "travel":
        changes["places"] = Listed(kind="listed", at_mm=((0.0, 0.0),))
    if state.plan.dwell:
        changes["dwell"] = Dwell(depths_mm=(0.6,), seconds=0.4, frames=4)
    return replace(state, plan=state.plan.model_copy(update=changes))


GRBL_STATES = tuple(short(state) for state in STATES)
"""The same states for the stage's own faults, for which it matters little how stiff the skin is."""


def asks_pause() -> Due:
    """The operator, who pauses once in the middle of the second press."""
    asked = False

    def hear(rig: ObservedRig, call: str) -> bool:
        nonlocal asked
        if not asked and _presses(rig, call):
            asked = True
            rig.control.ask(OperatorCommand.PAUSE)
        return False

    return hear
