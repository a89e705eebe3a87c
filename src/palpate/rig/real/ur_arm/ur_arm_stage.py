"""Universal Robots arm as a stage, over the library ur_rtde. Tested on a fake only.

Every move is one asynchronous `moveL` of the tool with its orientation at opening, one in flight at a time.
An arm is absolute: it needs no homing, and opening it moves nothing. A stop is `stopL` with the stated
deceleration a; its overshoot, at most v^2 / 2a and the latency, is measured at each stop. The library is not
thread-safe, so a stop waits for a move that is being sent. An emergency stop needs the arm's own button.

Source: API reference of ur_rtde (sdurobotics.gitlab.io/ur_rtde), RTDEControlInterface.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from palpate.core import (
    NS_PER_S,
    Clock,
    Closing,
    DeviceError,
    HardwareStopError,
    MonotonicClock,
    Position,
    Travel,
)
from palpate.core.optional_imports import require
from palpate.rig.real.device_hold import arm_named, hold_device
from palpate.rig.real.gcode_spec import check_range, distance_to_segment
from palpate.rig.real.ur_arm.arm_spec import UrArmSpec
from palpate.rig.real.ur_arm.arm_status import ArmStatus, ArmWatch, ReceiveInterface, ask

WITHIN_M = 0.02e-3  # of its target, where a move has ended; and by which a place at a stand may change
STILL_M_S = 1e-3  # below it the tool counts as standing: what joints that hold still report is noise
STAND_LOOKS = 3  # new statuses, one after the other, that must show it standing
STRAY_M = 1e-3  # off its straight way


@runtime_checkable
class ControlInterface(Protocol):
    """Control interface of ur_rtde, as far as it is used. Not safe from two threads."""

    def moveL(self, pose: list[float], speed: float, acceleration: float, asynchronous: bool) -> bool: ...  # noqa: N802
    def stopL(self, a: float) -> None: ...  # noqa: N802
    def isConnected(self) -> bool: ...  # noqa: N802
    def isProgramRunning(self) -> bool: ...  # noqa: N802
    def stopScript(self) -> None: ...  # noqa: N802
    def disconnect(self) -> None: ...


@dataclass(frozen=True, slots=True)
class ArmMove:
    """A move in flight, in the arm's base [m], since when, and when it last was seen on its way [s]."""

    start_m: Position
    target_m: Position
    speed_m_s: float
    began_s: float
    went_s: float

    @property
    def due_s(self) -> float:
        """Time before which it cannot be over: nothing is faster than asked [s]."""
        return self.began_s + math.dist(self.start_m, self.target_m) / self.speed_m_s


