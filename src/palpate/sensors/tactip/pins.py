"""Where the markers are: rigid pins that stand on the skin's inside and turn with it.

A pin's root moves with the skin, and the pin stays along the deformed skin's normal, so that its marker, at
the end of a lever, shows the skin's tilt larger than its displacement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import CubicSpline

from palpate.mechanics.tip_table import HeadOnPress
from palpate.sensors.tactip.spec import Pins

Places = Float[ndarray, "p 3"]
Angles = Float[ndarray, " p"]


@runtime_checkable
class Skin(Protocol):
    """The inside of a deformed skin; x, y, z from the untouched apex, z towards the camera [m]."""

    def at(self, polar: Angles, azimuth: Angles) -> tuple[Places, Places]:
        """Places, and the normals there that point into the tip."""


@dataclass(frozen=True)
class HeadOnSkin:
    """The skin of a head-on press at one force, perhaps on a top that leans a little.

    A lean turns the whole field about the centre of the dome; that the dome's base does not turn with it is
    neglected, which holds for the degree or so by which a specimen is seated askew.

    Attributes:
        polar_rad, inside_m: as in `HeadOnPress`, of one force.
        radius_m: of the dome [m].
        lean_rad: of the contact's middle from the axis, along x and y.
    """

    polar_rad: Float[ndarray, " n"]
    inside_m: Float[ndarray, "n 2"]
    radius_m: float
    lean_rad: tuple[float, float] = (0.0, 0.0)

    def at(self, polar: Angles, azimuth: Angles) -> tuple[Places, Places]:
        """Places, and the normals there that point into the tip."""
        turn = _lean(*self.lean_rad)
        out = np.stack(
            [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)], axis=-1
        )
        x, y, z = (out @ turn).T
        phi, theta = np.arccos(np.clip(-z, -1, 1)), np.arctan2(y, x)
        curve = self._curve
        (r, height), (dr, dz) = curve(phi).T, curve(phi, 1).T
        size = np.hypot(dr, dz)
        c, s = np.cos(theta), np.sin(theta)
        places = np.stack([r * c, r * s, height], axis=-1)
        normals = np.stack([-dz / size * c, -dz / size * s, dr / size], axis=-1)
        centre = np.array([0.0, 0.0, self.radius_m])
        return (places - centre) @ turn.T + centre, normals @ turn.T

    @property
    def _curve(self) -> CubicSpline:
        return CubicSpline(self.polar_rad, self.inside_m)


def head_on(press: HeadOnPress, radius_m: float, force_n: float, lean_rad: tuple[float, float]) -> HeadOnSkin:
    """The skin at one force [N]."""
    return HeadOnSkin(press.polar_rad, press.at("inside_m", np.array([force_n]))[0], radius_m, lean_rad)


def _lean(about_y: float, about_x: float) -> Float[ndarray, "3 3"]:
    """Turns the apex towards +x and +y by small angles."""
    a, b = about_y, -about_x
    around_y = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    around_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return around_y @ around_x


def lattice(pins: Pins, inner_radius_m: float) -> tuple[Angles, Angles]:
    """Polar angle and azimuth of the pins' roots on the skin's inside; the middle pin first."""
    n = pins.rings
    steps = [(i, j) for i in range(-n, n + 1) for j in range(-n, n + 1) if abs(i + j) <= n]
    i, j = np.array(sorted(steps, key=lambda s: s[0] ** 2 + s[0] * s[1] + s[1] ** 2)).T
    x, y = pins.pitch_m * (i + j / 2), pins.pitch_m * np.sqrt(0.75) * j
    return np.arcsin(np.hypot(x, y) / inner_radius_m), np.arctan2(y, x)


def markers(skin: Skin, pins: Pins, inner_radius_m: float) -> Places:
    """Where the markers on the pins' ends are [m]."""
    places, normals = skin.at(*lattice(pins, inner_radius_m))
    return places + pins.length_m * normals
