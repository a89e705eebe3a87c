"""The tip's side on an inclined specimen by tables at finite strain, see `inclined_table`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RectBivariateSpline

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.inclined_table import SidePress
from palpate.sensors.tactip.skin_and_markers import LeaningSkin, SkinShape

MIRROR = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class SideOn:
    """A specimen under the tip's side, of which there is a table.

    Attributes:
        press: the table's.
        inner_radius_m, radius_m: of the skin's inside and of the tip [m].
    """

    press: SidePress
    inner_radius_m: float
    radius_m: float

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

    def skin(self, approach_m: float, lean_rad: tuple[float, float]) -> SkinShape:
        moved = self.press.at("moved_m", self.press.force_at(np.array([approach_m])))[0]
        dome = BentDome(
            self.inner_radius_m, self.radius_m, self.press.across_rad, self.press.aside_rad, moved
        )
        return LeaningSkin(dome, self.radius_m, lean_rad)


@dataclass(frozen=True)
class BentDome:
    """The inside of a dome of which places have moved, even about the plane y = 0.

    Attributes:
        inner_radius_m: of the dome [m].
        radius_m: of the tip, whose untouched apex is where z is 0 [m].
        across_rad, aside_rad, moved_m: see `SidePress`, at one force.
    """

    inner_radius_m: float
    radius_m: float
    across_rad: Float[ndarray, " a"]
    aside_rad: Float[ndarray, " b"]
    moved_m: Float[ndarray, "a b 3"]

    def at(self, polar: Float[ndarray, " p"], azimuth: Float[ndarray, " p"]) -> tuple[ndarray, ndarray]:
        x, y, z = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)
        a, b = np.arctan2(-z, x), np.arcsin(np.clip(y, -1.0, 1.0))
        places = self.inner_radius_m * np.stack([x, y, z], axis=-1) + self._moved(a, b)
        along_a = self.inner_radius_m * np.stack([z, 0 * z, -x], axis=-1) + self._moved(a, b, da=1)
        turned = np.stack([-np.sin(b) * np.cos(a), np.cos(b), np.sin(b) * np.sin(a)], axis=-1)
        along_b = self.inner_radius_m * turned + self._moved(a, b, db=1)
        normal = np.cross(along_b, along_a)
        size = np.linalg.norm(normal, axis=-1, keepdims=True)
        return places + np.array([0.0, 0.0, self.radius_m]), normal / size

    def _moved(self, a: Float[ndarray, " p"], b: Float[ndarray, " p"], da: int = 0, db: int = 0) -> ndarray:
        return np.stack([spline.ev(a, b, dx=da, dy=db) for spline in self._splines], axis=-1)

    @cached_property
    def _splines(self) -> list[RectBivariateSpline]:
        both = np.concatenate([-self.aside_rad[:0:-1], self.aside_rad])
        whole = np.concatenate([self.moved_m[:, :0:-1] * MIRROR, self.moved_m], axis=1)
        return [RectBivariateSpline(self.across_rad, both, whole[..., i]) for i in range(3)]
