"""A fake of an arm of Universal Robots, as the library ur_rtde shows it. It fails as it is told to.

Made from public descriptions, not from an arm. [api]: the API reference of ur_rtde (sdurobotics.gitlab.io/
ur_rtde) and the comments of its public headers; [src]: what its public source does where the reference is
silent; [ur]: Universal Robots' manuals of URScript and of the arms' safety. Kinematics, reach, joint limits,
contact and the arm's own stopping distances are not simulated.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from palpate.core import NS_PER_S, Clock

RUNNING, POWER_OFF = 7, 3
NORMAL, PROTECTIVE, SAFEGUARD, ROBOT_EMERGENCY, EMERGENCY, STOPPED = 0, 2, 4, 6, 7, 10  # bits of safety [api]
TAKEN_S = 0.008  # of a command by the programme on the controller: a cycle of it
PROTECTIVE_M_S2 = 4.0  # at which its safety system slows it down


@dataclass(frozen=True, slots=True)
class UrFaults:
    """Faults; none by default.

    Attributes:
        refuse: moveL returns False, and nothing moves.
        refuse_late: moveL returns False although the arm moves.
        deaf: stopL does nothing.
        weak: of the deceleration that stopL asks for, so much is reached.
        late_s: a stop begins so much later [s].
        taken_s: moveL takes so long to be handed over, while its programme is busy [s].
        stuck_m: it stands after so much of its way, and says nothing [m]; infinite for never.
        aside_m: it leaves its way sideways by so much [m].
        silent: no status comes, and the connection seems to hold, as behind a switch that lost its cable.
        raises: every call of the control interface raises.
        noise_m, noise_m_s: standard deviations of place and speed as reported [m, m/s].
    """

    refuse: bool = False
    refuse_late: bool = False
    deaf: bool = False
    weak: float = 1.0
    late_s: float = 0.0
    taken_s: float = TAKEN_S
    stuck_m: float = math.inf
    aside_m: float = 0.0
    silent: bool = False
    raises: bool = False
    noise_m: float = 0.0
    noise_m_s: float = 0.0


@dataclass(slots=True)
class StraightWay:
    """Straight way with a trapezoid of speed, which may be cut by a stop.

    Attributes:
        began_s: when it sets off [s].
        start, target: poses [m, rad].
        speed, acceleration: of the tool [m/s, m/s^2].
        cut_s, brake: when a stop begins to act, and its deceleration [s, m/s^2].
    """

    began_s: float
    start: np.ndarray
    target: np.ndarray
    speed: float
    acceleration: float
    cut_s: float = math.inf
    brake: float = math.inf

    @property
    def length(self) -> float:
        """Length of the way [m]."""
        return float(np.linalg.norm(self.target[:3] - self.start[:3]))

    def along(self, now_s: float) -> tuple[float, float]:
        """Way made [m] and speed [m/s] at a time."""
        if now_s <= self.cut_s:
            return self._uncut(now_s)
        way, speed = self._uncut(self.cut_s)
        took_s = min(now_s - self.cut_s, speed / self.brake)
        return way + speed * took_s - self.brake * took_s**2 / 2, speed - self.brake * took_s

    def pose(self, now_s: float) -> np.ndarray:
        """Pose at a time [m, rad]."""
        way = self.along(now_s)[0]
        return self.start + (self.target - self.start) * (way / self.length if self.length else 1.0)

    def _uncut(self, now_s: float) -> tuple[float, float]:
        a, length = self.acceleration, self.length
        top = min(self.speed, math.sqrt(a * length))
        if not top:
            return 0.0, 0.0
        ramp_s, whole_s = top / a, length / top + top / a
        t = min(max(now_s - self.began_s, 0.0), whole_s)
        if t < ramp_s:
            return a * t**2 / 2, a * t
        if t < whole_s - ramp_s:
            return top * (t - ramp_s / 2), top
        left_s = whole_s - t
        return length - a * left_s**2 / 2, a * left_s


class UrController:
    """Controller and arm behind both interfaces.

    Args:
        pose: of the tool at the start [m, rad].
        clock: that the arm lives by.
        faults: may be changed at any time.
        booted_s: what its own clock says at first [s].
        drift: of its clock against the other.

    Attributes:
        programme: whether the library's programme runs on it.
        uploads: how often that was sent.
        clashes: calls of the control interface that came while another was under way.
        greatest_turn: greatest change of orientation that it was sent to [rad].
        moves: poses that it was sent to.
    """

    def __init__(
        self,
        pose: Sequence[float],
        clock: Clock,
        faults: UrFaults | None = None,
        *,
        rate_hz: float = 125.0,
        booted_s: float = 4321.0,
        drift: float = 0.0,
    ) -> None:
        self.clock, self.faults = clock, faults or UrFaults()
        self._rate_hz, self._booted_s, self._drift = rate_hz, booted_s, drift
        self._zero_s = self.now_s
        self._rest = np.array(pose, dtype=float)
        self._run: StraightWay | None = None
        self.mode, self.safety = RUNNING, 1 << NORMAL
        self.programme = self.connected = self.cut = False
        self._told: Any = ()
        self.lock, self._busy = threading.RLock(), threading.Lock()
        self._draw = np.random.default_rng(0)
        self.clashes = self.uploads = 0
        self.moves: list[list[float]] = []
        self.greatest_turn = 0.0

    @property
    def now_s(self) -> float:
        """Time of the clock [s]."""
        return self.clock.now_ns() / NS_PER_S

    def true_pose(self, now_s: float | None = None) -> np.ndarray:
        """Pose of the tool [m, rad]."""
        with self.lock:
            now_s = self.now_s if now_s is None else now_s
            if self._run is None:
                return self._rest.copy()
            pose = self._run.pose(now_s)
            if self._run.length and self.faults.aside_m:
                pose[0] += self.faults.aside_m * self._run.along(now_s)[0] / self._run.length
            return pose

    def true_speed(self, now_s: float | None = None) -> float:
        """Speed of the tool [m/s]."""
        with self.lock:
            return 0.0 if self._run is None else self._run.along(self.now_s if now_s is None else now_s)[1]

    def led_to(self, pose: Sequence[float]) -> None:
        """Put the tool elsewhere, as by hand."""
        with self.lock:
            self._run, self._rest = None, np.array(pose, dtype=float)

    def go(self, pose: Sequence[float], speed: float, acceleration: float, after_s: float = TAKEN_S) -> None:
        """Set off to a pose, from where it is; a new way takes the place of an old one."""
        with self.lock:
            start, target = self.true_pose(), np.array(pose, dtype=float)
            if self.faults.stuck_m < math.inf:
                way = float(np.linalg.norm(target[:3] - start[:3]))
                target = start + (target - start) * min(1.0, self.faults.stuck_m / way)
            self.greatest_turn = max(self.greatest_turn, float(np.abs(target[3:] - start[3:]).max()))
            self._run = StraightWay(self.now_s + after_s, start, target, speed, acceleration)

    def brake(self, deceleration: float, after_s: float = TAKEN_S) -> None:
        """Slow down along its way."""
        with self.lock:
            if self._run is not None and self._run.cut_s == math.inf:
                self._run.cut_s, self._run.brake = self.now_s + after_s, deceleration

    def stop_for_safety(self, *bits: int, mode: int = RUNNING) -> None:
        """Stop by its own safety system; the programme ends."""
        with self.lock:
            self.brake(PROTECTIVE_M_S2, 0.0)
            self.safety, self.mode, self.programme = sum(1 << bit for bit in (*bits, STOPPED)), mode, False

    def released(self) -> None:
        """Clear the stop, as at the pendant; the programme does not begin again by itself [src]."""
        with self.lock:
            self.safety, self.mode = 1 << NORMAL, RUNNING

    def restart(self) -> None:
        """Boot: its clock begins anew, since it tells the time since it was started [api]."""
        with self.lock:
            self._booted_s, self._zero_s = 0.0, self.now_s

    def told(self) -> tuple[float, np.ndarray, float, int, int]:
        """Timestamp, pose, speed, mode and safety of the newest status."""
        with self.lock:
            if self._told and (self.cut or self.faults.silent):
                return self._told
            since_s = self.now_s - self._zero_s
            at_s = self._zero_s + math.floor(since_s * self._rate_hz + 1e-6) / self._rate_hz
            time_s = self._booted_s + (at_s - self._zero_s) * (1 + self._drift)
            if not self._told or self._told[0] != time_s:
                draw, faults = self._draw.standard_normal(4), self.faults
                pose = self.true_pose(at_s)
                pose[:3] += faults.noise_m * draw[:3]
                speed = self.true_speed(at_s) + faults.noise_m_s * draw[3]
                self._told = (time_s, pose, speed, self.mode, self.safety)
            return self._told

    @property
    def busy(self) -> bool:
        """Whether a call of the control interface is under way."""
        return self._busy.locked()

    @contextmanager
    def call(self) -> Iterator[None]:
        """Control call; [api]: it is not safe from two threads, so two at once are counted and refused."""
        if not self._busy.acquire(blocking=False):
            self.clashes += 1
            raise RuntimeError("two calls at once")
        try:
            if self.faults.raises:
                raise RuntimeError("Failed to send data")
            yield
        finally:
            self._busy.release()


class FakeReceive:
    """RTDEReceiveInterface of the library."""

    def __init__(self, controller: UrController, frequency: float = -1.0) -> None:
        if controller.cut:
            raise RuntimeError("Could not connect")
        self._arm, self._open, self.frequency = controller, True, frequency

    def isConnected(self) -> bool:
        """[api]: for checking for lost connection."""
        return self._open and not self._arm.cut

    def getTimestamp(self) -> float:
        """[api]: time elapsed since the controller was started [s]."""
        return self._arm.told()[0]

    def getActualTCPPose(self) -> list[float]:
        """[api]: x, y, z and a rotation vector of the tool."""
        return list(self._arm.told()[1])

    def getActualTCPSpeed(self) -> list[float]:
        """[api]: speed of the tool in Cartesian coordinates."""
        return [0.0, 0.0, self._arm.told()[2], 0.0, 0.0, 0.0]

    def getRobotMode(self) -> int:
        """[api]: 7 is running, 3 power off."""
        return self._arm.told()[3]

    def getSafetyStatusBits(self) -> int:
        """[api]: bit 0 normal, 2 protective, 4 safeguard, 5 to 7 emergency, 10 stopped due to safety."""
        return self._arm.told()[4]

    def isProtectiveStopped(self) -> bool:
        """[api]: whether it is in a protective stop."""
        return bool(self.getSafetyStatusBits() >> PROTECTIVE & 1)

    def isEmergencyStopped(self) -> bool:
        """[api]: whether it is in an emergency stop."""
        return bool(self.getSafetyStatusBits() >> EMERGENCY & 1)

    def disconnect(self) -> None:
        """[api]: disconnects; the values that came last stay [src]."""
        self._open = False


class FakeControl:
    """RTDEControlInterface of the library."""

    def __init__(self, controller: UrController) -> None:
        if controller.cut or controller.faults.raises:
            raise RuntimeError("Could not connect")
        self._arm, self._open = controller, True
        controller.programme = True
        controller.uploads += 1

    def isConnected(self) -> bool:
        """[api]: for checking for lost connection."""
        return self._open and not self._arm.cut

    def isProgramRunning(self) -> bool:
        """[api]: whether a programme runs on the controller."""
        return self._arm.programme

    def moveL(
        self, pose: list[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool:
        """[api]: straight in the tool's space; returns at the end, or at once where asynchronous."""
        arm = self._arm
        with arm.call():
            arm.clock.sleep(arm.faults.taken_s)
            stopped = arm.safety >> PROTECTIVE & 1 or arm.safety >> EMERGENCY & 1
            if not arm.programme or stopped or not self.isConnected() or arm.faults.refuse:
                return False
            arm.moves.append(list(pose))
            arm.go(pose, speed, acceleration)
            while not asynchronous and arm.true_speed(arm.now_s + 2 * TAKEN_S):
                arm.clock.sleep(TAKEN_S)
            return not arm.faults.refuse_late

    def stopL(self, a: float = 10.0, asynchronous: bool = False) -> None:
        """[api]: slows the tool down to zero at a [m/s^2]; may block the caller until it stands."""
        arm = self._arm
        with arm.call():
            if not self.isConnected() or arm.faults.deaf or not arm.programme:
                return
            arm.brake(a * arm.faults.weak, TAKEN_S + arm.faults.late_s)
            while not asynchronous and arm.true_speed(arm.now_s):
                arm.clock.sleep(TAKEN_S)

    def stopScript(self) -> None:
        """[api]: terminates its programme on the controller; [ur]: a programme that ends stops the arm."""
        with self._arm.call():
            if self.isConnected() and not self._arm.faults.deaf:
                self._arm.brake(PROTECTIVE_M_S2)
                self._arm.programme = False

    def disconnect(self) -> None:
        """[api]: disconnects."""
        self._open = False


def ur_modules(controller: UrController) -> dict[str, ModuleType]:
    """Modules rtde_control and rtde_receive, by name, as an import would find them."""
    control, receive = ModuleType("rtde_control"), ModuleType("rtde_receive")
    control.RTDEControlInterface = lambda hostname, frequency=-1.0: FakeControl(controller)  # type: ignore[attr-defined]
    receive.RTDEReceiveInterface = lambda hostname, frequency=-1.0: FakeReceive(controller, frequency)  # type: ignore[attr-defined]
    return {one.__name__: one for one in (control, receive)}
