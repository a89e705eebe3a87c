"""Observed rig whose stage is the GRBL driver on a fake controller; the virtual skin feels its true place.

Time is real time whose sleeps are skipped, so that the driver's own threads and waits are as they are in
earnest, and a press takes a second. Ways are counted from the fake's own place, tick by tick.
"""

from __future__ import annotations

import math
import threading
import time
from bisect import bisect_right
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from tests.fakes.grbl_controller import CANCEL, DOOR, HOLD
from tests.fakes.grbl_firmware import GrblFirmware
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.rig.fault_matrix.observed_rig import LEVEL_M, NEAR_M, ObservedRig, Stopped

from palpate.core import NS_PER_S, Frame, Position
from palpate.devices import Limits
from palpate.rig.plans import StepHold
from palpate.rig.real.gcode_spec import Mount
from palpate.rig.real.grbl.grbl_stage import GrblStage
from palpate.rig.real.grbl.grbl_supervisor import GrblSpec

LATENCY_S = 0.02  # of the fake, from a byte to its effect
STATED_S = 0.05  # by the driver: from asking to the effect, on a machine with other work
READ_S = 0.005
TICK_S = 0.002  # of the fake, at which it takes a byte up
START_M = (0.0, 0.0, -2e-3)
SETTLES_S = 10.0  # of real time
STOPS = (CANCEL, HOLD, DOOR)


class SkippingClock:
    """Real time, of which every sleep is skipped: an answer is waited for, an instant is not."""

    def __init__(self, begun_ns: int) -> None:
        self._ahead_ns = begun_ns - time.monotonic_ns()
        self.skipped: Callable[[], None] = lambda: None

    def now_ns(self) -> int:
        return time.monotonic_ns() + self._ahead_ns

    def sleep(self, seconds: float) -> None:
        self._ahead_ns += round(seconds * NS_PER_S)
        self.skipped()
        time.sleep(0)  # let the driver's threads have their turn


class DirectPort:
    """A serial port with the fake at its other end; all bytes are there at once, and time is the clock's."""

    def __init__(self, device: LoggedFirmware, clock: SkippingClock) -> None:
        self.lock = threading.RLock()
        self._device, self._clock, self._news = device, clock, threading.Condition(self.lock)
        self._bytes = bytearray()
        self.is_gone = False
        clock.skipped = self.catch_up

    @property
    def in_waiting(self) -> int:
        return len(self._bytes)

    def read(self, size: int = 1) -> bytes:
        with self._news:
            if not self._bytes:
                self._news.wait(READ_S)
            self.catch_up()
            self._check()
            data = bytes(self._bytes[:size])
            del self._bytes[:size]
        return data

    def write(self, data: bytes) -> int:
        with self._news:
            self._check()
            self.catch_up()
            self._device.receive(data)
            self.catch_up()
        return len(data)

    def close(self) -> None: ...

    def catch_up(self) -> None:
        """Bring the device to now, and what it says to the host."""
        with self._news:
            self._device.run_to(self._clock.now_ns() / NS_PER_S)
            if data := self._device.take():
                self._bytes += data
                self._news.notify_all()

    def _check(self) -> None:
        if self.is_gone:
            raise OSError(5, "Input/output error")


class LoggedFirmware(GrblFirmware):
    """The fake, which keeps its true place at every tick at which it moved."""

    def __init__(self, model: GrblParameters, faults: GrblFaults, now_s: float) -> None:
        self.log: list[tuple[float, Position]] = []
        self.stop_times: list[tuple[float, bool]] = []  # and whether it heeds what was asked
        self.is_foreign = False  # what comes now is not the driver's
        super().__init__(model, faults, now_s)

    def _tick(self, step_s: float) -> None:
        before_s, before = self._now_s - step_s, self.place_mm
        super()._tick(step_s)
        if not self.log or (self.place_mm != before and self.log[-1][0] < before_s - 1e-9):
            self.log.append((before_s, before))  # it stood until then
        if self.place_mm != before:
            self.log.append((self._now_s, self.place_mm))

    def _realtime(self, byte: int) -> None:
        if byte in STOPS and self.speed_mm_s > 0 and not self.is_foreign:
            self.stop_times.append((self._now_s, not (byte == CANCEL and self.faults.deaf_to_cancel)))
        super()._realtime(byte)


