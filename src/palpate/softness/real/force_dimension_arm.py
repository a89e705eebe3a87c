"""Force Dimension arm over the library forcedimension-core. Tested on a fake only.

The arm is driven by forces along one of its axes; a virtual spring and damper guide it to that axis. Safety
lies in the device: watchdog, velocity threshold, and force cap, set and read back before the first force.
Every return code is checked; a failure brakes the arm and raises. `brake` never waits for another thread.

Source: forcedimension-core 1.0.0 and its reference, forcedimension-core-python-docs.readthedocs.io.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from palpate.core import (
    NS_PER_S,
    ArmRange,
    ArmSample,
    Clock,
    Closing,
    DeviceError,
    MissingExtraError,
    MonotonicClock,
    Position,
    RangeError,
)
from palpate.core.optional_imports import require

TICK_S = 125e-6
"""Unit of the watchdog [s]."""
MAX_TICKS = 255  # a byte, and the library lets 256 become 0, which is off
MAX_FORCE_N = 20.0  # of the strongest arm of the family
SAME = 1e-9  # relative, between a limit that was set and what is read back
UPDATE_S = 1e-3  # between two looks, where the library has too few to tell a velocity
UPDATES = 10  # of them; two are enough

CAUSES = {
    1: "force button: the arm brakes",
    2: "velocity limit: the arm brakes",
    3: "watchdog: the arm brakes",
    5: "USB link lost: the arm brakes",
    6: "released by the hand: the arm brakes",
}
"""What turned the forces off, by the library's number, its ForceOffCause; 4 is its own software."""
BY_ITSELF = "the arm brakes by itself"
SATURATED = "motor saturated"
FROZEN = "position frozen"


@dataclass(frozen=True, slots=True)
class ForceDimensionSpec:
    """Mounting and limits of an arm.

    Attributes:
        press_axis, press_sign: device axis "x", "y", or "z" of the press, and 1 or -1 for its direction.
        zero_m: device x, y, z at first touch, on the guide [m].
        force_n: greatest force along the press, at most 20 N.
        effector_kg: carried mass, for gravity compensation [kg].
        watchdog_s: 2 to 31.875 ms, rounded down to 125 us [s].
        guide_n_m, guide_ns_m, guide_n: stiffness (0 for none), damping, and greatest force of the guide.
        aside_m: distance from the guide that is a fault [m].
        saturated_s: duration of motor saturation that is a fault [s].
        frozen_s: duration of an identical position at 1 N or more that is a fault [s].
    """

    press_axis: str
    press_sign: int
    zero_m: Position
    least_m: float
    greatest_m: float
    force_n: float
    effector_kg: float
    serial: int | None = None
    watchdog_s: float = 0.02
    guide_n_m: float = 500.0
    guide_ns_m: float = 10.0
    guide_n: float = 5.0
    aside_m: float = 5e-3
    saturated_s: float = 0.1
    frozen_s: float = 2.0

    def __post_init__(self) -> None:
        if self.press_axis not in ("x", "y", "z") or self.press_sign not in (1, -1):
            raise RangeError(
                f"the press is along {self.press_sign} {self.press_axis!r}; give the axis x, y or z of the "
                "device, and 1 or -1"
            )
        ranges = {
            "least_m": (-0.2, 0.2, "m"),
            "greatest_m": (-0.2, 0.2, "m"),
            "force_n": (0.1, MAX_FORCE_N, "N"),
            "effector_kg": (0.0, 2.0, "kg"),
            "watchdog_s": (2e-3, MAX_TICKS * TICK_S, "s"),
            "guide_n_m": (0.0, 3000.0, "N/m"),
            "guide_ns_m": (0.0, 30.0, "N s/m"),
            "guide_n": (0.0, MAX_FORCE_N, "N"),
            "aside_m": (1e-3, 0.1, "m"),
            "saturated_s": (0.0, 1.0, "s"),
            "frozen_s": (0.1, 60.0, "s"),
        }
        for name, (least, most, unit) in ranges.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise RangeError(f"{name} is {value} {unit}; give {least:g} to {most:g} {unit}")
        if not self.least_m < self.greatest_m:
            raise RangeError(f"the arm reaches from {self.least_m} to {self.greatest_m} m; give a wider way")
        if len(self.zero_m) != 3 or not all(abs(at) <= 0.5 for at in self.zero_m):
            raise RangeError(f"zero_m is {self.zero_m}; give x, y, z of the device within 0.5 m, in m")

    @property
    def ticks(self) -> int:
        """Watchdog's time in units of 125 us, never longer than asked."""
        return math.floor(self.watchdog_s / TICK_S + 1e-6)

    @property
    def greatest_n(self) -> float:
        """Force of press and guide together, to which the device is capped [N]."""
        return math.hypot(self.force_n, self.guide_n)

    def guide_force_n(
        self, aside_m: tuple[float, float], drift_m_s: tuple[float, float]
    ) -> tuple[float, float]:
        """Return the guide force -k x - b v across the press, limited in magnitude [N]."""
        u, v = (
            -self.guide_n_m * at - self.guide_ns_m * speed
            for at, speed in zip(aside_m, drift_m_s, strict=True)
        )
        length = math.hypot(u, v)
        share = self.guide_n / length if length > self.guide_n else 1.0
        return share * u, share * v


