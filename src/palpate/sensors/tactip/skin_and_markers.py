"""Marker positions: rigid pins normal to the deformed skin's inside, which amplify its tilt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.interpolate import CubicSpline

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress
from palpate.sensors.tactip.tactip_spec import PinLayout

Places = Float[ndarray, "p 3"]
Angles = Float[ndarray, " p"]


@runtime_checkable
class SkinShape(Protocol):
    """Inside of a deformed skin; x, y, z from the undeformed apex, z towards the camera [m]."""

    def at(self, polar: Angles, azimuth: Angles) -> tuple[Places, Places]:
        """Positions, and normals that point into the tip."""


@dataclass(frozen=True)
class HeadOnSkin:
    """Skin of a head-on press at one force; fields as in `HeadOnPress`."""

    polar_rad: Float[ndarray, " n"]
    inside_m: Float[ndarray, "n 2"]

    def at(self, polar: Angles, azimuth: Angles) -> tuple[Places, Places]:
        curve = CubicSpline(self.polar_rad, self.inside_m)
        (r, height), (dr, dz) = curve(polar).T, curve(polar, 1).T
        size = np.hypot(dr, dz)
        c, s = np.cos(azimuth), np.sin(azimuth)
        places = np.stack([r * c, r * s, height], axis=-1)
        return places, np.stack([-dz / size * c, -dz / size * s, dr / size], axis=-1)


@dataclass(frozen=True)
class LeaningSkin:
    """A skin on a slightly misaligned specimen: the field rotates about the dome's centre.

    Attributes:
        skin: Skin without the misalignment.
        radius_m: Radius of the dome [m].
        lean_rad: Rotation of the contact towards +x and -y.
    """

    skin: SkinShape
    radius_m: float
    lean_rad: tuple[float, float]

    def at(self, polar: Angles, azimuth: Angles) -> tuple[Places, Places]:
        turn = _lean(*self.lean_rad)
        out = np.stack(
            [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)], axis=-1
        )
        x, y, z = (out @ turn).T
        places, normals = self.skin.at(np.arccos(np.clip(-z, -1, 1)), np.arctan2(y, x))
        centre = np.array([0.0, 0.0, self.radius_m])
        return (places - centre) @ turn.T + centre, normals @ turn.T


def head_on(
    press: HeadOnPress, radius_m: float, force_n: float, lean_rad: tuple[float, float]
) -> LeaningSkin:
    """Return the skin at one force [N] on a slightly misaligned specimen."""
    inside = press.at("inside_m", np.array([force_n]))[0]
    return LeaningSkin(HeadOnSkin(press.polar_rad, inside), radius_m, lean_rad)


def _lean(about_y: float, about_x: float) -> Float[ndarray, "3 3"]:
    """Rotation of the apex towards +x and -y by small angles."""
    a, b = about_y, -about_x
    around_y = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    around_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return around_y @ around_x


def lattice(pins: PinLayout, inner_radius_m: float) -> tuple[Angles, Angles]:
    """Return polar angle and azimuth of the pins' roots, the middle pin first."""
    n = pins.rings
    steps = [(i, j) for i in range(-n, n + 1) for j in range(-n, n + 1) if abs(i + j) <= n]
    i, j = np.array(sorted(steps, key=lambda s: s[0] ** 2 + s[0] * s[1] + s[1] ** 2)).T
    x, y = pins.pitch_m * (i + j / 2), pins.pitch_m * np.sqrt(0.75) * j
    return np.arcsin(np.hypot(x, y) / inner_radius_m), np.arctan2(y, x)


def markers(skin: SkinShape, pins: PinLayout, inner_radius_m: float) -> Places:
    """Return the positions of the markers on the pins' ends [m]."""
    places, normals = skin.at(*lattice(pins, inner_radius_m))
    return places + pins.length_m * normals
