"""Motion of the tiles under a load on the pad, as in `palpate.mechanics.layers.stack_friction`, with cached
responses.

Straight presses of a round tip interpolated between cached depths, for live frames.

Levels are equally spaced in the square root of depth, as the contact radius is. Lagrange cubics through four
levels give motion, force, and radius; the contact is the nearest level's, scaled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.ndimage import convolve1d, map_coordinates, spline_filter

from palpate.core import Complex, Contact, Field, Float, Pose, PressHistory, Probe, ndarray
from palpate.mechanics.layers.influence import plane_response
from palpate.mechanics.layers.stack import Stack
from palpate.sensors.nusense.pad_contact import PATTERN_CELL_M, pad_contact

SIDE = 192  # cells: 38 mm to each side of the probe, over eight thicknesses
AT_KNOT = (1 / 6, 4 / 6, 1 / 6)  # values of a cubic B-spline at its knots

Wave = Complex[ndarray, "py half"]


@dataclass(frozen=True, slots=True, eq=False)
class PatternMotion:
    """Displacement of the tiles' lower face from rest.

    Attributes:
        centre_m: Centre of the grid, the probe's axis (x, y) [m].
        cell_m: Grid step [m].
        knots: Cubic spline coefficients of x, y, z at (i + 1/2 - n/2) cells from the centre [m].
    """

    centre_m: tuple[float, float]
    cell_m: float
    knots: Float[ndarray, "3 ny nx"]

    @property
    def moved_m(self) -> Float[ndarray, "3 ny nx"]:
        """Displacement at the knots [m]."""
        rows = convolve1d(self.knots, AT_KNOT, axis=1, mode="mirror")
        return np.asarray(convolve1d(rows, AT_KNOT, axis=2, mode="mirror"))

    def at(self, x_m: Float[ndarray, " n"], y_m: Float[ndarray, " n"]) -> Float[ndarray, "3 n"]:
        """Displacement of tiles by resting position; 0 far from the probe [m]."""
        side = self.knots.shape[1]
        rows = (np.asarray(y_m) - self.centre_m[1]) / self.cell_m + side / 2 - 0.5
        columns = (np.asarray(x_m) - self.centre_m[0]) / self.cell_m + side / 2 - 0.5
        return np.stack(
            [map_coordinates(knots, [rows, columns], order=3, prefilter=False) for knots in self.knots]
        )


def pattern_motion(stack: Stack, interface: int, contact: Contact) -> PatternMotion:
    """Return the motion of the tiles, `interface` layers deep, under a contact."""
    share = 1.0 / contact.history.stiffening
    response = plane_response(stack, interface, SIDE, PATTERN_CELL_M)
    waves_of = _spectrum(contact)
    p = waves_of(contact.pressure_pa * share)
    moved_x, moved_y = 1j * response.pressed_x * p, 1j * response.pressed_y * p
    moved_z = response.zz * p
    if contact.shear_pa is not None:
        qx, qy = (waves_of(q * share) for q in contact.shear_pa)
        moved_x = moved_x + response.xx * qx + response.xy * qy
        moved_y = moved_y + response.xy * qx + response.yy * qy
        moved_z = moved_z - 1j * (response.lifted_x * qx + response.lifted_y * qy)
    moved = fft.irfft2(np.stack([moved_x, moved_y, moved_z]), response.waves.shape)
    knots = np.stack([spline_filter(part, order=3) for part in moved])
    return PatternMotion((contact.pose.x_m, contact.pose.y_m), PATTERN_CELL_M, knots)


def _spectrum(contact: Contact) -> Callable[[Field], Wave]:
    """Transform of a load on a contact's cells to the waves of the motion's grid."""
    middle, dy = (contact.pose.x_m, contact.pose.y_m), float(contact.y_m[1] - contact.y_m[0])
    dx = float(contact.x_m[1] - contact.x_m[0])
    first = (0.5 - SIDE / 2) * PATTERN_CELL_M
    k_x = 2 * np.pi * fft.rfftfreq(SIDE, PATTERN_CELL_M)[:, None]
    k_y = 2 * np.pi * fft.fftfreq(SIDE, PATTERN_CELL_M)[:, None]
    across = np.exp(-1j * k_x * (contact.x_m - middle[0] - first)) * np.sinc(k_x * dx / (2 * np.pi))
    down = np.exp(-1j * k_y * (contact.y_m - middle[1] - first)) * np.sinc(k_y * dy / (2 * np.pi))
    return lambda load: np.asarray(down @ load @ across.T * (dx * dy / PATTERN_CELL_M**2))


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
