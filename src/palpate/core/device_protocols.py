"""The protocols of devices: a stage, a force sensor, a camera; a contact-area display and a haptic arm.

All times are on the host's monotonic clock [ns]; positions are in the stage's own frame: x right, y towards
the viewer, z into the skin [m]. `palpate.check` checks an implementation. No method waits indefinitely.

Every method raises `DeviceError` if the device does not answer, refuses, is not ready, or has lost its
position; `move_to`, `set_pressure`, and `set_force` raise `RangeError` for a value outside the range or not
finite, and change nothing. `grab` and `drain` also raise `DeviceError` if the size or format changed, or
samples were lost. `close` may be called again.

The display stands on the arm. Displacement is counted from first touch, positive in the direction of the
press; force is positive where it pushes the finger back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from palpate.core.frame import Frame

Position = tuple[float, float, float]
"""x, y, z [m]."""


@dataclass(frozen=True, slots=True)
class Wrench:
    """One sample of force and torque, as the device measured it: no bias taken off, its own axes and signs.

    Attributes:
        time_ns: when it arrived, on the host's monotonic clock [ns].
        force_n: along the device's x, y, z [N].
        torque_nm: about them [Nm].
        fault: what the device says is wrong with the sample, such as "saturated"; empty where nothing is. A
            faulty sample's numbers mean nothing.
    """

    time_ns: int
    force_n: tuple[float, float, float]
    torque_nm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fault: str = ""


@dataclass(frozen=True, slots=True)
class Travel:
    """Reach, speed and stopping of a stage.

    Attributes:
        least_m, greatest_m: where it may be sent [m].
        top_speed_m_s: its greatest speed [m/s].
        acceleration_m_s2: at which it stops [m/s^2].
        latency_s: between asking it to stop and its starting to slow down [s].
    """

    least_m: Position
    greatest_m: Position
    top_speed_m_s: float
    acceleration_m_s2: float
    latency_s: float

    def overshoot_m(self, speed_m_s: float, before_s: float = 0.0) -> float:
        """Distance that it still goes after being told to stop, v^2 / 2a + v latency [m].

        Args:
            speed_m_s: at which it moves.
            before_s: what passes before it is told, such as the way of a force to who tells it; counted as
                latency [s].
        """
        return speed_m_s**2 / (2 * self.acceleration_m_s2) + speed_m_s * (self.latency_s + before_s)


@runtime_checkable
class Stage(Protocol):
    """Moves the probe against the skin, or the skin against the probe. One move at a time."""

    @property
    def travel(self) -> Travel:
        """Its reach, speed and stopping."""

    def position_m(self) -> Position:
        """Position now, also on its way [m]."""

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        """Start moving in a straight line, and return at once."""

    def moving(self) -> bool:
        """True while the last move is under way."""

    def stop(self) -> None:
        """Slow down to a stand at once and forget the move; returns when it stands, its position known.

        Safe at any time and from any thread; does nothing where it stands.
        """

    def close(self) -> None:
        """Stop, and let go of the device."""


@runtime_checkable
class ForceSensor(Protocol):
    """Measures force and torque all the time, by itself."""

    @property
    def rate_hz(self) -> float:
        """Samples a second."""

    @property
    def range_n(self) -> tuple[float, float, float]:
        """Greatest force along each axis that it can measure, to either side [N]."""

    def latest(self) -> Wrench:
        """The newest sample, which may be old: its time tells."""

    def drain(self) -> list[Wrench]:
        """All samples since the last call, oldest first."""

    def close(self) -> None:
        """Stop measuring and let go of the device."""


@runtime_checkable
class Camera(Protocol):
    """Takes frames all the time, by itself."""

    @property
    def rate_hz(self) -> float:
        """Frames a second."""

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of every frame [px]."""

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        """The next frame that is exposed wholly after this call, and when its exposure ended [ns]."""

    def close(self) -> None:
        """Let go of the device."""


