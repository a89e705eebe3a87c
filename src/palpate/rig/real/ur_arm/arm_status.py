"""Status of an arm by its receive interface: tool pose, age, and what prevents motion.

Age comes from the controller's own timestamp, because the interface repeats the last values after a lost
connection. The status with the least delay synchronizes the two clocks.

Source: API reference of ur_rtde (sdurobotics.gitlab.io/ur_rtde), RTDEReceiveInterface.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from palpate.core import NS_PER_S, Clock, DeviceError, HardwareStopError, Position
from palpate.rig.real.ur_arm.arm_spec import Pose, UrArmSpec

RUNNING = 7
ROBOT_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "confirm safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle, its brakes on",
    6: "backdrive",
    7: "running",
    8: "updating firmware",
}
"""Modes of the robot, by their numbers."""

SAFETY_STOPS = (
    ((5, 6, 7), "is in an emergency stop: see why, release the button, and start the arm at its pendant"),
    ((4,), "is stopped by its safeguard input: close the guard"),
    ((2,), "is in a protective stop: see what it touched, and release it at its pendant"),
    ((8, 9), "is in a fault or violation of its safety: see its pendant"),
    ((3,), "is in recovery mode: move it back inside its joints' limits at its pendant"),
    ((10,), "is stopped by its safety system: see its pendant"),
)
"""Bits of the safety status that stop an arm, the gravest first, and what to do."""

DRIFT = 1e-4  # of one clock against the other, far more than crystals do
PAUSE_S = 10.0  # without a look, after which a status must be seen to come


@runtime_checkable
class ReceiveInterface(Protocol):
    """Receive interface of ur_rtde, as far as it is used."""

    def isConnected(self) -> bool: ...  # noqa: N802 - the library's names
    def getTimestamp(self) -> float: ...  # noqa: N802
    def getActualTCPPose(self) -> list[float]: ...  # noqa: N802
    def getActualTCPSpeed(self) -> list[float]: ...  # noqa: N802
    def getRobotMode(self) -> int: ...  # noqa: N802
    def getSafetyStatusBits(self) -> int: ...  # noqa: N802
    def disconnect(self) -> None: ...


def ask(what: str, call: Callable[..., Any], *arguments: Any) -> Any:
    """Call the library; what it raises is a `DeviceError`, whatever its type."""
    try:
        return call(*arguments)
    except Exception as e:
        raise DeviceError(f"the arm's controller did not {what} ({type(e).__name__}: {e})") from e


@dataclass(frozen=True, slots=True)
class ArmStatus:
    """Status of an arm.

    Attributes:
        time_s: of the controller, since it was started [s].
        age_s: at the look [s].
        pose: of the tool in the arm's base [m, rad].
        speed_m_s: of the tool [m/s].
        mode: of the robot; see `ROBOT_MODES`.
        safety: bits of its safety status.
    """

    time_s: float
    age_s: float
    pose: Pose
    speed_m_s: float
    mode: int
    safety: int

    @property
    def place_m(self) -> Position:
        """Place of the tool in the arm's base [m]."""
        return self.pose[:3]

    @property
    def tool_rad(self) -> Position:
        """Rotation vector of the tool in the arm's base [rad]."""
        return self.pose[3:]

    @property
    def safety_stop(self) -> str:
        """What its safety system stopped it by, and what to do; empty where nothing did."""
        for bits, words in SAFETY_STOPS:
            if any(self.safety >> bit & 1 for bit in bits):
                return words
        return ""

    @property
    def in_words(self) -> str:
        """Mode and safety, as for a page of status."""
        mode = ROBOT_MODES.get(self.mode, f"mode {self.mode}")
        return f"{mode}; {self.safety_stop}" if self.safety_stop else mode

    def check_runs(self) -> None:
        """Refuse an arm that cannot move."""
        if self.safety_stop:
            raise HardwareStopError(f"the arm {self.safety_stop}")
        if self.mode != RUNNING:
            raise DeviceError(
                f"the arm is not running (its mode is {self.in_words}): start it at its pendant, and release "
                "its brakes"
            )


