"""The outline of a skin: where a probe may come down on it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError
from palpate.core.shapes import Float

ROUNDING_M = 1e-12
ONCE = 1.5  # turns of all corners together: a convex polygon's are one, a star's at least two

Series = Float[ndarray, " n"]
Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Outline:
    """A disc about the skin's centre, or a convex polygon; made by `disc`, `rectangle` and `polygon`.

    Attributes:
        radius_m: of the disc, or of the circle around the polygon's corners, about the skin's centre [m].
        corners_m: of the polygon, (x, y) in order, clockwise as the camera sees it; empty for a disc [m].
    """

    radius_m: float
    corners_m: Corners = ()

    @classmethod
    def disc(cls, diameter_m: float) -> Outline:
        """A disc of a diameter [m]."""
        if not (math.isfinite(diameter_m) and diameter_m > 0):
            raise InputError(f"a disc of {diameter_m} m; give a diameter above 0 m")
        return cls(diameter_m / 2)

    @classmethod
    def rectangle(cls, width_m: float, height_m: float) -> Outline:
        """A rectangle along x and y about the centre [m]."""
        x, y = width_m / 2, height_m / 2
        return cls.polygon(((-x, -y), (x, -y), (x, y), (-x, y)))

    @classmethod
    def polygon(cls, corners_m: Corners) -> Outline:
        """A convex polygon around the skin's centre; corners in order, once around, from +x towards +y."""
        corners = tuple((float(x), float(y)) for x, y in corners_m)
        at = np.array(corners).reshape(-1, 2)
        sides = np.roll(at, -1, axis=0) - at
        after = np.roll(sides, -1, axis=0)
        turns = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
        if len(at) < 3 or not (np.isfinite(at).all() and (turns > 0).all()):
            raise InputError(
                f"a polygon of corners {corners} m; give three or more of a convex one, in order from +x "
                "towards +y"
            )
        around = np.arctan2(turns, (sides * after).sum(axis=1)).sum() / math.tau
        if around > ONCE:
            raise InputError(
                f"a polygon of corners {corners} m: its sides cross, as they go {round(around)} times "
                "around; give each corner once, in the order of one way around",
                code="polygon-crosses",
            )
        made = cls(float(np.hypot(*at.T).max()), corners)
        if made.clearance_m(0.0, 0.0) <= 0:
            raise InputError(
                f"a polygon of corners {corners} m leaves out the skin's centre, (0, 0); give corners "
                "counted from the centre, all around it",
                code="polygon-center",
            )
        return made

    def contains(self, x_m: float, y_m: float, probe_radius_m: float = 0.0) -> bool:
        """True where a round probe lies wholly inside."""
        return probe_radius_m - self.clearance_m(x_m, y_m) <= ROUNDING_M

    def clearance_m(self, x_m: float, y_m: float) -> float:
        """Distance from a point inside to the rim; negative outside [m]."""
        return -float(self._signed(np.array([x_m]), np.array([y_m]))[0])

    def beyond_m(self, x_m: Series, y_m: Series) -> Series:
        """Distance outside, 0 inside [m]; past a polygon's corner a little less than that."""
        return np.clip(self._signed(x_m, y_m), 0.0, None)

    def _signed(self, x_m: Series, y_m: Series) -> Series:
        """Distance to the outline, negative inside."""
        if not self.corners_m:
            return np.asarray(np.hypot(x_m, y_m) - self.radius_m)
        at = np.array(self.corners_m)
        sides = np.roll(at, -1, axis=0) - at
        out = np.stack([sides[:, 1], -sides[:, 0]], axis=1) / np.hypot(*sides.T)[:, None]
        away = np.stack([x_m, y_m], axis=-1)[:, None, :] - at
        return np.asarray((away * out).sum(axis=-1).max(axis=1))
