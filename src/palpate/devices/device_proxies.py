"""Proxies of devices: watchers see what passes, an emergency stop holds the stage, and errors have one kind.

The engine uses them as it uses any other device: nothing is taken from it, delayed or changed, but that an
error of a driver's own becomes a `DeviceError`, and a force that is no number a faulty sample.

Proxies of a contact-area display and a haptic arm, which the same emergency stop holds as a stage.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from palpate.core import (
    NS_PER_S,
    ArmRange,
    ArmSample,
    Clock,
    DeviceError,
    DisplayRange,
    DisplaySample,
    ForceSensor,
    Frame,
    FrameSource,
    HapticArm,
    PalpateError,
    Position,
    SoftnessDevice,
    Stage,
    Travel,
    Wrench,
)
from palpate.core.plugins import told
from palpate.devices.operator_control import OperatorCommand, OperatorInterrupt

KEPT_S = 20.0  # of force, for the plot
MAX_SAMPLES = 50_000  # samples, however fast they come
RATE_S = 2.0  # over which rates are counted
SENT_S = 1.0  # in which a stage that answers has taken in a move


@runtime_checkable
class Closable(Protocol):
    """What a proxy asks of any device."""

    def close(self) -> None: ...


Device = TypeVar("Device", bound=Closable)
Sampler = TypeVar("Sampler", ForceSensor, FrameSource)
Held = TypeVar("Held", bound=Closable)


class _Proxy(Generic[Device]):
    """Passes calls on to a device, and remembers how the last one went."""

    def __init__(self, inner: Device, clock: Clock) -> None:
        self._inner: Device = inner
        self._clock = clock
        self.error = ""

    def close(self) -> None:
        """Let go of the device."""
        self._inner.close()

    @contextmanager
    def _noting_errors(self) -> Iterator[None]:
        try:
            yield
        except DeviceError as e:
            self.error = str(e)
            raise
        self.error = ""


class _SamplerProxy(_Proxy[Sampler]):
    _newest_came: tuple[float, float] | None = None  # real time, and how late by the rig's clock [s]

    @property
    def rate_hz(self) -> float:
        return self._inner.rate_hz

    def age_s(self) -> float | None:
        """Age of the newest that was drained or grabbed [s]; None where nothing was."""
        if self._newest_came is None:
            return None
        came_s, late_s = self._newest_came
        return time.monotonic() - came_s + late_s

    def _date(self, time_ns: int) -> None:
        late_s = (self._clock.now_ns() - time_ns) / NS_PER_S
        self._newest_came = (time.monotonic(), max(late_s, 0.0))


class ForceProxy(_SamplerProxy[ForceSensor]):
    """Implements `core.ForceSensor`; keeps the last samples that somebody drained."""

    def __init__(self, inner: ForceSensor, clock: Clock) -> None:
        super().__init__(inner, clock)
        self._lock = threading.Lock()
        self._recent: deque[Wrench] = deque(maxlen=MAX_SAMPLES)
        self.newest: Wrench | None = None

    @property
    def range_n(self) -> tuple[float, float, float]:
        return self._inner.range_n

    def latest(self) -> Wrench:
        with self._noting_errors():
            self.newest = self._inner.latest()
        return self.newest

    def drain(self) -> list[Wrench]:
        with self._noting_errors():
            samples = self._inner.drain()
        if samples:
            self._date(samples[-1].time_ns)
        with self._lock:
            self._recent.extend(samples)
            oldest = self._clock.now_ns() - KEPT_S * NS_PER_S
            while self._recent and self._recent[0].time_ns < oldest:
                self._recent.popleft()
        return samples

    def recent(self) -> list[Wrench]:
        """The last `KEPT_S` seconds, oldest first."""
        with self._lock:
            return list(self._recent)


class CameraProxy(_SamplerProxy[FrameSource]):
    """Implements `core.FrameSource`; keeps the newest frame, and when the last ones came."""

    def __init__(self, inner: FrameSource, clock: Clock) -> None:
        super().__init__(inner, clock)
        self._turn = threading.Lock()
        self._came: deque[int] = deque(maxlen=1000)
        self.newest: tuple[int, Frame] | None = None
        self.count = 0

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of a frame, as the device states it [px]."""
        return self._inner.size_px

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        with self._turn, self._noting_errors():
            frame = self._inner.grab(timeout_s)
            self._keep([frame])
        return frame

    def drain(self) -> list[tuple[int, Frame]]:
        with self._turn, self._noting_errors():
            frames = self._inner.drain()
            self._keep(frames)
        return frames

    def recent_count(self, now_ns: int) -> int:
        """Number of frames that came in the last `RATE_S` seconds."""
        return sum(now_ns - at <= RATE_S * NS_PER_S for at in tuple(self._came))

    def _keep(self, frames: list[tuple[int, Frame]]) -> None:
        if frames:
            self._came.extend(time_ns for time_ns, _ in frames)
            self.newest = frames[-1]
            self._date(frames[-1][0])
            self.count += len(frames)


