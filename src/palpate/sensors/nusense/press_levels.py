"""Straight presses of a round tip interpolated between cached depths, for live frames.

Levels are equally spaced in the square root of depth, as the contact radius is. Lagrange cubics through four
levels give motion, force, and radius; the contact is the nearest level's, scaled.
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

STEP_ROOT_M = 0.0025  # step of the square root of depth [m^(1/2)]: level 1 is 6 µm, level 18 is 2 mm
CUBIC = 4  # levels of an interpolation


class PressLevel(NamedTuple):
    """Press of the relaxed pad at one depth, and the tiles' motion."""

    contact: Contact
    motion: PatternMotion


@dataclass(frozen=True)
class PressLevels:
    """Presses of one round tip straight into one pad, to `deepest_m`."""

    stack: Stack
    interface: int
    probe: Probe
    deepest_m: float

    def contact(self, pose: Pose, history: PressHistory) -> Contact:
        """Contact at a pose; force and radius are interpolated, the rest is the nearest level's."""
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
        first, weights = self._about(pose.depth_m)
        knots = sum(w * self._level(first + k).motion.knots for k, w in enumerate(weights))
        return replace(self._level(first).motion, centre_m=(pose.x_m, pose.y_m), knots=np.asarray(knots))

    def solve(self) -> None:
        """Solve all levels."""
        for level in range(self._last + 1):
            self._level(level)

    @property
    def _last(self) -> int:
        return max(math.ceil(math.sqrt(self.deepest_m) / STEP_ROOT_M), CUBIC - 1)

    def _about(self, depth_m: float) -> tuple[int, Float[ndarray, " 4"]]:
        """First of the four levels around a depth, and Lagrange weights."""
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
    """Return whether a press is of a sphere without lateral load."""
    if history.lateral_n is not None:
        return probe.shape == "sphere" and history.lateral_n == (0.0, 0.0)
    return probe.shape == "sphere" and (not history.path_m or history.path_m[-1] == (0.0, 0.0))


@lru_cache(maxsize=128)
def press_level(stack: Stack, interface: int, probe: Probe, level: int) -> PressLevel:
    """Return the press at a level (cached); level 0 does not touch."""
    pose = Pose(0.0, 0.0, (level * STEP_ROOT_M) ** 2)
    contact = pad_contact(stack, 0.0, probe, pose, PressHistory())
    return PressLevel(contact, pattern_motion(stack, interface, contact))


def _laid(weights: Float[ndarray, " 4"], values: Sequence[float]) -> float:
    return float(weights @ np.array(values))
