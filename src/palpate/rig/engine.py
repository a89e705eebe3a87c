"""The engine: runs a plan on a rig; the recording is its only record of progress.

An interrupted press is repeated from the approach (lift, tare, contact, descent under guard), and only the
missing frames are recorded. A transient fault, such as one late sample, rejects the attempt: the probe is
lifted, the zero is checked, and the gentle touch and the press are repeated, up to `Rig.retries`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, closing, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import assert_never

from palpate.core import (
    NS_PER_S,
    DeviceError,
    MonotonicClock,
    PalpateError,
    PathText,
    RecordingError,
    StorageError,
)
from palpate.core.plugins import ERROR, plugin_calls
from palpate.devices import (
    ForceBias,
    Guard,
    MotionGuard,
    OperatorCommand,
    OperatorControl,
    OperatorInterrupt,
    Reason,
    SupervisedGuard,
    Tripped,
)
from palpate.devices.long_running import SleepWatch
from palpate.recordings import Manifest, Offset, Run, RunWriter
from palpate.recordings.run_reader import VOID
from palpate.rig.acquisition import LABELS, Acquisition
from palpate.rig.clock_sync import ClockSync
from palpate.rig.label_force import LABEL_FORCE
from palpate.rig.plans.recording_plan import (
    Aside,
    Burst,
    Depth,
    Done,
    Over,
    Pause,
    PlannedPress,
    RecordingPlan,
    Seek,
    Step,
    Sweep,
    TareStep,
)
from palpate.rig.preflight import check_ready, notes_of
from palpate.rig.press_motion import PressMotion, check_plan
from palpate.rig.rig import REJECTED, TRANSIENT, Rig
from palpate.rig.run_progress import (
    PLAN,
    Outcome,
    Recorder,
    State,
    Status,
    check_same_plan,
    done_in,
    note_of,
)

LIFTS, LIFT_PAUSE_S = 3, 0.5
"""Tries to lift the probe after a failure, and the time between them [s]: a stage that was late to answer, or
was still on its way, may do it at the second."""

DISBELIEVED = frozenset(
    {
        Reason.FORCE_DEAD,
        Reason.FORCE_DRIFT,
        Reason.FORCE_IMPLAUSIBLE,
        Reason.FORCE_NOISE,
        Reason.FORCE_REVERSED,
        Reason.FORCE_SCALED,
        Reason.FORCE_STUCK,
        Reason.STIFFNESS,
    }
)
"""Reasons that say a force was wrong for some time before it was found out: a press is void."""

POLL_S = 0.02  # while nothing moves
TOLD_EVERY_S = 0.1  # of the machine's time

Watch = Callable[[Status], None]


def nobody(status: Status) -> None:
    """Ignore the status."""


class Engine:
    """Recorder of one plan on one rig into one run."""

    def __init__(
        self,
        rig: Rig,
        plan: RecordingPlan,
        writer: RunWriter,
        done: Done,
        control: OperatorControl,
        watch: Watch = nobody,
    ) -> None:
        self._rig = rig
        self._plan = plan
        self._done = dict(done)
        self._alike: dict[frozenset[int], frozenset[int]] = {}  # sets of frames, one of each kept in memory
        self._control = control
        self._watch = watch
        bias = self._bias = ForceBias(rig.mounting)
        recorder = self._recorder = Recorder(writer, bias, rig.clock.now_ns())
        guard = self._guard = guard_of(rig, bias, control)
        guard.samples.subscribe(recorder.force)  # first, so that all is on disk that anybody else hears
        guard.positions.subscribe(recorder.stage)
        guard.looks.subscribe(self._tell)
        if isinstance(rig.clock, MonotonicClock):
            guard.looks.subscribe(SleepWatch().look)
        self._motion = PressMotion(rig, plan, guard, bias, recorder)
        self._acquisition = Acquisition(rig, guard, self._motion, recorder, bias, self._mark)
        self._state = State.READY
        self._message = ""
        self._told_s = 0.0
        self._planned = [len(plan.shots(press)) for press in plan.presses()]
        self._shots = sum(self._whole(press) for press in plan.presses())
        self._begun = (time.monotonic(), self._shots)
        self._indenter = self._tried = self._known = ""  # mounted, touched with, of a known stiffness
        self._wanted = ""
        self._touches = False
        self._clocks: Offset | None = None
        self._unproven: dict[str, set[int]] = {}  # frames since the last zero: by shot
        self._unproven_in: set[int] = set()  # and of these approaches
        self._zero_moved_n: float | None = None
        self._void_shots = 0
        self._retries = 0
        self._unverified_s = 0.0  # wait before the zero is verified after a rejected attempt; 0 without one
        self._swept: set[str] = set()  # shots that an event says to be whole

    def run(self) -> Outcome:
        """Record all that is missing, or as much as can be; the probe is lifted at the end."""
        self._recorder.event(PLAN, hash=self._plan.hash, plan=self._plan.model_dump(mode="json"))
        rig = self._rig
        self._recorder.event(
            "rig",
            name=rig.name,
            origin_m=rig.origin_m,
            limits=asdict(rig.limits),
            retries=asdict(rig.retries),
            stiffness={name: asdict(one) for name, one in rig.stiffness.items()},
            weighed_on=rig.weighed_on,
            **rig.scheduling,
        )
        self._recorder.sync()  # before anything moves
        self._turn(State.RUNNING, "; ".join(["begun", *notes_of(rig, self._plan.indenters)]))
        try:
            for press in self._plan.presses():
                if self._control.command is OperatorCommand.STOP:
                    return self._ended(State.STOPPED, "stopped by the operator")
                self._finish(press)
        except OperatorInterrupt as interrupt:
            if interrupt.command is OperatorCommand.ESTOP:
                return self._ended(State.ESTOPPED, "emergency stop")
            if interrupt.command is OperatorCommand.STOP:  # while the taps were analysed
                return self._ended(State.STOPPED, "stopped by the operator")
            return self._ended(State.ABORTED, "aborted by the operator")
        except Tripped as e:
            if e.reason in DISBELIEVED:
                self._void()
            return self._failed(e.reason, str(e))
        except StorageError as e:
            return self._failed(Reason.STORAGE, str(e))
        except DeviceError as e:
            return self._failed(Reason.CAMERA, str(e))
        except PalpateError as e:
            return self._failed(Reason.PLAN, str(e))
        except BaseException:
            with suppress(Exception):
                self._guard.halt()
            self._lift_if_possible()
            raise
        return self._ended(State.DONE, "all shots are recorded")

    def close(self) -> None:
        """Let go of the guard; the devices stay open."""
        with _quietly():
            self._guard.close()

    def _finish(self, press: PlannedPress) -> None:
        """A press until nothing of it is missing, however often it is paused or repeated."""
        attempt = 1
        while self._plan.missing(press, self._done):
            before = self._motion.approach
            try:
                self._control.check()
                self._verify_zero()
                self._mount(press.indenter)
                if self._tried != press.indenter:
                    self._try_sensor(press)
                if self._clocks is None and self._plan.taps:
                    self._set_clocks(press)
                self._approached(press)
            except OperatorInterrupt as interrupt:
                if interrupt.command is not OperatorCommand.PAUSE:
                    raise
                self._paused()
            except Tripped as fault:
                self._reject(press, attempt, fault, before)
                attempt += 1

    def _reject(self, press: PlannedPress, attempt: int, fault: Tripped, before: int) -> None:
        """Reject an attempt that a transient fault ended, and lift the probe so that it can be repeated."""
        if fault.reason not in TRANSIENT:
            raise fault
        retry = self._rig.retries.allow(fault.reason, attempt, self._retries)
        approaches = range(before + 1, self._motion.approach + 1)
        self._unproven_in.update(approaches)
        self._void()
        self._recorder.event(
            REJECTED,
            reason=fault.reason.value,
            numbers=fault.numbers,
            message=str(fault),
            place=press.place.name,
            cycle=press.cycle,
            indenter=press.indenter,
            attempt=attempt,
            approaches=list(approaches),
            retried=retry,
        )
        if not retry:
            raise fault
        if self._lift_if_possible():
            self._control.check((OperatorCommand.ESTOP,))
            raise fault
        self._retries += 1
        self._tried = ""  # is the force later than before?
        self._unverified_s = max(attempt * self._rig.retries.wait_s, POLL_S)
        self._message = f"{press.place.name}, cycle {press.cycle}: rejected ({fault.reason.value}), repeated"

    def _verify_zero(self) -> None:
        """After a rejected attempt: wait at the clearance, and verify that the force is zero there."""
        if not self._unverified_s:
            return
        end_ns = self._rig.clock.now_ns() + round(self._unverified_s * NS_PER_S)
        while self._rig.clock.now_ns() < end_ns:
            self._control.check()
            with suppress(Tripped):
                self._guard.look(judged=False)
            self._tell()
            self._rig.clock.sleep(POLL_S)
        if self._bias.noise_n > 0:  # a zero was measured before
            self._motion.check_zero()
        self._unverified_s = 0.0

    def _approached(self, press: PlannedPress) -> None:
        self._motion.begin(press)
        self._acquisition.begin(press)
        for step in self._plan.steps(press, self._done):
            self._control.check()
            self._message = f"{press.place.name}, cycle {press.cycle}: {type(step).__name__.lower()}"
            self._take(step)
        self._motion.lift()
        self._prove()

    def _prove(self) -> None:
        """Take a zero after a press; what was recorded is void where the zero moved, or none can be had."""
        try:
            moved_n = self._motion.check_zero()
        except Tripped:
            self._void()
            raise
        self._zero_moved_n = max(moved_n, self._zero_moved_n or 0.0)
        self._unproven.clear()
        self._unproven_in.clear()

    def _void(self) -> None:
        """Take back all frames since the last zero: they are missing again, and their labels not believed."""
        whole = [key for key, frames in self._unproven.items() if key in self._swept and frames]
        if not self._unproven_in:
            return
        before = self._shots
        self._recorder.event(
            VOID,
            approaches=sorted(self._unproven_in),
            shots=sorted(self._unproven),
            whole=whole,
        )
        for key, taken in self._unproven.items():
            self._done[key] = self._done[key] - taken
        self._shots = sum(self._whole(press) for press in self._plan.presses())
        self._void_shots += before - self._shots
        self._unproven.clear()
        self._unproven_in.clear()

    def _take(self, step: Step) -> None:
        match step:
            case Over(x, y):
                self._motion.over(x, y)
            case TareStep():
                self._take_zero()
                self._acquisition.tare()
            case Seek():
                self._motion.seek()
            case Depth(depth, speed):
                self._motion.to_depth(depth, speed)
            case Aside(x, y, speed):
                self._motion.aside(x, y, speed)
            case Pause(seconds):
                self._guard.wait(seconds)
            case Burst():
                self._acquisition.burst(step)
            case Sweep():
                self._acquisition.sweep(step)
                self._swept.add(step.shot.key)
            case _:
                assert_never(step)

    def _take_zero(self) -> None:
        """Take the zero of a press; frames of it that were recorded before a pause are judged by it."""
        if self._unproven:
            self._prove()
        self._motion.measure_bias()

    def _try_sensor(self, press: PlannedPress) -> None:
        self._message = f"{press.place.name}: a gentle touch, to try the force sensor"
        self._motion.try_sensor(press, press.indenter != self._known)
        self._tried = self._known = press.indenter

    def _set_clocks(self, press: PlannedPress) -> None:
        self._message = f"{press.place.name}: {self._plan.taps} taps, to set the clocks"
        self._motion.begin(press)
        self._motion.over(press.place.x_mm * 1e-3, press.place.y_mm * 1e-3)
        self._motion.measure_bias()
        self._clocks = ClockSync(self._rig, self._plan, self._guard, self._recorder, self._bias).tap()
        self._acquisition.late_s = self._clocks.seconds

    def _mount(self, indenter: str) -> None:
        if indenter == self._indenter:
            return
        self._indenter = indenter
        if not self._rig.mount(indenter) and len(self._plan.indenters) > 1:
            self._wanted = f"fit the indenter {indenter}, then resume"
            self._control.ask(OperatorCommand.PAUSE)
            self._control.check()

    def _paused(self) -> None:
        """Wait lifted, and watch, until resumed; raises `OperatorInterrupt` on anything stronger."""
        self._motion.lift()
        self._turn(State.PAUSED, self._wanted or "paused by the operator")
        self._wanted = ""
        while self._control.wait_while_paused(0.02):
            try:
                self._guard.look((OperatorCommand.ABORT, OperatorCommand.ESTOP), judged=False)
            except Tripped as e:  # what is not back when it goes on ends it then
                if e.reason not in TRANSIENT:
                    raise
            self._tell()
        self._control.check((OperatorCommand.ABORT, OperatorCommand.ESTOP))
        self._motion.distrust_position()  # whoever paused may have pushed the stage
        self._turn(State.RUNNING, "resumed")

    def _mark(self, key: str, frame: int, whole: bool) -> None:
        """A frame is recorded; with it, perhaps, its shot is whole."""
        frames = self._done.get(key, frozenset()) | {frame}
        self._done[key] = self._alike.setdefault(frames, frames)
        self._unproven.setdefault(key, set()).add(frame)
        self._unproven_in.add(self._motion.approach)
        self._shots += whole
        self._tell()

    def _whole(self, press: PlannedPress) -> int:
        shots = self._plan.shots(press)
        return sum(len(self._done.get(shot.key, frozenset())) >= frames for shot, frames in shots)

    def _failed(self, reason: Reason, message: str) -> Outcome:
        if reason is Reason.STORAGE:
            self._recorder.muted = True
        if reason is Reason.HARDWARE_STOP:  # whoever pressed it wants no motion, not even this one
            return self._ended(State.FAILED, f"{message}; the probe was not lifted: {reason.value}", reason)
        self._touches = reason is Reason.TOUCHED_EARLY
        if stays := self._lift_if_possible():
            message = f"{message}; the probe was not lifted: {stays}"
        return self._ended(State.FAILED, message, reason)

    def _lift_if_possible(self) -> str:
        """Lift, whatever the reason to end: only a stage whose place is lost, or that is gone, stays."""
        watch, muted = self._watch, self._recorder.muted
        try:
            for _ in range(LIFTS - 1):
                stays, again = self._lift_once()
                if not again:
                    return stays
                self._recorder.muted, self._watch = True, nobody  # neither may hold it up
                self._rig.clock.sleep(LIFT_PAUSE_S)
            return self._lift_once()[0]
        finally:
            self._recorder.muted, self._watch = muted, watch

    def _lift_once(self) -> tuple[str, bool]:
        """Why it was not lifted, empty where it was; and whether to try again is of use."""
        try:
            self._motion.lift()
            self._motion.lift_free(self._touches)
        except OperatorInterrupt:
            return "emergency stop", False
        except Tripped as e:  # after a force to press on once more would be worse
            return str(e), e.reason in (Reason.STAGE, Reason.STAGE_LATE)
        except Exception as e:  # of who records or watches
            return str(e), True
        return "", False

    def _ended(self, state: State, message: str, reason: Reason | None = None) -> Outcome:
        lifts = state in (State.STOPPED, State.ABORTED, State.DONE)
        if lifts and (stays := self._lift_if_possible()):
            message = f"{message}; the probe was not lifted: {stays}"
        with _quietly():
            self._turn(state, message)
        return Outcome(
            state,
            self._shots,
            sum(self._planned),
            reason,
            message,
            self._clocks,
            self._zero_moved_n,
            self._void_shots,
            self._retries,
        )

    def _turn(self, state: State, message: str) -> None:
        self._state, self._message = state, message
        self._told_s = 0.0
        self._tell()
        self._recorder.event("state", state=state.value, message=message, shots=self._shots)

    def _tell(self) -> None:
        now_s = time.monotonic()
        if now_s - self._told_s < TOLD_EVERY_S:
            return
        self._told_s = now_s
        planned = sum(self._planned)
        status = Status(self._state, self._message, self._shots, planned, self._left_s(now_s))
        with _quietly():
            force, at = self._guard.force_n, self._rig.from_origin_mm(self._guard.position_m())
            status = replace(status, force_n=force, position_mm=at)
        self._watch(status)

    def _left_s(self, now_s: float) -> float | None:
        begun_s, before = self._begun
        new = self._shots - before
        return (now_s - begun_s) / new * (sum(self._planned) - self._shots) if new else None


def guard_of(rig: Rig, bias: ForceBias, control: OperatorControl) -> Guard:
    """The guard of a rig's motion: that of its supervisor's process, or one in this process."""
    if rig.supervisor is not None:
        return SupervisedGuard(rig.supervisor, rig.force, bias, control)
    return MotionGuard(rig.stage, rig.force, rig.limits, bias, rig.clock, control)


def _quietly() -> AbstractContextManager[None]:
    """Suppress what fails on the way out, so that it hides nothing of why it is left."""
    return suppress(PalpateError, OperatorInterrupt)


def record(
    rig: Rig,
    plan: RecordingPlan,
    out: PathText,
    *,
    control: OperatorControl | None = None,
    watch: Watch = nobody,
) -> Outcome:
    """Record all of a plan that a run does not hold yet.

    A new run is begun where there is none. Where there is one of the same plan, the next segment begins at
    its first missing shot; what is there is never touched, repeated or skipped. A run that was killed before
    it held a frame is gone on with likewise.

    Args:
        rig: the devices; the caller closes them.
        plan: what to record.
        out: the run.
        control: through which the operator interrupts.
        watch: told how far it is, a few times a second.

    Raises:
        Tripped: the plan leaves the rig's limits, or a real rig's devices do not give what is stated; nothing
            has moved and nothing is written.
        RecordingError: the run has another plan or seed, or another writer records into it.
        StorageError: the disk refused before anything moved.
    """
    out = Path(out)
    plan = plan if rig.design is None else plan.on(rig.design)
    check_plan(rig, plan)
    if rig.seed is None:  # a real one; what a virtual one shows is shown in the run
        check_ready(rig)
    done: Done = {}
    if out.exists():
        run = Run.open(out)
        check_same_plan(run, plan, manifest_of(rig, plan))
        _check_same_seed(run, rig)
        done = done_in(run)
        writer = RunWriter.resume(out, clock=rig.clock, overflow="wait", note=note_of(plan))
    else:
        manifest = manifest_of(rig, plan)
        writer = RunWriter.create(out, manifest, clock=rig.clock, overflow="wait", note=note_of(plan))
    with writer, plugin_calls(f"a device ended the recording ({ERROR})", Exception):
        engine = Engine(rig, plan, writer, done, control or OperatorControl(), watch)
        with closing(engine):
            return engine.run()


def _check_same_seed(run: Run, rig: Rig) -> None:
    """Refuse to go on with another seed than the one that the run's manifest keeps for all of it."""
    begun = run.manifest.seed
    if None not in (begun, rig.seed) and begun != rig.seed:
        raise RecordingError(
            f"{run.path} was begun with seed {begun}, and this rig has seed {rig.seed}; give seed {begun}, "
            "or name a new run",
            code="seed-differs",
        )


def manifest_of(rig: Rig, plan: RecordingPlan) -> Manifest:
    """Manifest of a run of this rig and plan."""
    truths = dict.fromkeys((*rig.truths, *((LABEL_FORCE,) if rig.label_force else ())), "number")
    return Manifest.new(
        sensor=rig.sensor,
        rig=f"{rig.name}, plan {plan.name}",
        licence=rig.licence,
        origin=rig.origin,
        provenance=rig.provenance,
        labels={**LABELS, **truths},  # type: ignore[dict-item]
        targets=plan_targets(plan),
        regions=dict(rig.regions),
        seed=rig.seed,
    )


def plan_targets(plan: RecordingPlan) -> tuple[str, ...]:
    """The labels that differ between a plan's presses, and so can be learnt from them."""
    if plan.deepest_mm == 0:
        return ()
    targets = ["depth_mm", "force_N"]
    if len(plan.places.places()) > 1:
        targets += ["x_mm", "y_mm"]
    if getattr(plan, "lateral", None):
        targets += ["force_x_N", "force_y_N"]
    return tuple(targets)
