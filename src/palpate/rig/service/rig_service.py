"""Service that holds a rig: it records when asked to, and stops when told to.

The recording runs in a thread of its own and asks nobody who watches: they may come and go. While nothing is
recorded, the devices are read a few times a second.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import (
    DEFAULT_SENSOR,
    DeviceError,
    InputError,
    PalpateError,
    Position,
    SafetyError,
    Sensor,
    plain_name,
)
from palpate.core.failure_log import Failure, report_to_stderr
from palpate.devices import OperatorCommand, OperatorControl, Tripped, device_status
from palpate.devices.device_proxies import CameraProxy, ForceProxy, StageProxy
from palpate.devices.device_status import Kind, Log
from palpate.devices.force_bias import Force
from palpate.devices.rpc_server import Request, RpcServer, request_field
from palpate.rig.engine import record
from palpate.rig.plans import PLANS, Known, StepHold, plan_from, plan_of, plan_of_sensor, size_of
from palpate.rig.press_motion import check_plan
from palpate.rig.run_progress import Outcome, State, Status
from palpate.rig.service.rig_client import ServedRig

LOOK_S = 0.1  # between two looks
PICTURE_EVERY = 3  # looks
GRAB_S = 1.0
NO_BIAS: Force = (0.0, 0.0, 0.0)


class RigMonitor:
    """Monitor of a rig's devices: whose they are at any time, and their last readings.

    Args:
        opened: the rig; closed by `close`.
        paused: whether whoever has the devices wants no frames just now.

    Attributes:
        turn: a lock, held by whoever has the devices for itself alone.
    """

    def __init__(self, opened: ServedRig, paused: Callable[[], bool]) -> None:
        rig = opened.rig
        self.stage = StageProxy(rig.stage, rig.clock)
        self.force = ForceProxy(rig.force, rig.clock)
        self.camera = CameraProxy(rig.camera, rig.clock)
        self.rig = replace(rig, stage=self.stage, force=self.force, camera=self.camera)
        self._opened = opened
        self._paused = paused
        self.turn = threading.Lock()
        self._closing = threading.Event()
        self._at: tuple[Position, float] | None = None  # and when that was [s of real time]
        self._bias: Force | None = None
        self._watcher = threading.Thread(target=self._rest, name="palpate-rig-rest", daemon=True)
        self._watcher.start()

    def close(self) -> None:
        """Close the devices."""
        self._closing.set()
        self._watcher.join(2 * GRAB_S)
        self.rig.close()

    def update(self, status: Status) -> None:
        """Take in what the engine says of force and position."""
        if status.position_mm is not None:
            self._at = status.position_mm, time.monotonic()
        if status.force_n is not None and self.force.newest is not None:
            # The engine has just asked for this sample and taken its bias off: so that is the bias.
            turned = self.rig.mounting.to_skin(self.force.newest.force_n)
            x, y, z = (raw - own for raw, own in zip(turned, status.force_n, strict=True))
            self._bias = (x, y, z)

    def status(self, recording: bool) -> dict[str, Any]:
        """Status of the devices; plain values."""
        now_ns, bias = self.rig.clock.now_ns(), self._bias or NO_BIAS
        at_mm = None if self._at is None else self._at[0]
        return {
            "force_n": self._force_now(bias),
            "tared": self._bias is not None,
            "position_mm": None if at_mm is None else [round(d, 4) for d in at_mm],
            "limits": {"force_n": self.rig.limits.force_n},
            "series": device_status.force_series(self.force, self.rig.mounting, bias, now_ns),
            "devices": [
                device_status.stage_health(self.stage, at_mm),
                device_status.force_health(self.force, now_ns),
                device_status.camera_health(self.camera, now_ns, recording),
            ],
            "regions": [{"name": name, "box_px": list(box)} for name, box in self._opened.rig.regions],
            "now_ns": now_ns,
        }

    def ages_s(self) -> dict[str, float | None]:
        """Real time since force, position and picture were of now [s]; None of what there is none of."""
        at_s = None if self._at is None else time.monotonic() - self._at[1]
        return {"force": self.force.age_s(), "position": at_s, "camera": self.camera.age_s()}

    def picture(self, after: int) -> dict[str, Any] | None:
        """The newest frame, numbered; None where there is none newer than `after`."""
        count, newest = self.camera.count, self.camera.newest
        if newest is None or count <= after:
            return None
        time_ns, frame = newest
        return {"number": count, "time_ns": time_ns, **device_status.jpeg_of(frame.image)}

    def _force_now(self, bias: Force) -> list[float] | None:
        recent = self.force.recent()
        if not recent or recent[-1].fault:
            return None
        turned = np.subtract(self.rig.mounting.to_skin(recent[-1].force_n), bias)
        return [round(float(f), 4) for f in turned] if np.isfinite(turned).all() else None

    def _rest(self) -> None:
        looks = 0
        while not self._closing.is_set():
            if self.turn.acquire(blocking=False):
                try:
                    self._look(looks)
                finally:
                    self.turn.release()
            elif self._opened.real_time and self._paused():
                self._grab()  # the camera's tap lets one in at a time
            looks += 1
            self._closing.wait(LOOK_S)

    def _look(self, looks: int) -> None:
        if not self._opened.real_time:
            self.rig.clock.sleep(LOOK_S)
        with suppress(PalpateError):  # the device's proxy reports it, and it is read again
            self.force.drain()
        with suppress(PalpateError):
            self._at = self.rig.from_origin_mm(self.stage.position_m()), time.monotonic()
        if looks % PICTURE_EVERY == 0:
            self._grab()

    def _grab(self) -> None:
        with suppress(PalpateError):
            self.camera.grab(GRAB_S)


BEGIN_S = 15.0  # in which a recording has begun, or has been refused
END_S = 30.0  # in which one that was told to end has lifted the probe and closed its run
TAIL = 60  # lines of the log that are told

AnyPlan = Known
_UNTOLD = Status(State.READY, "", 0, 0, None)


class RigService:
    """Service of one rig to whoever asks, from any thread.

    Args:
        opened: the rig; closed by `close`.
        runs: the folder that recordings go into.
    """

    def __init__(self, opened: ServedRig, runs: Path) -> None:
        self._runs = runs
        self._real_time = opened.real_time
        self._log = Log()
        self._asking = threading.RLock()  # plan, start, release: one after the other
        self._control = OperatorControl()
        self._thread: threading.Thread | None = None
        self._begun = threading.Event()
        self._refused: Exception | None = None
        self._status = _UNTOLD
        self._run = self._place = ""
        self._estop: dict[str, int] | None = None
        self._told_s = time.monotonic()  # when the engine last told how far it is
        self._devices = RigMonitor(opened, lambda: self._status.state is State.PAUSED)
        self._rig = self._devices.rig
        self._set(first_plan(self._rig.design))
        self._log.add("rig", f"{self._rig.name} opened")

    def report(self, failure: Failure) -> None:
        """Show a failure of a thread in the log that pages show."""
        report_to_stderr(failure)
        self._log.add("fault", failure.text)

    def plan(self, what: str | Mapping[str, Any]) -> dict[str, Any]:
        """Set what is recorded next, by name or by its fields; says how much that is."""
        with self._asking:
            self._check_at_rest("set a plan")
            plan = checked_plan(what, self._rig.design)
            check_plan(self._rig, plan)
            self._set(plan)
            self._status = _UNTOLD
            self._log.add("operator", f"plan {plan.name}: {len(plan.places.places())} places")
            return self._plan_facts

    def start(self, out: str) -> dict[str, Any]:
        """Record the plan into a run of this name, or go on with one that is there."""
        with self._asking:
            path = self._runs / plain_name(out)
            self._check_at_rest("start")
            self._check_released()
            check_plan(self._rig, self._plan)
            self._log.add("operator", f"start {self._plan.name} into {out}")
            self._begin(out, path)
            self._begun.wait(BEGIN_S)
            if self._refused is not None:
                raise self._refused
            return {"run": str(path)}

    def pause(self) -> None:
        """Stop moving, lift the probe, and wait."""
        self._wish(OperatorCommand.PAUSE)

    def resume(self) -> None:
        """Go on after a pause: the press that was left is approached anew."""
        self._check_recording("resume")
        self._log.add("operator", "resume")
        self._control.resume()

    def stop(self) -> None:
        """End after this press; a paused one ends where it is."""
        self._wish(OperatorCommand.STOP)

    def abort(self) -> None:
        """Stop moving, lift the probe, end."""
        self._wish(OperatorCommand.ABORT)

    def estop(self) -> dict[str, int]:
        """Emergency stop: nothing moves any more, also not away, until it is released. Never waits its turn.

        Returns:
            When it was asked for and when the stage stood, on the rig's clock [ns].

        Raises:
            DeviceError: the stage did not stop when told to.
        """
        asked_ns = self._rig.clock.now_ns()
        self._control.ask(OperatorCommand.ESTOP)
        try:
            stood_ns = self._devices.stage.hold()
        except DeviceError as e:
            self._log.add("fault", f"EMERGENCY STOP, and the stage did not answer: {e}")
            raise
        self._estop = {"asked_ns": asked_ns, "stood_ns": stood_ns}
        self._log.add(
            "fault", f"emergency stop: the stage stands, {(stood_ns - asked_ns) / 1e6:.1f} ms later"
        )
        return self._estop

    def release(self) -> None:
        """Take the emergency stop back; nothing moves until something is started."""
        with self._asking:
            if self._thread is not None:
                self._thread.join(END_S)
            self._check_at_rest("release the emergency stop")
            self._devices.stage.release()
            self._estop = None
            self._log.add("operator", "emergency stop released")

    def close(self) -> None:
        """End a recording, the probe lifted, and let go of the devices."""
        if self.recording:
            self._log.add("rig", "the process ends: the recording is aborted")
            self._control.ask(OperatorCommand.ABORT)
        if self._thread is not None:
            self._thread.join(END_S)
        self._devices.close()

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""
        return self._thread is not None and self._thread.is_alive()

    def status(self) -> dict[str, Any]:
        """Status for a page, but for the picture; plain values.

        `ages_s` says of force, position and picture how old they are [s], and of the engine how long ago it
        told anything, None while nothing is recorded.
        """
        status, recording, command = self._status, self.recording, self._control.command
        engine_s = time.monotonic() - self._told_s if recording else None
        ages = {**self._devices.ages_s(), "engine": engine_s}
        return {
            "rig": self._rig.name,
            "simulated": self._rig.is_simulated,
            "real_time": self._real_time,
            "recording": recording,
            "state": status.state.value,
            "asked": command.value if recording and command else None,
            "held": self._devices.stage.held,
            "estop": self._estop,
            "message": status.message,
            "run": self._run,
            "shots": status.shots,
            "left_s": None if status.left_s is None else round(status.left_s, 1),
            "place": self._place if recording else "",
            "log": self._log.tail(TAIL),
            "log_count": self._log.count,
            "ages_s": {name: None if age_s is None else round(age_s, 2) for name, age_s in ages.items()},
            **self._plan_facts,
            **self._devices.status(recording),
        }

    def picture(self, after: int = -1) -> dict[str, Any] | None:
        """The newest frame as a JPEG, numbered; None where there is none newer than `after`."""
        return self._devices.picture(after)

    def _set(self, plan: AnyPlan) -> None:
        size = size_of(plan, self._rig.camera.rate_hz)
        planned = sum(len(plan.shots(press)) for press in plan.presses())
        self._plan = plan
        self._plan_facts = {"plan": plan.model_dump(mode="json"), "size": size._asdict(), "planned": planned}

    def _begin(self, out: str, path: Path) -> None:
        control = OperatorControl()
        self._run, self._place = out, ""
        self._status, self._told_s = replace(_UNTOLD, message="begins"), time.monotonic()
        self._begun.clear()
        self._refused = None
        self._control = control
        if self._devices.stage.held:  # pressed since it was looked at: this control was not told
            control.ask(OperatorCommand.ESTOP)
        work = (self._plan, path, control)
        self._thread = threading.Thread(target=self._record, args=work, name="palpate-rig-record")
        self._thread.start()

    def _record(self, plan: AnyPlan, path: Path, control: OperatorControl) -> None:
        try:
            with self._devices.turn:
                outcome = record(self._rig, plan, path, control=control, watch=self._update)
        except PalpateError as e:
            self._failed(e)
        except Exception as e:
            self._failed(e)
            raise
        else:
            self._ended(outcome)

    def _failed(self, error: Exception) -> None:
        if not self._begun.is_set():
            self._refused = error
        reason = error.reason if isinstance(error, Tripped) else None
        self._ended(Outcome(State.FAILED, self._status.shots, 0, reason, str(error)))

    def _ended(self, outcome: Outcome) -> None:
        kind: Kind = "fault" if outcome.state in (State.FAILED, State.ESTOPPED) else "rig"
        reason = f", {outcome.reason.value}" if outcome.reason else ""
        self._log.add(kind, f"{outcome.state.value}{reason}: {outcome.message}")
        self._status = replace(
            self._status, state=outcome.state, message=outcome.message, shots=outcome.shots, left_s=None
        )
        self._begun.set()

    def _update(self, status: Status) -> None:
        """Take in the engine's status, a few times a second, in the recording's thread."""
        if status.state is not self._status.state and status.state in (State.RUNNING, State.PAUSED):
            self._log.add("rig", f"{status.state.value}: {status.message}")
        press, colon, _ = status.message.rpartition(":")
        if colon and ", cycle " in press and press != self._place:
            self._place = press
            self._log.add("place", press)
        self._devices.update(status)
        self._status, self._told_s = status, time.monotonic()
        self._begun.set()

    def _wish(self, wish: OperatorCommand) -> None:
        self._check_recording(wish.value)
        self._log.add("operator", wish.value)
        self._control.ask(wish)

    def _check_at_rest(self, what: str) -> None:
        if self.recording:
            raise SafetyError(f"a recording is under way; end it before you {what}")

    def _check_released(self) -> None:
        if self._devices.stage.held:
            raise SafetyError(
                "the emergency stop holds the stage; look at the rig, release it, then start",
                code="emergency-stop",
            )

    def _check_recording(self, what: str) -> None:
        if not self.recording:
            raise SafetyError(f"there is no recording to {what}", code="no-recording")


MAX_SCATTERED = 1000  # random places, each of which is compared with all the others
MAX_SHOTS = 500_000
FIRST = "palm-reduced"  # on the usual sensor
SHOWN = 100  # characters of a name


def first_plan(sensor: Sensor | None) -> Known:
    """Choose the plan that a rig is opened with: a short one on the usual sensor, its own on any other."""
    own = plan_of_sensor(sensor)
    return plan_of(FIRST, sensor) if own.name == DEFAULT_SENSOR else own


def checked_plan(what: str | Mapping[str, Any], sensor: Sensor | None = None) -> Known:
    """A plan by its name or its fields.

    Raises:
        InputError: no such plan; a field that is not one, or out of range; or more than is planned this way.
    """
    if isinstance(what, str):
        if what not in PLANS:
            raise InputError(
                f"there is no plan {what[:SHOWN]!r}; there are {', '.join(PLANS)}", code="plan-unknown"
            )
        return plan_of(what, sensor)
    places = what.get("places")
    count = places.get("count") if isinstance(places, Mapping) else None
    if isinstance(count, int | float) and count > MAX_SCATTERED:
        raise InputError(f"{count:g} random places; up to {MAX_SCATTERED} can be asked for here")
    plan = plan_from(what, sensor)
    depths = plan.depth_mm / plan.step_mm if isinstance(plan, StepHold) else 1.0
    shots = len(plan.places.places()) * plan.cycles * len(plan.indenters) * max(depths, 1.0)
    if not shots <= MAX_SHOTS:
        raise InputError(
            f"about {shots:.3g} shots; up to {MAX_SHOTS} can be asked for here: take fewer presses, or a "
            "larger step"
        )
    return plan


class RigServer(RpcServer):
    """Lets others on this machine ask a `RigService`.

    Attributes:
        ended: set once a client has asked for the end.
    """

    def __init__(self, service: RigService) -> None:
        self.ended = threading.Event()
        self._service = service
        quick: dict[str, Request] = {
            "estop": lambda _: service.estop(),
            "abort": lambda _: service.abort(),
            "pause": lambda _: service.pause(),
            "resume": lambda _: service.resume(),
            "stop": lambda _: service.stop(),
            "status": lambda _: service.status(),
        }
        slow: dict[str, Request] = {
            "plan": lambda request: service.plan(request_field(request, "plan", (str, dict))),
            "start": lambda request: service.start(request_field(request, "out", (str,))),
            "release": lambda _: service.release(),
            "shutdown": lambda _: self._shutdown(),
        }
        super().__init__(str(service.status()["rig"]), service.status, service.picture, quick, slow)

    def _shutdown(self) -> None:
        if self._service.recording:
            raise InputError("a recording is under way; stop or abort it first")
        self.ended.set()
