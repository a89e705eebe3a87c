"""One cell of the matrix: a recording into which one fault comes in one state, and its resumption."""

import json
import os
import shutil
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.rig.fault_matrix.engine_states import EngineState, asks_pause
from tests.rig.fault_matrix.fault_injection import (
    AGE,
    AT_ONCE,
    NEXT,
    OPEN,
    PATCHES,
    SEARCH,
    STEP,
    TRUST,
    RigFault,
)
from tests.rig.fault_matrix.grbl_rig import GrblRig
from tests.rig.fault_matrix.observed_rig import BEGUN_NS, ObservedRig
from tests.rig.rigs import SPEC

from palpate.core import ManualClock, StorageError
from palpate.recordings import Run
from palpate.rig import State, record
from palpate.rig.plans import StepHold
from palpate.rig.virtual import Variation, virtual_rig
from palpate.sensors.palm.palm_sensor import Palm

TRUST_M = 0.2e-3
COARSE_MM = 1e-3  # to which ways are compared
MIN_AIR_MM = 0.1  # above the skin's own surface, whose place varies by some hundredths


@dataclass(frozen=True)
class Cell:
    """What one fault did in one state.

    Attributes:
        ended: reason of a failure; else the state of the engine at the end, or the exception.
        seen: what the engine did when it ended.
        stop_mm, bound_mm: way from asking for a stop until the stage truly stood, and v^2/2a + v latency, of
            the stop that comes nearest to its bound; None where none was asked for in motion.
        obeyed: whether the stage said that it stands.
        into_mm, allowed_mm: way towards the skin or along it once the fault shows, and what is allowed; None
            where it is recorded whole, or is no matter of motion.
        height_mm: of the probe over the skin at the end.
        went_on: how the same command, given again, ended; empty where it then held exactly the plan's frames.
    """

    part: str
    fault: str
    state: str
    ended: str
    seen: str
    message: str
    stop_mm: float | None
    bound_mm: float | None
    obeyed: bool
    into_mm: float | None
    allowed_mm: float | None
    height_mm: float
    went_on: str


def run_cell(fault: RigFault, state: EngineState, seed: int = 3, *, goes_on: bool = True) -> Cell:
    """Run one cell, in a folder of its own that is thrown away."""
    folder = Path(tempfile.mkdtemp(prefix="fault-matrix-"))
    try:
        run = _killed if fault.names == ("killed",) else _ended
        measured = run(fault, state, folder / "run", seed)
        went_on = gone_on(state.plan, folder / "run", seed) if goes_on else ""
    finally:
        shutil.rmtree(folder)
    return Cell(fault.part, fault.name, state.name, **measured, went_on=went_on)


def gone_on(plan: StepHold, out: Path, seed: int) -> str:
    """How the same command ends on a sound rig; empty where the run then holds its plan's frames exactly."""
    rig = virtual_rig(Palm(SPEC), clock=ManualClock(5 * BEGUN_NS), seed=seed, variation=Variation())
    outcome = record(rig, plan, out)
    if outcome.state is not State.DONE:
        return f"{outcome.state}: {outcome.message}"
    labels = Run.open(out).labels.dropna(subset=["shot"])
    held = Counter(zip(labels["shot"], labels["frame_in_shot"].astype(int), strict=True))
    due = Counter((s.key, k) for press in plan.presses() for s, n in plan.shots(press) for k in range(n))
    wrong = [key for key in held | due if held[key] != due[key]]
    return f"frames that are not the plan's: {wrong}" if wrong else ""


def run_grbl_cell(fault: RigFault, state: EngineState, firmware: str, seed: int = 3) -> Cell:
    """Run one cell with a GRBL stage on the fake of a firmware."""
    folder = Path(tempfile.mkdtemp(prefix="fault-matrix-"))
    try:
        with GrblRig(state.plan, seed, firmware) as rig:
            measured = _recorded(_set(rig, fault, state), fault, state, folder / "run")
        went_on = gone_on(state.plan, folder / "run", seed)
    finally:
        shutil.rmtree(folder)
    return Cell(f"{fault.part}, {firmware}", fault.name, state.name, **measured, went_on=went_on)


def _set(rig: ObservedRig, fault: RigFault, state: EngineState) -> ObservedRig:
    rig.due, rig.begin = state.due, lambda: fault.begin(rig)
    if state.pauses:
        asks = asks_pause()
        rig.heard = lambda one, call: (asks(one, call), None)[1]
    return rig


def _ended(fault: RigFault, state: EngineState, out: Path, seed: int) -> dict[str, Any]:
    return _recorded(_set(ObservedRig(state.plan, seed), fault, state), fault, state, out)


def _recorded(rig: ObservedRig, fault: RigFault, state: EngineState, out: Path) -> dict[str, Any]:
    try:
        if state.before:
            rig.ask_begin()
        outcome = record(rig.rig, rig.plan, out, control=rig.control, watch=rig.watch)
        ended, message = str(outcome.reason or outcome.state), outcome.message
    except BaseException as e:
        ended = "storage" if isinstance(e, StorageError) else type(e).__name__
        message = str(e)
    finally:
        PATCHES.close()
    if rig.began_ns is None:
        raise AssertionError(f"the engine never came to {state.name}")
    return measured(rig, fault, state.name, ended, message)


