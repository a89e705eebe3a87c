"""A virtual force sensor: noise, drift, resolution, latency, and a range beyond which it saturates.

A virtual camera: frames at a rate, with exposure, jitter and transport, of what the sensor shows then.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from palpate.core import (
    NS_PER_S,
    Contact,
    DeviceError,
    Float,
    Frame,
    Pose,
    PressHistory,
    RangeError,
    Seating,
    Wrench,
    ndarray,
    untouched,
)
from palpate.rig.virtual.virtual_world import KEPT_S, Touch, World

TRANSPORT_S = 0.008  # from the end of an exposure to the frame's arrival, which is what stamps it
STEP_M = 1e-6  # to which depth is rounded, so that the frames of a burst share one picture
STEP_AIR_M = 20e-6  # and the height of a probe in the air
STEP_STIFFNESS = 0.005  # and the skin's stiffness
STEP_N = 0.02  # and a lateral load


class VirtualCamera:
    """Implements `rig.FrameSource`."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._rate_hz = rate_hz = world.sensor.rate_hz
        self._rng = np.random.default_rng([world.seed & 0xFFFFFFFF, 0xCA])
        self._next = int(np.floor(world.now_s * rate_hz)) + 1
        self._frozen: Frame | None = None
        self._closed = False

    @property
    def rate_hz(self) -> float:
        return self._rate_hz

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self._world.sensor.frame_px

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        """The next frame that is exposed wholly after this call."""
        world = self._world
        begun_s = world.now_s
        exposure = world.sensor.exposure_s
        index = max(self._next, int(np.ceil((begun_s + exposure) * self._rate_hz)))
        if world.faults.on("camera-drops", world.clock.now_ns()):
            index += index % 2
        self._next = index + 1
        ends_s = index / self._rate_hz
        arrives_s = ends_s + TRANSPORT_S + world.variation.frame_jitter_s * abs(self._rng.standard_normal())
        if arrives_s - begun_s > timeout_s or world.faults.on("camera-stalls", world.clock.now_ns()):
            world.clock.sleep(timeout_s)
            raise DeviceError(f"no frame came within {timeout_s:g} s")
        while world.now_s < arrives_s:
            world.clock.sleep(max(arrives_s - world.now_s, 1e-6))
        return round(arrives_s * NS_PER_S), self._taken(ends_s)

    def drain(self, at_most: int | None = None) -> list[tuple[int, Frame]]:
        """Frames that have arrived since the last call; of the last seconds at most.

        Args:
            at_most: that are drawn and given, the oldest first; those after them are left for the next call.
        """
        world = self._world
        last = int(np.floor((world.now_s - TRANSPORT_S) * self._rate_hz))
        first = max(self._next, int(np.ceil((world.now_s - KEPT_S) * self._rate_hz)))
        if at_most is not None:
            last = min(last, first + at_most - 1)
        self._next = max(self._next, last + 1)
        if world.faults.on("camera-stalls", world.clock.now_ns()):
            return []
        ends = [index / self._rate_hz for index in range(first, last + 1)]
        return [(round((end_s + TRANSPORT_S) * NS_PER_S), self._taken(end_s)) for end_s in ends]

    def close(self) -> None:
        """Let go."""
        self._closed = True

    def _taken(self, ends_s: float) -> Frame:
        world, now_ns = self._world, self._world.clock.now_ns()
        if self._closed or world.faults.on("camera-gone", now_ns):
            raise DeviceError("the camera does not answer")
        if self._frozen is not None and world.faults.on("camera-frozen", now_ns):
            return self._frozen
        touch = world.touch_at(ends_s - world.sensor.exposure_s / 2)
        frame = replace(self._shown(touch), time_s=ends_s)
        if world.faults.on("camera-resized", now_ns):
            frame = replace(frame, image=np.ascontiguousarray(frame.image[:-8]))
        self._frozen = frame
        return frame

    def _shown(self, touch: Touch | None) -> Frame:
        sensor = self._world.sensor
        if touch is None:
            return sensor.render(untouched(sensor), self._rng)
        seating = Seating(touch.approach.lamp_gain, touch.approach.shift_px)
        return sensor.render(self._contact(touch), self._rng, seating)

    def _contact(self, touch: Touch) -> Contact:
        world = self._world
        step = STEP_M if touch.depth_m > 0 else STEP_AIR_M
        # Never 0 exactly, which would show no probe at all.
        pose = Pose(touch.x_m, touch.y_m, (math.floor(touch.depth_m / step) + 0.5) * step)
        try:
            return world.sensor.press(world.probe, pose, world.specimen, self._history(touch, pose))
        except RangeError as e:
            # Beside the rim there is no law: contact is felt there, and a skin at rest drawn.
            if not world.outline.contains(pose.x_m, pose.y_m, world.probe.radius_m):
                return untouched(world.sensor)
            raise DeviceError(f"the virtual camera cannot draw this: {e}") from e

    def _history(self, touch: Touch, pose: Pose) -> PressHistory:
        """A lateral load in steps, as a probe's slight lean is not drawn; and how stiff the skin is still."""
        x, y = (round(n / STEP_N) * STEP_N for n in touch.pulled_n)
        stiff = round(touch.stiffening / STEP_STIFFNESS) * STEP_STIFFNESS
        pulled = (x, y) != (0.0, 0.0)
        return PressHistory(
            path_m=(touch.shift_m,) if pulled else (),
            lateral_n=(x, y),
            stiffening=stiff if pose.depth_m > 0 and stiff > 0 else 1.0,
            earlier=self._world.earlier(touch.time_s),
        )


