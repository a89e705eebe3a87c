"""Head-on presses of a round tip at any depth, from some that are solved once and kept: for live frames.

Layers are endless along x and y, so that a press is the same at every place, and without a lateral load only
its depth tells it from another. Levels of depth are as far apart as their square roots are equally so, as the
contact's radius is, in which motion and force are smooth down to the first touch. Between levels, Lagrange's
cubic through the four about a depth gives the motion; the contact is that of the nearest level, stretched to
the radius and scaled to the force in between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from palpate.core import Contact, Float, Pose, PressHistory, Probe, ndarray
from palpate.mechanics.layers.stack import Stack
from palpate.sensors.nusense.pad_contact import pad_contact
from palpate.sensors.nusense.pattern_motion import PatternMotion, pattern_motion

STEP_ROOT_M = 0.0025
"""Step of a depth's square root from level to level [m^(1/2)]: the first is at 6 µm, the 18th at 2 mm."""
CUBIC = 4  # levels that a depth is laid through


class PressLevel(NamedTuple):
    """Press of the relaxed pad at one depth, about the tip's axis, and the tiles' motion under it."""

    contact: Contact
    motion: PatternMotion


@dataclass(frozen=True)
class PressLevels:
    """Presses of one round tip straight into one pad.

    Attributes:
        stack: the pad.
        interface: number of layers above the tiles' lower face.
        probe: a sphere.
        deepest_m: of the presses asked for.
    """

    stack: Stack
    interface: int
    probe: Probe
    deepest_m: float

    def contact(self, pose: Pose, history: PressHistory) -> Contact:
        """The contact at a pose; force and radius are laid between levels, the rest is the nearest's."""
        first, weights = self._about(pose.depth_m)
        levels = [self._level(first + k).contact for k in range(CUBIC)]
        force = _laid(weights, [one.force_n for one in levels])
        radius = _laid(weights, [one.radius_m for one in levels])
        near = self._level(max(round(math.sqrt(pose.depth_m) / STEP_ROOT_M), 1)).contact
        wider, stiff = radius / near.radius_m, history.stiffening
        return replace(
            near,
            x_m=pose.x_m + wider * near.x_m,
            y_m=pose.y_m + wider * near.y_m,
            pressure_pa=near.pressure_pa * (stiff * force / near.force_n / wider**2),
            displacement_m=near.displacement_m * (pose.depth_m / near.pose.depth_m),
            force_n=force * stiff,
            radius_m=radius,
            pose=pose,
            history=history,
        )

    def motion(self, pose: Pose) -> PatternMotion:
        """The tiles' motion at a pose."""
        first, weights = self._about(pose.depth_m)
        knots = sum(w * self._level(first + k).motion.knots for k, w in enumerate(weights))
        return replace(self._level(first).motion, centre_m=(pose.x_m, pose.y_m), knots=np.asarray(knots))

    def solve(self) -> None:
        """Solve all levels now, so that no press waits for one."""
        for level in range(self._last + 1):
            self._level(level)

    @property
    def _last(self) -> int:
        return max(math.ceil(math.sqrt(self.deepest_m) / STEP_ROOT_M), CUBIC - 1)

    def _about(self, depth_m: float) -> tuple[int, Float[ndarray, " 4"]]:
        """First of the four levels about a depth, and Lagrange's weights of all four."""
        place = math.sqrt(depth_m) / STEP_ROOT_M
        first = min(max(math.floor(place) - 1, 0), self._last - CUBIC + 1)
        t = place - first
        weights = [
            -(t - 1) * (t - 2) * (t - 3) / 6,
            t * (t - 2) * (t - 3) / 2,
            -t * (t - 1) * (t - 3) / 2,
            t * (t - 1) * (t - 2) / 6,
        ]
        return first, np.array(weights)

    def _level(self, level: int) -> PressLevel:
        return press_level(self.stack, self.interface, self.probe, level)


def goes_straight_down(probe: Probe, history: PressHistory) -> bool:
    """Whether a press is one of these: of a sphere, and not pulled aside."""
    if history.lateral_n is not None:
        return probe.shape == "sphere" and history.lateral_n == (0.0, 0.0)
    return probe.shape == "sphere" and (not history.path_m or history.path_m[-1] == (0.0, 0.0))


@lru_cache(maxsize=128)
def press_level(stack: Stack, interface: int, probe: Probe, level: int) -> PressLevel:
    """The press at a level, which is solved once; nothing touches at level 0."""
    pose = Pose(0.0, 0.0, (level * STEP_ROOT_M) ** 2)
    contact = pad_contact(stack, 0.0, probe, pose, PressHistory())
    return PressLevel(contact, pattern_motion(stack, interface, contact))


def _laid(weights: Float[ndarray, " 4"], values: Sequence[float]) -> float:
    return float(weights @ np.array(values))