@runtime_checkable
class FrameSource(Camera, Protocol):
    """A camera that also hands out what it took meanwhile, without waiting."""

    def drain(self) -> list[tuple[int, Frame]]:
        """All frames since the last call or `grab`, oldest first, each with when its exposure ended [ns]."""


@dataclass(frozen=True, slots=True)
class DisplayRange:
    """What a contact-area display is and can do.

    Attributes:
        height_m: way of its tip until it is flat [m].
        radius_m: of its base [m].
        greatest_pa: gauge pressure that its chamber may hold [Pa].
        watchdog_s: time without a new pressure after which the device vents by itself, whatever becomes of
            the program [s].
    """

    height_m: float
    radius_m: float
    greatest_pa: float
    watchdog_s: float


@dataclass(frozen=True, slots=True)
class DisplaySample:
    """One state of a contact-area display, as its own sensors measured it.

    Attributes:
        time_ns: when it was measured, on the host's monotonic clock [ns].
        pushed_m: displacement of the tip, 0 where nobody presses [m].
        pressure_pa: gauge pressure of the chamber [Pa].
        fault: what the device says is wrong, such as "supply pressure low"; empty where nothing is. A faulty
            sample's numbers mean nothing.
    """

    time_ns: int
    pushed_m: float
    pressure_pa: float
    fault: str = ""


@runtime_checkable
class SoftnessDevice(Protocol):
    """Contact-area display: a chamber whose pressure sets how fast contact area grows with force."""

    @property
    def range(self) -> DisplayRange:
        """Shape, greatest pressure and watchdog."""

    def latest(self) -> DisplaySample:
        """Its state now."""

    def set_pressure(self, pressure_pa: float, rate_pa_s: float = 0.0) -> None:
        """Hold a gauge pressure from now on, until the next call or the watchdog; returns at once.

        Args:
            pressure_pa: of the chamber, from 0 to the greatest [Pa].
            rate_pa_s: at which it will go on changing, for a servo that can use it [Pa/s].
        """

    def vent(self) -> None:
        """Open the chamber to the air, and keep it open until `release`.

        Safe at any time and from any thread.
        """

    def release(self) -> None:
        """Let it hold pressure again after `vent`; the pressure stays 0 until it is set."""

    def close(self) -> None:
        """Vent, and let go of the device."""


@dataclass(frozen=True, slots=True)
class ArmRange:
    """What a haptic arm can do along the axis of the press.

    Attributes:
        least_m, greatest_m: displacement that it reaches [m].
        force_n: greatest force, to either side [N].
        watchdog_s: time without a new force after which the device drops it by itself [s].
    """

    least_m: float
    greatest_m: float
    force_n: float
    watchdog_s: float


@dataclass(frozen=True, slots=True)
class ArmSample:
    """One state of a haptic arm, as its own sensors measured it.

    Attributes:
        time_ns: when it was measured, on the host's monotonic clock [ns].
        displacement_m: from where the finger touches first, positive the way it presses [m].
        velocity_m_s: of it [m/s].
        fault: what the device says is wrong, such as "motor saturated"; empty where nothing is.
    """

    time_ns: int
    displacement_m: float
    velocity_m_s: float
    fault: str = ""


@runtime_checkable
class HapticArm(Protocol):
    """Arm that carries the display and takes forces along the axis of the press."""

    @property
    def range(self) -> ArmRange:
        """Reach, greatest force and watchdog."""

    def latest(self) -> ArmSample:
        """Its state now."""

    def set_force(self, force_n: float) -> None:
        """Push with a force, its own weight carried beside, until the next call or the watchdog.

        Args:
            force_n: positive against the finger's press [N].
        """

    def brake(self) -> None:
        """Drop the force and brake, until `release`. Safe at any time and from any thread."""

    def release(self) -> None:
        """Let it take forces again after `brake`; the force stays 0 until it is set."""

    def close(self) -> None:
        """Brake, and let go of the device."""
