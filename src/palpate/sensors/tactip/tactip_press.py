"""The tip on a specimen under its apex, and the protocol of every such contact."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.inclined_table import SidePress
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress, TipTable
from palpate.sensors.tactip.skin_and_markers import SkinShape, head_on, markers
from palpate.sensors.tactip.tactip_camera import projected
from palpate.sensors.tactip.tactip_spec import TacTipSpec


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