class UrArmStage(Closing):
    """A `palpate.core.Stage`; a context manager that stops it on the way out.

    Args:
        spec: how it is reached, mounted and limited.
        receive: the library's receive interface; `open` makes both.
        connect: makes the control interface, which is done once the arm was seen to be as stated: from then
            on the library's own programme runs on the controller, in place of any other.
        clock: times the motion.
        release: called at the end, to give the arm back.

    Raises:
        DeviceError: it does not answer, is not running, or its tool is not in the orientation stated.
        HardwareStopError: its safety system has stopped it.
    """

    def __init__(
        self,
        spec: UrArmSpec,
        receive: ReceiveInterface,
        connect: Callable[[], ControlInterface],
        clock: Clock | None = None,
        release: Callable[[], None] = lambda: None,
    ) -> None:
        self._spec, self._clock, self._receive = spec, clock or MonotonicClock(), receive
        self._release, self._closed, self._halts = release, False, 0
        self._lock = threading.RLock()
        self._move: ArmMove | None = None
        self._watch = ArmWatch(receive, spec, self._clock)
        control: ControlInterface | None = None
        try:
            status = self._watch.next()
            status.check_runs()
            if status.speed_m_s <= STILL_M_S:
                self._check_orientation(status)
            control = ask("take the library's programme", connect)
            self._control = control
            self._tool_rad = self._calmed().tool_rad
        except BaseException:
            self._closed = True
            _let_go(receive, control, release)
            raise

    @classmethod
    def open(cls, spec: UrArmSpec, clock: Clock | None = None) -> UrArmStage:
        """Connect to the spec's controller, alone; nothing moves."""
        receiving, controlling = _library("rtde_receive"), _library("rtde_control")
        held = hold_device(arm_named(spec.host))
        try:
            receive = ask(
                f"answer at {spec.host}; check its power, cable, address, and that it is in remote control",
                lambda: receiving.RTDEReceiveInterface(spec.host, frequency=spec.rate_hz),
            )
        except BaseException:
            held.release()
            raise
        return cls(spec, receive, lambda: controlling.RTDEControlInterface(spec.host), clock, held.release)

    @property
    def travel(self) -> Travel:
        """The spec's box and speed; its deceleration is that of a stop."""
        spec = self._spec
        return Travel(
            least_m=spec.least_m,
            greatest_m=spec.greatest_m,
            top_speed_m_s=spec.top_speed_m_s,
            acceleration_m_s2=spec.stop_m_s2,
            latency_s=spec.latency_s,
        )

    @property
    def status(self) -> ArmStatus:
        """The newest status."""
        self._check_open()
        return self._watch.look()

    @property
    def reported(self) -> str:
        """Mode and safety status in words."""
        return self.status.in_words

    def position_m(self) -> Position:
        """Place of the tool now [m], by its joints' encoders. See `palpate.core.Stage`."""
        return self._spec.frame.rig_m(self.status.place_m)

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        """Start moving in a straight line, and return once it is taken. See `palpate.core.Stage`.

        Raises:
            RangeError: a place outside the box, or a speed that is not allowed.
            HardwareStopError: its safety system has stopped it.
            DeviceError: besides, it stands outside the box, or its tool was turned.
        """
        halts = self._halts
        check_range(self.travel, position_m, speed_m_s)
        with self._lock:
            self._check_open()
            if self._move:
                raise DeviceError("the arm is moving already; wait for it, or stop() it")
            status = self._watch.look()
            self._check_ready(status)
            if halts != self._halts:
                raise DeviceError("the arm was stopped before this move began", code="move-canceled")
            target_m, now_s = self._spec.frame.base_m(position_m), self._now_s()
            self._move = ArmMove(status.place_m, target_m, speed_m_s, now_s, now_s)
            self._hand_over([*target_m, *self._tool_rad], speed_m_s)

    def moving(self) -> bool:
        with self._lock:
            status = self.status
            status.check_runs()
            self._check_orientation(status)
            if self._move is None:
                return status.speed_m_s > STILL_M_S
            self._check_way(status, self._move)
            return not self._arrived(status, self._move)

    def stop(self) -> None:
        """Slow down to a stand at once; returns when it stands. See `palpate.core.Stage`.

        Raises:
            HardwareStopError: it stands, stopped by its safety system.
            DeviceError: it was not seen to stand, or ran on further than `travel` states.
        """
        self._halts += 1  # before the lock: a move that has not been handed over yet never is
        with self._lock:
            self._check_open()
            move, asked, unseen = self._move, None, None
            try:
                asked = self._watch.look()
                if move is None and asked.speed_m_s <= STILL_M_S:
                    return
            except DeviceError as e:
                unseen = e
            refused = self._slow_down()
            if unseen is not None or asked is None:
                raise DeviceError(
                    f"the arm was told to stop, and nothing shows that it did ({unseen}): press its "
                    "emergency stop",
                    code="stop-not-confirmed",
                ) from unseen
            stood = self._await_stand()
            self._move = None
            if stood.safety_stop:
                raise HardwareStopError(f"the arm stands, and {stood.safety_stop}")
            if refused is not None:
                raise DeviceError(
                    f"the arm stands, but not because it was told to: {refused}", code="stop-unexpected"
                ) from refused
            if move is not None:
                self._check_run_on(move, asked, stood)

    def close(self) -> None:
        """Stop, and let go of the arm. Closing again does nothing."""
        with self._lock:
            if self._closed:
                return
            try:
                # A safety stop made it stand, which is what is asked for here; and where it was sent nowhere,
                # a connection that is lost keeps nothing moving.
                with suppress(DeviceError if self._move is None else HardwareStopError):
                    self.stop()
            finally:
                self._closed = True
                _let_go(self._receive, self._control, self._release)

    def _calmed(self) -> ArmStatus:
        """Status of the arm, as stated, after what was found moving it was brought to a stand."""
        if (status := self._watch.next()).speed_m_s > STILL_M_S:
            ask("stop", self._control.stopL, self._spec.stop_m_s2)
            status = self._await_stand()
        self._check_orientation(status)
        return status

    def _hand_over(self, pose: list[float], speed_m_s: float) -> None:
        """Give the arm its move; where that is not known to be taken, bring it to a stand."""
        refused = DeviceError(
            "the arm's controller refused to move: its pose may lie out of reach or beyond its safety "
            "planes, or the library's programme has ended on it; see its pendant, then open it anew",
            code="move-refused",
        )
        acceleration = self._spec.acceleration_m_s2
        try:
            if ask("take a move", self._control.moveL, pose, speed_m_s, acceleration, True):
                return
        except DeviceError as e:
            refused = e
        self.stop()  # it may have begun; the better reason, such as a protective stop, comes first
        raise refused

    def _slow_down(self) -> DeviceError | None:
        """Send the stop; what kept it from being taken, if anything."""
        try:
            if ask("stop", self._control.stopL, self._spec.stop_m_s2) is False:
                return DeviceError("the arm's controller refused to stop")
        except DeviceError as e:
            return e
        return None

    def _await_stand(self) -> ArmStatus:
        """A status that shows it standing, as those before it do."""
        end_s, stands = self._now_s() + self._spec.stop_s, 0
        last = self._watch.next()
        while stands < STAND_LOOKS:
            if self._now_s() > end_s:
                with suppress(DeviceError):
                    ask("end its programme", self._control.stopScript)
                raise DeviceError(
                    f"the arm still moves {self._spec.stop_s:g} s after it was told to stop, and its "
                    "programme was ended: press its emergency stop",
                    code="stop-failed",
                )
            status = self._watch.next()
            still = status.speed_m_s <= STILL_M_S and math.dist(status.place_m, last.place_m) <= WITHIN_M
            stands, last = (stands + 1 if still else 0), status
        return last

    def _check_run_on(self, move: ArmMove, asked: ArmStatus, stood: ArmStatus) -> None:
        went_m = math.dist(asked.place_m, stood.place_m)
        # The status from which it is counted may be old by its age, during which it went on too.
        allowed_m = self.travel.overshoot_m(move.speed_m_s, asked.age_s + 1 / self._spec.rate_hz) + WITHIN_M
        if went_m > allowed_m:
            raise DeviceError(
                f"the arm stands, but ran on {went_m * 1e3:.2f} mm after it was told to stop; "
                f"{allowed_m * 1e3:.2f} mm are stated. State a longer latency_s or a lower deceleration",
                code="stop-distance",
            )

    def _check_open(self) -> None:
        if self._closed:
            raise DeviceError("the arm was closed; open it anew")

    def _check_ready(self, status: ArmStatus) -> None:
        status.check_runs()
        self._check_orientation(status)
        if status.speed_m_s > STILL_M_S:
            raise DeviceError(
                f"the arm moves at {status.speed_m_s * 1e3:.1f} mm/s, and no move was sent: is it led by "
                "hand, or by another programme?"
            )
        at_m, spec = self._spec.frame.rig_m(status.place_m), self._spec
        for axis, at, low, high in zip("xyz", at_m, spec.least_m, spec.greatest_m, strict=True):
            if not low - WITHIN_M <= at <= high + WITHIN_M:
                raise DeviceError(
                    f"the arm stands outside its box: {axis} is {at * 1e3:.2f} mm, and {low * 1e3:g} to "
                    f"{high * 1e3:g} mm are allowed; lead it inside by its pendant, as nothing is known of "
                    "the way",
                    code="outside-travel",
                )
        if not ask("say whether it is connected", self._control.isConnected):
            raise DeviceError("the connection that moves the arm is lost; open it anew")
        if not ask("say whether its programme runs", self._control.isProgramRunning):
            raise DeviceError(
                "the library's programme no longer runs on the arm, as after a protective stop or a switch "
                "to local control; open it anew",
                code="program-ended",
            )

    def _check_orientation(self, status: ArmStatus) -> None:
        tilt_deg = self._spec.frame.tilt_deg(status.tool_rad)
        if tilt_deg > self._spec.tilt_deg:
            turned = ", ".join(f"{value:.4f}" for value in status.tool_rad)
            raise DeviceError(
                f"the arm's tool is {tilt_deg:.2f} degrees out of the orientation stated, and "
                f"{self._spec.tilt_deg:g} are allowed: its rotation vector is ({turned}) rad. Nothing turns "
                "it here: turn it by its pendant, or state the right one",
                code="tool-orientation",
            )

    def _check_way(self, status: ArmStatus, move: ArmMove) -> None:
        """Refuse an arm off its way, or one that stands on it."""
        off_m = distance_to_segment(status.place_m, move.start_m, move.target_m)
        if off_m > STRAY_M:
            raise DeviceError(f"the arm is {off_m * 1e3:.2f} mm off its straight way; stop() it, see why")
        now_s = self._now_s()
        near = math.dist(status.place_m, move.target_m) <= WITHIN_M
        if status.speed_m_s > STILL_M_S or near or now_s < move.began_s + self._spec.latency_s:
            self._move = ArmMove(move.start_m, move.target_m, move.speed_m_s, move.began_s, now_s)
        elif now_s - move.went_s > self._patience_s(move):
            short_m = math.dist(status.place_m, move.target_m)
            raise DeviceError(
                f"the arm stands {short_m * 1e3:.2f} mm short of its target; stop() it, then see its pendant"
            )

    def _patience_s(self, move: ArmMove) -> float:
        """A move slower than what counts as standing is judged by when it is due."""
        if move.speed_m_s > 2 * STILL_M_S:
            return self._spec.still_s
        return self._spec.still_s + 2 * (move.due_s - move.began_s)

    def _arrived(self, status: ArmStatus, move: ArmMove) -> bool:
        """Whether it stands at its target: no sooner than it can, and in later statuses too."""
        if self._now_s() < move.due_s or not self._stands_at(status, move):
            return False
        if not all(self._stands_at(self._watch.next(), move) for _ in range(STAND_LOOKS - 1)):
            return False
        self._move = None
        return True

    def _stands_at(self, status: ArmStatus, move: ArmMove) -> bool:
        at_target = math.dist(status.place_m, move.target_m) <= WITHIN_M
        return at_target and status.speed_m_s <= STILL_M_S

    def _now_s(self) -> float:
        return self._clock.now_ns() / NS_PER_S


def _let_go(receive: ReceiveInterface, control: ControlInterface | None, release: Callable[[], None]) -> None:
    """End the library's programme and both connections, whatever they raise: nobody could do more."""
    calls = [receive.disconnect] if control is None else [
        control.stopScript, control.disconnect, receive.disconnect,
    ]  # fmt: skip
    for call in calls:
        with suppress(DeviceError):
            ask("let go", call)
    release()


def _library(name: str) -> Any:
    return require(name, "An arm of Universal Robots")