def _killed(fault: RigFault, state: EngineState, out: Path, seed: int) -> dict[str, Any]:
    reads, writes = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reads)
            rig = _set(ObservedRig(state.plan, seed), fault, state)

            def last_words() -> None:
                os.write(writes, json.dumps(measured(rig, fault, state.name, "killed", "")).encode())

            rig.last_words = last_words
            if state.before:
                rig.ask_begin()
            record(rig.rig, rig.plan, out, control=rig.control, watch=rig.watch)
        finally:
            os._exit(1)
    os.close(writes)
    with os.fdopen(reads) as words:
        told = words.read()
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        raise AssertionError(f"the engine never came to {state.name}, or ended by itself: {status}")
    return dict(json.loads(told))


def measured(rig: ObservedRig, fault: RigFault, state: str, ended: str, message: str) -> dict[str, Any]:
    """What is measured of a recording that has ended."""
    where = rig.status.state if rig.status and rig.status.state is State.PAUSED else rig.doing()
    rig.settle()
    travel, latency_s = rig.rig.stage.travel, rig.latency_s
    stops = [one for at_ns, one in rig.stops if at_ns >= rig.began_ns and one.speed_m_s > 0]
    nearest = max(
        stops, key=lambda one: one.way_m / one.bound_m(travel.acceleration_m_s2, latency_s), default=None
    )
    shown_s = rig.shown_s(fault.shows)
    in_air = fault.part in ("force", "operator") and not fault.shows
    into_m = 0.0 if shown_s is None else rig.into_m(shown_s, in_air=in_air)
    allowed_m = allowed_into_m(rig, fault.within_in(state), in_air)
    if ended == "done":
        into_m = max(rig.unwatched_m, default=0.0)
        allowed_m = allowed_m if rig.unwatched_m else None  # it goes on as planned
    return {
        "ended": ended, "seen": str(where), "message": message, "stop_mm": nearest and 1e3 * nearest.way_m,
        "bound_mm": nearest and 1e3 * nearest.bound_m(travel.acceleration_m_s2, latency_s),
        "obeyed": all(one.obeyed for one in stops), "into_mm": None if allowed_m is None else 1e3 * into_m,
        "allowed_mm": allowed_m and 1e3 * allowed_m,
        "height_mm": 1e3 * (rig.truth._origin[2] - rig.place_m[2]),
    }  # fmt: skip


def allowed_into_m(rig: ObservedRig, within: str, in_air: bool) -> float | None:
    """Way towards the skin or along it that is allowed once the fault shows [m]; None where none is stated.

    Where what happens in the air counts, that is the way down to the clearance, which is faster.
    """
    limits, travel, plan = rig.rig.limits, rig.rig.stage.travel, rig.plan
    assert rig.began_ns is not None
    speed = plan.press_mm_s * 1e-3
    if in_air and rig.places == [] and not rig.taps:  # over the first place
        speed = plan.travel_mm_s * 1e-3
    stop_m = travel.overshoot_m(speed)
    deepest_mm = plan.clearance_mm + plan.seek_mm + (min(plan.deepest_mm, 1.0) if plan.taps else 0.0)
    return {
        AT_ONCE: speed * limits.force_latency_s + stop_m, AGE: speed * limits.age_s + stop_m, TRUST: TRUST_M,
        STEP: limits.step_m, NEXT: 2 * limits.step_m, SEARCH: deepest_mm * 1e-3, OPEN: None,
    }[within]  # fmt: skip


def faults_of(cell: Cell, fault: RigFault) -> list[str]:
    """What a cell breaks of the matrix's law; none where it keeps it."""
    broken = []
    if cell.ended not in (names := fault.names_in(cell.state)):
        broken.append(f"ended as {cell.ended}, not {' or '.join(names)}: {cell.message}")
    if cell.obeyed and exceeds(cell.stop_mm, cell.bound_mm):
        broken.append(f"stopped after {cell.stop_mm:.4f} mm; the bound is {cell.bound_mm:.4f} mm")
    if exceeds(cell.into_mm, cell.allowed_mm):
        broken.append(f"went on by {cell.into_mm:.4f} mm; {cell.allowed_mm:.4f} mm are allowed")
    if cell.height_mm <= MIN_AIR_MM and not fault.stays:
        broken.append(
            f"the probe stays at {-cell.height_mm:.3f} mm though it could be lifted: {cell.message}"
        )
    silent = cell.ended not in ("e-stopped", "killed") and "not lifted" not in cell.message
    if cell.height_mm <= MIN_AIR_MM and fault.stays and silent:
        broken.append(f"the probe stays, and the message does not say so: {cell.message}")
    if cell.went_on:
        broken.append(f"the same command ended with {cell.went_on}")
    return broken


def exceeds(way_mm: float | None, allowed_mm: float | None) -> bool:
    """Whether a way is longer than allowed, where there is one and something is stated [mm]."""
    return way_mm is not None and allowed_mm is not None and way_mm > allowed_mm + COARSE_MM
