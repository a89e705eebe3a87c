"""Virtual force sensor and camera beside a real stage, or a simulator of its firmware: they follow its place.

So a stage is tried with a whole plan before there is a skin, a force sensor or a camera. Each device has a
world of its own, which asks the stage for its place whenever it is asked itself, and takes it to have gone
straight from one place to the next. Two devices of the same seed feel and see the same skin.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from palpate.core import Clock, DeviceError, Float, Position, Stage, ndarray
from palpate.core.sensor import for_rig, sensor as sensor_of
from palpate.rig.virtual.virtual_bench import FORCE_HZ, default_variation
from palpate.rig.virtual.virtual_world import KEPT_S, World

AIR_M = 5e-3  # above the skin: where the probe is taken to be before the stage knows its place


class FollowedWorld(World):
    """World whose probe is wherever a stage says that it is.

    Args:
        stage: that is asked; what it cannot answer, as before it is homed, leaves the probe where it was.
        design: name of the sensor's design.
        clock: time.
        origin_m: expected surface of the skin, in the stage's frame [m].
        seed: of all that varies.
        askew_m: where the skin lies, from where it is expected.
    """

    def __init__(
        self, stage: Stage, design: str, clock: Clock, origin_m: Position, seed: int, askew_m: Position
    ) -> None:
        sensor = for_rig(sensor_of(design))
        self._followed = stage
        self._track: deque[tuple[float, Position]] = deque()
        vary = replace(default_variation(sensor, design), backlash_m=0.0)  # the stage has its own
        super().__init__(
            sensor, clock, stage.travel, origin_m, vary, FORCE_HZ, seed, faults=(), askew_m=askew_m
        )
        x, y, z = origin_m
        self._track.append((self.now_s, (x, y, max(stage.travel.least_m[2], z - AIR_M))))

    def advance(self) -> None:
        """Bring everything up to the clock's time, the stage's place first."""
        with self.lock:
            self._look()
            super().advance()

    def _look(self) -> None:
        try:
            place = self._followed.position_m()
        except DeviceError:
            place = self._track[-1][1]
        self._track.append((self.now_s, place))
        while len(self._track) > 2 and self._track[1][0] < self.now_s - KEPT_S:
            self._track.popleft()

    def _targets(self, times: Float[ndarray, " n"]) -> Float[ndarray, "n 3"]:
        at_s = [time_s for time_s, _ in self._track]
        places = np.array([place for _, place in self._track])
        return np.stack([np.interp(times, at_s, places[:, axis]) for axis in range(3)], axis=1)
