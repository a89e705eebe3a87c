"""The tip on a specimen under its apex, and the protocol of every such contact.

The tip on a viscous specimen: at every instant the elastic one with the effective modulus
(`creeping_press`).

Marker positions: rigid pins normal to the deformed skin's inside, which amplify its tilt.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.optimize import brentq

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.axisymmetric_fem import CreepingPress, Prony
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress, SidePress, TipTable, softness_share
from palpate.sensors.tactip.tactip_camera import projected
from palpate.sensors.tactip.tactip_spec import PinLayout, TacTipSpec

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


@runtime_checkable
class TipOnSpecimen(Protocol):
    """A tip on a specimen at any tilt."""

    @property
    def law(self) -> str:
        """Name of the contact law."""

    @property
    def deepest_m(self) -> float:
        """Maximum known approach [m]."""

    def force_n(self, approach_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Vertical force; 0 before first touch [N]."""

    def area_m2(self, force_n: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Contact area [m^2]."""

    def skin(self, approach_m: float, lean_rad: tuple[float, float]) -> SkinShape:
        """The skin's inside on a slightly misaligned specimen."""


class TabledContact:
    """A contact whose force and area a table at finite strain holds."""

    press: HeadOnPress | SidePress

    @property
    def law(self) -> str:
        return "finite strain, without friction"

    @property
    def deepest_m(self) -> float:
        return float(self.press.approach_m[-1])

    def force_n(self, approach_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        return self.press.force_at(approach_m)

    def area_m2(self, force_n: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        return self.press.at("area_m2", force_n)


@dataclass(frozen=True)
class HeadOn(TabledContact):
    """A specimen under the tip's apex."""

    press: HeadOnPress
    radius_m: float

    def skin(self, approach_m: float, lean_rad: tuple[float, float]) -> SkinShape:
        force = float(self.press.force_at(np.array([approach_m]))[0])
        return head_on(self.press, self.radius_m, force, lean_rad)


def pictured(
    spec: TacTipSpec, skin: SkinShape, shift_px: tuple[float, float] = (0.0, 0.0)
) -> tuple[Float[ndarray, "p 2"], Float[ndarray, " p"]]:
    """Return centres (x, y) and radii of the markers in the image [px]."""
    tangent, share = _projected(spec, skin)
    scale = pixels_per_tangent(spec)
    middle = (spec.camera.size_px - 1) / 2 + np.array(shift_px)
    return middle + scale * tangent, scale * share * spec.pins.radius_m


def modulus_pa(table: TipTable, stiffness_n_m: float) -> float:
    """Return the Young's modulus of the tables' cylinder of a stiffness [Pa]."""
    area_m2 = math.pi * table.specimen_radius_m**2
    return stiffness_n_m * table.specimen_height_m / area_m2


@lru_cache(maxsize=32)
def pixels_per_tangent(spec: TacTipSpec) -> float:
    """Return the focal length at which the untouched pins fill the camera's disc [px]."""
    untouched = head_on(spec.table.press(math.inf), spec.table.radius_m, 0.0, (0.0, 0.0))
    tangent, _ = _projected(spec, untouched)
    return float(spec.camera.disc_px / np.hypot(*tangent.T).max())


def _projected(spec: TacTipSpec, skin: SkinShape) -> tuple[Float[ndarray, "p 2"], Float[ndarray, " p"]]:
    return projected(markers(skin, spec.pins, spec.inner_radius_m), spec.camera, spec.table.radius_m)


MODULI = 24  # moduli of the interpolated elastic law
BEYOND = 0.02  # margin of the moduli


@dataclass(frozen=True)
class ViscousPress:
    """A tip on a viscous specimen, with the elastic contact by modulus [Pa] and the material's relaxation."""

    on: Callable[[float], HeadOn]
    body: Prony

    def approach_m(self, force_n: float, modulus_pa: float) -> float:
        """Approach on the elastic specimen [m]."""
        return float(self._law(softness_share(modulus_pa), np.cbrt(force_n))[0, 0])

    def modulus_pa(self, depth_m: float, force_n: float) -> float:
        """Effective modulus at a depth and force [Pa]."""
        stiff, soft = self._moduli[-1], self._moduli[0]
        if force_n <= 0.0 or depth_m <= self.approach_m(force_n, stiff):
            return float(stiff)
        if depth_m >= self.approach_m(force_n, soft):
            return float(soft)
        return float(
            np.exp(
                brentq(
                    lambda log: self.approach_m(force_n, float(np.exp(log))) - depth_m,
                    np.log(soft),
                    np.log(stiff),
                    xtol=1e-9,
                )
            )
        )

    def begun(self) -> CreepingPress:
        """A press before contact."""
        return CreepingPress(self.approach_m, self.body, self.most_n)

    def area_m2(self, force_n: float, modulus_pa: float) -> float:
        """Contact area with the elastic specimen [m^2]."""
        return float(self._area(softness_share(modulus_pa), np.cbrt(force_n))[0, 0])

    @property
    def most_n(self) -> float:
        """Maximum force of the tables [N]."""
        return float(self._presses[0].force_n[-1])

    @cached_property
    def _moduli(self) -> np.ndarray:
        low, high = self.body.equilibrium_pa, self.body.instantaneous_pa
        return np.geomspace(low, high * (1 + BEYOND), MODULI)

    @cached_property
    def _presses(self) -> list[HeadOnPress]:
        """From the stiffest to the softest."""
        return [self.on(float(E)).press for E in self._moduli[::-1]]

    @cached_property
    def _law(self) -> RectBivariateSpline:
        return self._over([press.approach_m for press in self._presses])

    @cached_property
    def _area(self) -> RectBivariateSpline:
        return self._over([press.area_m2 for press in self._presses])

    def _over(self, rows: list[np.ndarray]) -> RectBivariateSpline:
        share = [softness_share(float(E)) for E in self._moduli[::-1]]
        return RectBivariateSpline(share, np.cbrt(self._presses[0].force_n), np.stack(rows))
