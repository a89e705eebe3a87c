"""A virtual camera: frames at a rate, with exposure, jitter and transport, of what the sensor shows then."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from palpate.core import (
    NS_PER_S,
    Contact,
    DeviceError,
    Frame,
    Pose,
    PressHistory,
    RangeError,
    Seating,
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
