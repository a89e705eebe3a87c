"""A virtual stage: straight moves with finite acceleration, one at a time."""

from __future__ import annotations

import math

from palpate.core import DeviceError, Position, RangeError, Travel
from palpate.rig.virtual.linear_rig import Motion, standing
from palpate.rig.virtual.virtual_world import World, halted

SLIP_M = 0.1e-3  # that a slipping stage loses of every move along z


class VirtualStage:
    """Implements `core.Stage`."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._closed = False

    @property
    def travel(self) -> Travel:
        return self._world.travel

    def position_m(self) -> Position:
        self._check_there()
        return self._world.stand_at()

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        """Start moving, and return at once."""
        self._check_there()
        travel, world = self.travel, self._world
        for axis, at, low, high in zip("xyz", position_m, travel.least_m, travel.greatest_m, strict=True):
            if not low <= at <= high:
                raise RangeError(
                    f"{axis} = {at * 1e3:.3f} mm lies outside the stage's travel, {low * 1e3:g} to "
                    f"{high * 1e3:g} mm"
                )
        if not (math.isfinite(speed_m_s) and 0 < speed_m_s <= travel.top_speed_m_s):
            raise RangeError(
                f"a speed of {speed_m_s * 1e3:g} mm/s; the stage does {travel.top_speed_m_s * 1e3:g} mm/s"
            )
        with world.lock:
            if self.moving():
                raise DeviceError("the stage is moving already; stop it, or wait until it stands")
            start = world.stand_at()
            if world.faults.on("stage-slips", world.clock.now_ns()) and position_m[2] > start[2]:
                position_m = (position_m[0], position_m[1], max(start[2], position_m[2] - SLIP_M))
            world.move(Motion(start, position_m, speed_m_s, travel.acceleration_m_s2, world.now_s))

    def moving(self) -> bool:
        self._check_there()
        if self._world.faults.on("stage-stuck", self._world.clock.now_ns()):
            return True
        return self._world.now_s < self._world.motion.ends_s

    def stop(self) -> None:
        """Slow down at once; returns when it stands."""
        world = self._world
        self._check_there()
        if world.faults.on("stage-deaf", world.clock.now_ns()):
            raise DeviceError("the stage does not answer to a stop")
        with world.lock:
            motion = world.motion
            if world.now_s >= motion.ends_s:
                return
            world.advance()
            braking = halted(motion, world.now_s + self.travel.latency_s)
            world.move(braking)
        while world.now_s < braking.ends_s:
            world.clock.sleep(max(braking.ends_s - world.now_s, 1e-6))
        with world.lock:
            world.advance()
            world.move(standing(world.stand_at(), world.now_s))

    def close(self) -> None:
        """Stop, and let go."""
        if self._closed:
            return
        try:
            self.stop()
        finally:
            self._closed = True

    def _check_there(self) -> None:
        if self._closed:
            raise DeviceError("the stage is closed")
        if self._world.faults.on("stage-gone", self._world.clock.now_ns()):
            raise DeviceError("the stage does not answer")