class HeldProxy(_Proxy[Held]):
    """A device that an emergency stop holds: from then on it does nothing for anybody until it is released.

    Whatever presses something goes through one of these, a stage as well as a display or an arm.
    """

    def __init__(self, inner: Held, clock: Clock) -> None:
        super().__init__(inner, clock)
        self._sending = threading.Lock()
        self._sent = 0
        self.held = False

    def make_safe(self) -> None:
        """Bring the device to where it presses nothing any further."""
        raise NotImplementedError

    def hold(self) -> int:
        """Emergency stop, past everything else; returns when it was safe [ns], and nothing moves it any more.

        Raises:
            DeviceError: the device could not be made safe.
        """
        self.held, before = True, self._sent
        self.make_safe()
        safe_ns = self._clock.now_ns()
        if self._sending.acquire(timeout=SENT_S):
            self._sending.release()
        if self._sent != before:  # an order had passed the check just before
            self.make_safe()
            safe_ns = self._clock.now_ns()
        return safe_ns

    def release(self) -> None:
        """Let it act again; so does a supervisor that held it as well."""
        if callable(release := getattr(self._inner, "release", None)):
            release()
        self.held = False

    @contextmanager
    def _ordering(self) -> Iterator[None]:
        """Around an order that makes the device act."""
        with self._sending:
            self._check_free()
            with self._noting_errors():
                yield
                self._sent += 1

    def _check_free(self) -> None:
        if self.held:
            raise OperatorInterrupt(OperatorCommand.ESTOP)


class StageProxy(HeldProxy[Stage]):
    """Implements `core.Stage`; after an emergency stop it moves for nobody until it is released."""

    @property
    def travel(self) -> Travel:
        return self._inner.travel

    def position_m(self) -> Position:
        with self._noting_errors():
            return self._inner.position_m()

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        """Start moving, unless it is held.

        Raises:
            OperatorInterrupt: an emergency stop holds it.
        """
        with self._ordering():
            self._inner.move_to(position_m, speed_m_s)

    def moving(self) -> bool:
        self._check_free()
        with self._noting_errors():
            return self._inner.moving()

    def stop(self) -> None:
        """Bring it to a stand."""
        with self._noting_errors():
            self._inner.stop()

    make_safe = stop

    @property
    def health(self) -> str:
        """What was lost on the wire, of a driver that counts it; empty where nothing was."""
        health = getattr(self._inner, "health", "")
        return health if isinstance(health, str) else ""


@runtime_checkable
class Actuator(Protocol):
    """Goes to a position in straight moves, one at a time, and stops when told: what moves of a `core.Stage`.

    See there for units, errors and what may be called from another thread.
    """

    @property
    def travel(self) -> Travel: ...
    def position_m(self) -> Position: ...
    def move_to(self, position_m: Position, speed_m_s: float) -> None: ...
    def moving(self) -> bool: ...
    def stop(self) -> None: ...


@runtime_checkable
class ForceSource(Protocol):
    """Measures force all the time: what is asked of a `core.ForceSensor`. See there."""

    def latest(self) -> Wrench: ...
    def drain(self) -> list[Wrench]: ...


