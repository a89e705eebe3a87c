"""A virtual camera: frames at a rate, with exposure, jitter and transport, of what the palm shows then."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from palpate.core.clock import NS_PER_S
from palpate.core.contact import Pose
from palpate.core.errors import DeviceError, RangeError
from palpate.core.frame import Frame
from palpate.rig.virtual.world import KEPT_S, Touch, World
from palpate.sensors import palm

TRANSPORT_S = 0.008  # from the end of an exposure to the frame's arrival, which is what stamps it
STEP_M = 1e-6  # to which depth is rounded, so that the frames of a burst share one picture
STEP_AIR_M = 20e-6  # and the height of a probe in the air
STEP_STIFFNESS = 0.005  # and the skin's stiffness


class VirtualCamera:
    """Implements `rig.FrameSource`."""

    def __init__(self, world: World, rate_hz: float = 30.0) -> None:
        self._world = world
        self._rate_hz = rate_hz
        self._rng = np.random.default_rng([world.seed & 0xFFFFFFFF, 0xCA])
        self._next = int(np.floor(world.now_s * rate_hz)) + 1
        self._frozen: Frame | None = None
        self._closed = False

    @property
    def rate_hz(self) -> float:
        """Frames a second."""
        return self._rate_hz

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self._world.spec.frame_px

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        """The next frame that is exposed wholly after this call."""
        world = self._world
        begun_s = world.now_s
        exposure = world.spec.exposure_s
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

    def drain(self) -> list[tuple[int, Frame]]:
        """All frames that have arrived since the last call; of the last seconds at most."""
        world = self._world
        last = int(np.floor((world.now_s - TRANSPORT_S) * self._rate_hz))
        first = max(self._next, int(np.ceil((world.now_s - KEPT_S) * self._rate_hz)))
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
        touch = world.touch_at(ends_s - world.spec.exposure_s / 2)
        frame = replace(self._seen(touch), time_s=ends_s)
        if world.faults.on("camera-resized", now_ns):
            frame = replace(frame, image=np.ascontiguousarray(frame.image[:-8]))
        self._frozen = frame
        return frame

    def _seen(self, touch: Touch | None) -> Frame:
        spec = self._world.spec
        depth_m, lateral, lamp = 0.0, (0.0, 0.0), 1.0
        pose = Pose(0.0, 0.0, 0.0)
        if touch is not None:
            step = STEP_M if touch.depth_m > 0 else STEP_AIR_M
            # Never 0 exactly, which would show no probe at all.
            depth_m = (math.floor(touch.depth_m / step) + 0.5) * step
            pose = Pose(touch.x_m, touch.y_m, depth_m)
            lamp = touch.approach.lamp_gain
            stiff = round(touch.stiffening / STEP_STIFFNESS) * STEP_STIFFNESS
            if depth_m > 0 and stiff > 0:  # light sees stress, which relaxes as the force does
                spec = replace(spec, youngs_modulus_pa=spec.youngs_modulus_pa * stiff)
        spec = replace(spec, lamp_gain=spec.lamp_gain * lamp)
        try:
            contact = palm.press(spec, pose, None, lateral)
        except RangeError:  # over the rim or beyond the table: drawn as far as it goes
            contact = palm.press(spec, Pose(0.0, 0.0, 0.0))
        return palm.render(contact, spec, self._rng)
