"""World whose stage is driven along z by a linear rig: the tip is where motor and load have brought it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palpate.core import Clock, Float, Position, Sensor, Travel, ndarray
from palpate.rig.virtual.disturbances import Variation, approach_of
from palpate.rig.virtual.linear_rig import LinearDrive, LinearRig
from palpate.rig.virtual.virtual_world import Series, World


class DrivenWorld(World):
    """World in which moves of the stage are what its rig is asked for, not what it does.

    A program asks for a place at every sample of force, and the control keeps to it until the next. The
    encoder sees the support itself, so the stage has no backlash beside it.

    Args:
        rig: that drives the tip.
        sensor, clock, travel, origin_m, variation, rate_hz, seed: see `World`.

    Raises:
        InputError: no whole number of the control's ticks lies between two samples.
    """

    def __init__(
        self,
        rig: LinearRig,
        sensor: Sensor,
        clock: Clock,
        travel: Travel,
        origin_m: Position,
        variation: Variation,
        rate_hz: float,
        seed: int,
    ) -> None:
        self.rig = rig
        self._ticks = rig.ticks_in(rate_hz)
        vary = replace(variation, backlash_m=0.0)
        super().__init__(sensor, clock, travel, origin_m, vary, rate_hz, seed, faults=())
        self._drive = LinearDrive(rig, self.motion.start_m[2])
        self._track: list[tuple[float, float]] = []

    def encoder_m(self, times: Series) -> Series:
        """Places as the encoder has them at samples' times [m]."""
        at_s, places = np.array(self._track).T
        return self.rig.read_m(np.interp(times, at_s, places))

    def _targets(self, times: Series) -> Float[ndarray, "n 3"]:
        """Places of the tip at times [m]."""
        targets = super()._targets(times - self._step_s)  # what was asked for until then
        asked_m, law = np.repeat(targets[:, 2], self._ticks), self._skin.law
        places = self._drive.follow(asked_m, law.depth_m, law.force_n, self._surface_m(targets[-1]))
        targets[:, 2] = places[self._ticks - 1 :: self._ticks]
        self._track += zip(times.tolist(), targets[:, 2].tolist(), strict=True)
        return targets

    def _surface_m(self, target: Float[ndarray, " 3"]) -> float:
        """Place at which the tip touches, or will in this approach [m]."""
        approach = self._approach
        if self._lifted:
            x, y = float(target[0] - self._origin[0]), float(target[1] - self._origin[1])
            visit = self._visits.get((round(x * 1e6), round(y * 1e6)), 0)
            approach = approach_of(self.variation, self.seed, x, y, visit)
        return self._origin[2] + approach.height_m