class PlainActuator:
    """An `Actuator` whose driver's own exceptions come as `DeviceError`: a guard knows whose they are."""

    def __init__(self, inner: Actuator) -> None:
        self._inner = inner

    @property
    def travel(self) -> Travel:
        return self._inner.travel

    def position_m(self) -> Position:
        with driver_errors("the stage's driver failed"):
            return self._inner.position_m()

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        """Start moving."""
        with driver_errors("the stage's driver failed"):
            self._inner.move_to(position_m, speed_m_s)

    def moving(self) -> bool:
        with driver_errors("the stage's driver failed"):
            return self._inner.moving()

    def stop(self) -> None:
        """Bring it to a stand."""
        with driver_errors("the stage's driver failed"):
            self._inner.stop()


class PlainForceSource:
    """A `ForceSource`: its driver's own exceptions come as `DeviceError`, what is no number as a fault."""

    def __init__(self, inner: ForceSource) -> None:
        self._inner = inner

    @property
    def rate_hz(self) -> float:
        inner: Any = self._inner
        return float(inner.rate_hz)

    @property
    def delay_s(self) -> float:
        """Delay of its samples that a slow sensor states beside the protocol; 0 where it states none [s]."""
        return float(getattr(self._inner, "delay_s", 0.0))

    def latest(self) -> Wrench:
        with driver_errors("the force sensor's driver failed"):
            return _plain(self._inner.latest())

    def drain(self) -> list[Wrench]:
        with driver_errors("the force sensor's driver failed"):
            return [_plain(one) for one in self._inner.drain()]


@contextmanager
def driver_errors(what: str) -> Iterator[None]:
    """Raise as `DeviceError` what is neither palpate's own nor the operator's.

    Args:
        what: has failed, for the message.
    """
    try:
        yield
    except (PalpateError, OperatorInterrupt, KeyboardInterrupt):
        raise
    except BaseException as e:  # what is somebody else's may raise anything
        raise DeviceError(f"{what}: {told(e)}", code="driver-failed") from e


def _plain(sample: Wrench) -> Wrench:
    if sample.fault or all(math.isfinite(value) for value in (*sample.force_n, *sample.torque_nm)):
        return sample
    return replace(sample, fault="a force or torque that is not a number")


DISPLAY_FAILED = "the display's driver failed"
ARM_FAILED = "the arm's driver failed"


class DisplayProxy(HeldProxy[SoftnessDevice]):
    """Implements `core.SoftnessDevice`; after an emergency stop it is vented, and stays so until released."""

    @property
    def range(self) -> DisplayRange:
        """Shape, greatest pressure and watchdog."""
        return self._inner.range

    def latest(self) -> DisplaySample:
        with self._noting_errors(), driver_errors(DISPLAY_FAILED):
            return self._inner.latest()

    def set_pressure(self, pressure_pa: float, rate_pa_s: float = 0.0) -> None:
        """Hold a pressure, unless it is held."""
        with self._ordering(), driver_errors(DISPLAY_FAILED):
            self._inner.set_pressure(pressure_pa, rate_pa_s)

    def vent(self) -> None:
        """Open the chamber to the air."""
        with self._noting_errors(), driver_errors(DISPLAY_FAILED):
            self._inner.vent()

    make_safe = vent


class ArmProxy(HeldProxy[HapticArm]):
    """Implements `core.HapticArm`; after an emergency stop it brakes, and goes on to until released."""

    @property
    def range(self) -> ArmRange:
        """Reach, greatest force and watchdog."""
        return self._inner.range

    def latest(self) -> ArmSample:
        with self._noting_errors(), driver_errors(ARM_FAILED):
            return self._inner.latest()

    def set_force(self, force_n: float) -> None:
        """Push with a force, unless it is held."""
        with self._ordering(), driver_errors(ARM_FAILED):
            self._inner.set_force(force_n)

    def brake(self) -> None:
        """Drop the force and brake."""
        with self._noting_errors(), driver_errors(ARM_FAILED):
            self._inner.brake()

    make_safe = brake