class PlainCamera:
    """A camera whose picture grows brighter with the force, drawn at once: time runs on while others draw."""

    def __init__(self, world: Any) -> None:
        self._world, self.rate_hz, self.size_px = world, world.sensor.rate_hz, world.sensor.frame_px
        self._rng = np.random.default_rng(1)
        self._next = 0

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        self._next = max(self._next + 1, math.ceil(self._world.now_s * self.rate_hz) + 1)
        self._world.clock.sleep(max(self._next / self.rate_hz - self._world.now_s, 0.0))
        return self._taken(self._next)

    def drain(self) -> list[tuple[int, Frame]]:
        newest = math.floor(self._world.now_s * self.rate_hz)
        first, self._next = max(self._next + 1, newest - 60), max(newest, self._next)
        return [self._taken(index) for index in range(first, newest + 1)]

    def close(self) -> None: ...

    def _taken(self, index: int) -> tuple[int, Frame]:
        at_s, (width, height) = index / self.rate_hz, self.size_px
        touch = self._world.touch_at(at_s)
        image = self._rng.integers(90, 110, (height, width, 3), dtype=np.uint8)
        image[: height // 2] += np.uint8(0 if touch is None else min(80.0 * touch.force_n[2], 140.0))
        return round(at_s * NS_PER_S), Frame(image, at_s, exposure_s=0.001)


class GrblRig(ObservedRig):
    """The rig with a GRBL stage. Close it.

    Attributes:
        firmware: the fake; hold `terminal.lock` to touch it, caught up.
        driver: the stage as the engine has it, but for what observes it.
    """

    def __init__(self, plan: StepHold, seed: int, firmware: str) -> None:
        super().__init__(plan, seed)
        self._stack = ExitStack()
        self.clock = SkippingClock(self.clock.now_ns())
        self.truth.clock = self.clock
        self.control._clock = self.clock
        model = GrblParameters(firmware=firmware, homed=True, latency_s=LATENCY_S)
        self.firmware = LoggedFirmware(model, GrblFaults(), self.clock.now_ns() / NS_PER_S)
        self.terminal = DirectPort(self.firmware, self.clock)
        spec = GrblSpec(
            "fake", latency_s=STATED_S, boot_s=0.05, reply_s=1.0, status_s=0.02, silence_s=1.0,
            least_m=(-0.03,) * 3, greatest_m=(0.03, 0.03, 0.012),
        )  # fmt: skip
        self.driver = GrblStage(spec, self.terminal, self.clock)
        self._stack.callback(self.driver._link.close)
        self.driver.reference(START_M)
        self._mount: Mount = self.driver._session.mount
        self.stage.inner = self.driver
        self.truth._play = self._played
        self.camera.inner = PlainCamera(self.truth)
        limits = Limits((-0.02,) * 3, (0.02, 0.02, 0.01), age_s=2.0, overshoot_m=0.2e-3, force_n=30.0)
        self.rig = replace(self.rig, clock=self.clock, limits=limits)

    def __enter__(self) -> GrblRig:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def place_m(self) -> Position:
        with self.terminal.lock:
            self.terminal.catch_up()
            return self._mount.sensor_m(self.firmware.place_mm)

    @property
    def ends_m(self) -> tuple[Position, Position]:
        with self.terminal.lock:
            self.terminal.catch_up()
            blocks, at = self.firmware._axes.blocks, self._mount.sensor_m(self.firmware.place_mm)
            if not blocks:
                return at, at
            return self._mount.sensor_m(blocks[0].start_mm), self._mount.sensor_m(blocks[0].end_mm)

    def spoil(self, **faults: Any) -> None:
        """Faults of the fake from now on."""
        with self.terminal.lock:
            self.terminal.catch_up()
            self.firmware.faults = GrblFaults(**faults)

    def say(self, data: bytes) -> None:
        """Bytes from somebody else's programme."""
        with self.terminal.lock:
            self.terminal.catch_up()
            self.firmware.is_foreign = True
            self.firmware.receive(data)
            self.firmware.is_foreign = False

    @property
    def latency_s(self) -> float:
        """From the byte to slowing down, as the fake has it; it takes a byte up at its next tick [s]."""
        return LATENCY_S + TICK_S

    def settle(self) -> None:
        """Let it come to a stand, and take the stops that reached it in motion, with their true ways."""
        end = time.monotonic() + SETTLES_S
        while self.is_moving and time.monotonic() < end and not self.firmware._axes.stuck:
            self.clock.sleep(0.1)
        with self.terminal.lock:
            log, stops = list(self.firmware.log), list(self.firmware.stop_times)
        for at_s, heeded in stops:
            way_mm, speed_mm_s = _way_after(log, at_s)
            self.stops.append((round(at_s * NS_PER_S), Stopped(way_mm * 1e-3, speed_mm_s * 1e-3, heeded)))

    def into_m(self, from_s: float, to_s: float = math.inf, in_air: bool = True) -> float:
        clearance_m = self.rig.origin_m[2] - self.plan.clearance_mm * 1e-3
        with self.terminal.lock:
            log = [(at_s, self._mount.sensor_m(place)) for at_s, place in self.firmware.log]
        way = 0.0
        for (_, a), (at_s, b) in pairwise(log):
            if not from_s < at_s <= to_s or b[2] < a[2] - LEVEL_M:
                continue
            aside = b[2] <= a[2] + LEVEL_M
            if (aside and a[2] > -NEAR_M) or (not aside and (in_air or b[2] > clearance_m + LEVEL_M)):
                way += math.dist(a, b)
        return way

    def _played(self, times: Any) -> Any:
        with self.terminal.lock:
            self.terminal.catch_up()
            log = self.firmware.log
            first = bisect_right(log, float(times[0]), key=lambda one: one[0])
            log = log[max(first - 1, 0) :] or [(0.0, self.firmware.place_mm)]
        at_s = [one for one, _ in log]
        machine = np.array([np.interp(times, at_s, [place[k] for _, place in log]) for k in range(3)])
        return np.array([self._mount.sensor_m(tuple(place)) for place in machine.T.tolist()])

    def _stopping(self, real: Any) -> None:
        real()  # its way is taken from the fake, by `settle`


def _way_after(log: list[tuple[float, Position]], at_s: float) -> tuple[float, float]:
    way, speed = 0.0, 0.0
    for (before_s, a), (now_s, b) in pairwise(log):
        if now_s <= at_s - TICK_S:
            continue
        if a == b and before_s >= at_s:
            break  # it stood
        step = math.dist(a, b)
        way += step * min((now_s - at_s) / (now_s - before_s), 1.0) if now_s > at_s else 0.0
        speed = max(speed, step / (now_s - before_s))
    return way, speed