class ForceDimensionArm(Closing):
    """A `palpate.core.HapticArm`; opened braking, and braked on exit.

    A force must come within every `ArmRange.watchdog_s`. After the device has braked by itself, `latest`
    reports why and `set_force` refuses until `release`. The library's velocity is late by 10 ms.

    Args:
        library: the module forcedimension_core, or a stand-in.
    """

    def __init__(self, spec: ForceDimensionSpec, clock: Clock | None = None, library: Any = None) -> None:
        self._spec, self._clock = spec, clock or MonotonicClock()
        self._library = _library() if library is None else library
        self._dhd = self._library.dhd
        self._closed, self._braked, self._halts = False, True, 0
        self._fault = ""  # of the device's own braking, until release
        self._force_n = 0.0
        self._saturated_ns: int | None = None  # since when
        self._still: tuple[Position, int] | None = None  # the place, and since when it is the same
        self._axis = "xyz".index(spec.press_axis)
        self._across = [axis for axis in range(3) if axis != self._axis]
        self._id = self._opened()
        try:
            self._take("stop", self._dhd.stop)
            self._check_ready()
            self._set_limits()
            self._motion()
        except BaseException:
            self._closed = True
            self._dhd.stop(self._id)
            self._dhd.close(self._id)
            raise

    @property
    def range(self) -> ArmRange:
        spec = self._spec
        return ArmRange(spec.least_m, spec.greatest_m, spec.force_n, spec.ticks * TICK_S)

    def latest(self) -> ArmSample:
        self._check_open()
        place_m, velocity_m_s = self._motion()
        time_ns = self._clock.now_ns()
        self._note_braking()
        displacement_m = self._spec.press_sign * (place_m[self._axis] - self._spec.zero_m[self._axis])
        return ArmSample(
            time_ns,
            displacement_m,
            self._spec.press_sign * velocity_m_s[self._axis],
            self._fault or self._wrong(place_m, time_ns),
        )

    def set_force(self, force_n: float) -> None:
        if not abs(force_n) <= self._spec.force_n:
            raise RangeError(
                f"a force of {force_n} N; give -{self._spec.force_n:g} to {self._spec.force_n:g} N",
                code="force",
            )
        self._check_open()
        self._check_takes_force()
        place_m, velocity_m_s = self._motion()
        force = [0.0, 0.0, 0.0]
        force[self._axis] = -self._spec.press_sign * force_n
        a, b = self._across
        force[a], force[b] = self._spec.guide_force_n(
            (place_m[a] - self._spec.zero_m[a], place_m[b] - self._spec.zero_m[b]),
            (velocity_m_s[a], velocity_m_s[b]),
        )
        self._check_takes_force()
        self._send(force)
        self._force_n = force_n
        if self._braked:  # by another thread, while this force was on its way
            self.brake()
        self._note_braking()
        self._check_takes_force()

    def brake(self) -> None:
        """Drop the force and brake, until `release`. Safe at any time and from any thread."""
        self._halts += 1
        self._braked = True  # before the call: no force is sent any more, also where it fails
        self._check_open()
        self._force_n, self._saturated_ns = 0.0, None
        if not self._stopped():
            raise DeviceError(
                f"the arm did not take the brake ({self._said()}); no force is sent any more, so its "
                f"watchdog drops the last one within {1e3 * self.range.watchdog_s:g} ms. Switch it off",
                code="brake-refused",
            )

    def release(self) -> None:
        """Let it take forces again, and push with none beside its weight and the guide."""
        self._check_open()
        halts = self._halts
        self._fault, self._still = "", None
        self._send([0.0, 0.0, 0.0])  # or the last force might come back as it is enabled
        self._take("enableForce", self._dhd.enableForce, True)
        self._braked = False
        if halts != self._halts:  # another thread braked it meanwhile, and it was enabled after that
            self.brake()
            raise DeviceError(
                "the arm was told to brake while it was being released; release it again",
                code="braked-in-release",
            )
        self.set_force(0.0)

    def close(self) -> None:
        """Brake, and let go of the arm. Closing again does nothing."""
        if self._closed:
            return
        try:
            self.brake()
        finally:
            self._closed = True
            let_go = self._dhd.close(self._id)
        if let_go != 0:
            raise DeviceError(
                f"the arm brakes but could not be let go ({self._said()}); switch it off and on"
            )

    def _opened(self) -> int:
        serial = self._spec.serial
        found = self._dhd.open() if serial is None else self._dhd.openSerial(serial)
        if found == -1:
            which = "no arm" if serial is None else f"no arm with the serial number {serial}"
            raise DeviceError(
                f"{which} could be opened ({self._said()}); check its power and cable, that no other "
                "programme has it, and that you may use the USB device (on Linux by a udev rule)",
                code="arm-not-found",
            )
        return int(found)

    def _set_limits(self) -> None:
        spec, dhd, expert = self._spec, self._dhd, self._dhd.expert
        self._take("setMaxForce", dhd.setMaxForce, spec.greatest_n)
        self._compare("force limit", dhd.getMaxForce(self._id), spec.greatest_n, "N")
        self._take("setEffectorMass", dhd.setEffectorMass, spec.effector_kg)
        self._compare("effector's mass", dhd.getEffectorMass(self._id), spec.effector_kg, "kg")
        self._take("setGravityCompensation", dhd.setGravityCompensation, True)
        if expert.enableExpertMode() != 0:
            self._fail("enableExpertMode")
        self._take("setWatchdog", expert.setWatchdog, spec.ticks)
        self._compare("watchdog", expert.getWatchdog(self._id), spec.ticks, "times 125 us")
        if expert.disableExpertMode() != 0:
            self._fail("disableExpertMode")

    def _check_ready(self) -> None:
        status = self._status()
        if not (status.power and status.connected and status.started):
            raise DeviceError(
                "the arm is not powered, connected and started; switch it on, then open it anew"
            )
        if status.reset:
            raise DeviceError(
                "the arm is not calibrated, so its places mean nothing; bring it to its rest as its manual "
                "says, until its light stops blinking, then open it anew"
            )
        if status.error:
            raise DeviceError("the arm's controller reports an error; switch it off and on, see its manual")

    def _motion(self) -> tuple[Position, Position]:
        """Place [m] and velocity [m/s] in the device's axes."""
        place, velocity = [math.nan] * 3, [math.nan] * 3
        self._read_place(place)
        for _ in range(UPDATES):
            if self._dhd.getLinearVelocity(velocity, self._id) == 0:
                break
            if self._dhd.errorGetLast() != self._library.constants.ErrorNum.TIMEOUT:
                self._fail("getLinearVelocity")
            self._clock.sleep(UPDATE_S)  # it needs two recent places
            self._read_place(place)
        else:
            self._fail("getLinearVelocity")
        if not all(map(math.isfinite, (*place, *velocity))):
            self._fail("getPosition or getLinearVelocity", f"gave {place} m and {velocity} m/s")
        return (place[0], place[1], place[2]), (velocity[0], velocity[1], velocity[2])

    def _read_place(self, out: list[float]) -> None:
        # Where the library has a place that is recent enough it does not ask for another.
        if self._dhd.getPosition(out, self._id) not in (0, self._library.constants.TIMEGUARD):
            self._fail("getPosition")

    def _send(self, force: list[float]) -> None:
        code = self._dhd.setForce(force, self._id)
        if code not in (0, self._library.constants.MOTOR_SATURATED):
            self._fail("setForce")
        if code == 0:
            self._saturated_ns = None
        elif self._saturated_ns is None:
            self._saturated_ns = self._clock.now_ns()

    def _note_braking(self) -> None:
        """Remember that the device has braked by itself, and why."""
        if self._braked:
            return
        status = self._status()
        if self._braked or (status.force and not status.brake):
            return
        self._fault, self._braked = CAUSES.get(status.forceoffcause, BY_ITSELF), True
        self._dhd.stop(self._id)

    def _wrong(self, place_m: Position, now_ns: int) -> str:
        """Fault of the sample, if any."""
        if self._still is None or self._still[0] != place_m or self._braked or abs(self._force_n) < 1:
            self._still = place_m, now_ns
        if now_ns - self._still[1] > self._spec.frozen_s * NS_PER_S:
            return FROZEN
        since_ns = self._saturated_ns
        if since_ns is not None and now_ns - since_ns > self._spec.saturated_s * NS_PER_S:
            return SATURATED
        aside_m = math.hypot(*(place_m[axis] - self._spec.zero_m[axis] for axis in self._across))
        if self._spec.guide_n_m and aside_m > self._spec.aside_m:
            return f"{1e3 * aside_m:.1f} mm off its guide"
        return ""

    def _status(self) -> Any:
        status = self._library.containers.Status()
        self._take("getStatus", lambda number: self._dhd.getStatus(status, number))
        return status

    def _check_open(self) -> None:
        if self._closed:
            raise DeviceError("the arm was closed; open it anew")

    def _check_takes_force(self) -> None:
        if self._braked:
            raise DeviceError(
                f"{self._fault or 'the arm brakes, as it was told to'}; release() it first", code="arm-braked"
            )

    def _take(self, name: str, call: Any, *arguments: Any) -> None:
        if call(*arguments, self._id) != 0:
            self._fail(name)

    def _compare(self, name: str, found: float, asked: float, unit: str) -> None:
        if not math.isclose(found, asked, rel_tol=SAME, abs_tol=SAME):
            self._fail(name, f"was set to {asked:g} {unit} and is {found:g}")

    def _fail(self, name: str, why: str = "") -> None:
        """Brake and raise; no force is sent any more, so that the watchdog runs out where the brake fails."""
        why = why or f"failed: {self._said()}"
        self._fault, self._braked = self._fault or f"{name} failed", True
        did = (
            "was told to brake"
            if self._stopped()
            else "did not take the brake, and its watchdog drops the force"
        )
        raise DeviceError(f"the arm's {name} {why}; it {did}. Check its power and cable", code="arm-fault")

    def _stopped(self) -> bool:
        """Whether the brake was taken: by itself, or as what follows where forces are off."""
        return self._dhd.stop(self._id) == 0 or self._dhd.enableForce(False, self._id) == 0

    def _said(self) -> str:
        with suppress(Exception):  # what it said is for the message alone
            return str(self._dhd.errorGetLastStr())
        return "no reason given"


def _library() -> Any:
    """Return the maker's library, which needs its SDK 3.16 or newer and Python 3.12 or older."""
    library = require("forcedimension_core", "An arm of Force Dimension with its SDK 3.16 or newer")
    if not hasattr(library, "constants"):  # before 1.0 gravity was another function's
        raise MissingExtraError(
            "forcedimension-core is older than 1.0. Install it with `pip install 'palpate[haptic-arm]'`."
        )
    return library