class ArmWatch:
    """Watch on an arm's status. Safe from any thread.

    Args:
        receive: the library's interface.
        spec: states the rate, and the age that is too old.
        clock: of this computer.
    """

    def __init__(self, receive: ReceiveInterface, spec: UrArmSpec, clock: Clock) -> None:
        self._receive, self._spec, self._clock = receive, spec, clock
        self._lock = threading.Lock()
        self._newest_s = -math.inf  # of the controller
        self._apart_s = math.inf  # this computer's clock less the controller's, at the quickest status
        self._looked_s = -math.inf

    def look(self) -> ArmStatus:
        """The newest status."""
        with self._lock:
            if self._now_s() - self._looked_s > PAUSE_S:
                self._apart_s = math.inf
                self._see_one_come()
            return self._status()

    def next(self) -> ArmStatus:
        """A status that came after this was called."""
        with self._lock:
            self._see_one_come()
            return self._status()

    def _status(self) -> ArmStatus:
        time_s, now_s = self._timestamp(), self._now_s()
        age_s = self._age_s(time_s, now_s)
        if age_s > self._spec.stale_s:
            raise DeviceError(
                f"the arm's newest status is {age_s:.3f} s old, and {self._spec.stale_s:g} s are allowed: "
                "its connection is lost or its controller hangs; it may move on to where it was sent. See "
                "its cable, or press its emergency stop"
            )
        # After the timestamp: what these return is as new as it is, or newer.
        pose = self._six("tell where its tool is", self._receive.getActualTCPPose)
        velocity = self._six("tell how fast its tool is", self._receive.getActualTCPSpeed)
        mode = ask("tell its mode", self._receive.getRobotMode)
        safety = ask("tell its safety status", self._receive.getSafetyStatusBits)
        return ArmStatus(time_s, age_s, pose, math.hypot(*velocity[:3]), int(mode), int(safety))

    def _age_s(self, time_s: float, now_s: float) -> float:
        """Age of a status beyond that of the quickest one, which lets the clocks drift apart."""
        if self._looked_s > -math.inf:
            self._apart_s += DRIFT * (now_s - self._looked_s)
        self._apart_s, self._looked_s = min(self._apart_s, now_s - time_s), now_s
        return now_s - time_s - self._apart_s

    def _timestamp(self) -> float:
        if not ask("say whether it is connected", self._receive.isConnected):
            raise DeviceError(
                "the connection to the arm's controller is lost: it may move on to where it was sent. See "
                "its power, cable and network, then open it anew",
                code="connection-lost",
            )
        time_s = float(ask("tell its time", self._receive.getTimestamp))
        if not math.isfinite(time_s):
            raise DeviceError(f"the arm's controller tells {time_s} as its time")
        if time_s < self._newest_s:
            before_s, self._newest_s = self._newest_s, time_s
            self._apart_s = math.inf
            raise DeviceError(
                f"the arm's controller went back from {before_s:.3f} to {time_s:.3f} s: it restarted; open "
                "it anew"
            )
        self._newest_s = time_s
        return time_s

    def _see_one_come(self) -> None:
        """Wait for the timestamp to change."""
        first_s, began_s = self._timestamp(), self._now_s()
        while self._timestamp() == first_s:
            if self._now_s() - began_s > self._spec.stale_s:
                raise DeviceError(
                    f"the arm sent no new status in {self._spec.stale_s:g} s: its connection is lost or its "
                    "controller hangs",
                    code="status-stale",
                )
            self._clock.sleep(0.25 / self._spec.rate_hz)

    def _six(self, what: str, call: Callable[[], list[float]]) -> Pose:
        values = tuple(float(value) for value in ask(what, call))
        if len(values) != 6 or not all(map(math.isfinite, values)):
            raise DeviceError(f"the arm's controller did not {what}: it gave {values}")
        x, y, z, rx, ry, rz = values
        return x, y, z, rx, ry, rz

    def _now_s(self) -> float:
        return self._clock.now_ns() / NS_PER_S