RANGE_N = (40.0, 40.0, 120.0)
LATENCY_S = 0.002
BIAS_N = (0.31, -0.22, 1.7)
"""Bias: the reading without a load. Assumed."""
KEPT = 100_000
SPIKE_N = 1000.0
NOISIER = 100.0
SCALE = 0.1  # of a sensor whose scale has changed
HELD_BACK_S = 0.08
ONE_IN = 10  # samples of a slow sensor
UNKNOWN = "the virtual skin is pressed deeper than its law is known"

Triple = tuple[float, float, float]
Axes = Float[ndarray, "3"]


class VirtualForce:
    """Implements `core.ForceSensor`, in the skin's own axes.

    Args:
        world: whose contact it feels.
        range_n: to either side along each axis, beyond which it saturates [N].
    """

    def __init__(self, world: World, range_n: Triple = RANGE_N) -> None:
        self._world = world
        self._range_n = range_n
        self._rng = np.random.default_rng([world.seed & 0xFFFFFFFF, 0xF0])
        self._drift = np.zeros(3)
        self._ready: deque[Wrench] = deque(maxlen=KEPT)
        self._coming: deque[Wrench] = deque()
        self._latest: Wrench | None = None
        self._spiked = False
        self._stuck: Triple | None = None
        self._numb: Triple | None = None
        self._closed = False
        world.clock.sleep(0.05)  # so that there is a first sample
        self._take_in()

    @property
    def rate_hz(self) -> float:
        return self._world.rate_hz

    @property
    def range_n(self) -> tuple[float, float, float]:
        return self._range_n

    def latest(self) -> Wrench:
        """The newest sample that has arrived."""
        self._take_in()
        if self._latest is None:
            raise DeviceError("the force sensor has not measured yet")
        return self._latest

    def drain(self) -> list[Wrench]:
        """Samples that have arrived since the last call."""
        self._take_in()
        with self._world.lock:
            fresh = list(self._ready)
            self._ready.clear()
        return fresh

    def close(self) -> None:
        """Let go."""
        self._closed = True

    def _take_in(self) -> None:
        world, now_ns = self._world, self._world.clock.now_ns()
        if self._closed:
            raise DeviceError("the force sensor is closed")
        if world.faults.on("force-gone", now_ns):
            raise DeviceError("the force sensor does not answer")
        with world.lock:
            world.advance()
            for touch in world.fresh():
                wrench = self._measured(touch)
                if wrench is not None:
                    self._coming.append(wrench)
            while self._coming and self._arrives_ns(self._coming[0]) <= now_ns:
                one = self._coming.popleft()
                self._latest = replace(one, time_ns=self._arrives_ns(one))
                self._ready.append(self._latest)

    def _arrives_ns(self, sample: Wrench) -> int:
        """When a sample comes: in its own time, or with all others that were kept [ns]."""
        since_ns = self._world.faults.since("force-held-back")
        if since_ns is None or sample.time_ns < since_ns:
            return sample.time_ns
        kept_ns = round(HELD_BACK_S * NS_PER_S)
        return since_ns + -(-(sample.time_ns - since_ns) // kept_ns) * kept_ns

    def _measured(self, touch: Touch) -> Wrench | None:
        world, vary, on = self._world, self._world.variation, self._world.faults.on
        at_ns = round(touch.time_s * NS_PER_S)
        if on("force-stalls", at_ns) or (
            on("force-slow", at_ns) and round(touch.time_s * world.rate_hz) % ONE_IN
        ):
            return None
        noise = vary.force_noise_n * (NOISIER if on("force-noisy", at_ns) else 1.0)
        self._drift += vary.force_drift_n * np.sqrt(1 / world.rate_hz / 60) * self._rng.standard_normal(3)
        force = self._felt(touch, at_ns) + self._drift + BIAS_N + noise * self._rng.standard_normal(3)
        if on("force-scaled", at_ns):
            force = SCALE * force
        if vary.force_step_n > 0:
            force = np.round(force / vary.force_step_n) * vary.force_step_n
        if on("force-spike", at_ns) and not self._spiked:
            self._spiked = True
            force[2] += SPIKE_N
        saturated = on("force-saturates", at_ns) or (
            not self._spiked and (np.abs(force) > self._range_n).any()
        )
        arrives_ns = at_ns + round(LATENCY_S * NS_PER_S)
        fault = "saturated" if saturated else ""
        fault = fault if touch.known else UNKNOWN
        return Wrench(arrives_ns, self._shown(force, at_ns), fault=fault)

    def _felt(self, touch: Touch, at_ns: int) -> Axes:
        """Force that the sensor feels, along its axes."""
        if self._world.faults.on("force-numb", at_ns):
            self._numb = touch.force_n if self._numb is None else self._numb
            return np.array(self._numb)
        reversed_ = self._world.faults.on("force-reversed", at_ns)
        return np.array(touch.force_n) * (1, 1, -1 if reversed_ else 1)

    def _shown(self, force: Axes, at_ns: int) -> Triple:
        """Reading that it gives of a force that it has measured."""
        if self._world.faults.on("force-dead", at_ns):
            return 0.0, 0.0, 0.0
        x, y, z = force.tolist()
        if not self._world.faults.on("force-stuck", at_ns):
            return x, y, z
        self._stuck = self._stuck or (x, y, z)
        return self._stuck
