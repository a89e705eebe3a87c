"""References of both devices tabulated at equal steps, for lookup within a period of the loop."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from palpate.core import Float, ndarray
from palpate.softness.rendering_law import Mode, RenderingLaw

POINTS = 4001
STEEP_N_M = 2000.0  # by which a force that an object has at no displacement begins

Table = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Piecewise linear values at equal steps from 0, held beyond both ends."""

    step: float
    values: Table

    def at(self, x: float) -> tuple[float, float]:
        """Value and slope."""
        place = x / self.step
        if place <= 0.0:
            return float(self.values[0]), float(self.values[1] - self.values[0]) / self.step
        i = min(int(place), len(self.values) - 2)
        low, high = float(self.values[i]), float(self.values[i + 1])
        return low + min(place - i, 1.0) * (high - low), (high - low) / self.step


@dataclass(frozen=True, slots=True)
class Reference:
    """References in one state: pressure and display force with slopes over push, object force over
    displacement.
    """

    pressure_pa: float
    pressure_slope: float
    force_n: float
    force_slope: float
    area_m2: float
    object_n: float
    object_slope: float

    def towards(self, other: Reference, share: float) -> Reference:
        """So far on the way to another: 0 is this one, 1 the other."""
        pairs = zip(astuple(self), astuple(other), strict=True)
        return Reference(*(a + share * (b - a) for a, b in pairs))


class ReferenceTable:
    """Tabulated references of a rendering law."""

    def __init__(self, law: RenderingLaw) -> None:
        self.law, self.height_m = law, law.display.height_m
        step = self.height_m / (POINTS - 1)
        self._pressure, self._force, self._area = (Curve(step, one) for one in _of_push(law, step))
        whole = law.object.displacement
        d_step = float(whole.x[-1]) / (POINTS - 1)
        self._object = Curve(d_step, _from_first_touch(law, d_step * np.arange(POINTS)))

    def at(self, pushed_m: float, displacement_m: float) -> Reference:
        """References at a push of the tip and a whole displacement of the finger."""
        pushed = min(max(pushed_m, 0.0), self.height_m)
        return Reference(
            *self._pressure.at(pushed), *self._force.at(pushed), self._area.at(pushed)[0],
            *self._whole(displacement_m),
        )  # fmt: skip

    def _whole(self, displacement_m: float) -> tuple[float, float]:
        """Force of the object and its slope; a first force at no displacement is a steep rise to it."""
        force, slope = self._object.at(displacement_m)
        if displacement_m >= 0.0 or force == 0.0:
            return force, slope
        return max(force + max(slope, STEEP_N_M) * displacement_m, 0.0), max(slope, STEEP_N_M)


def _of_push(law: RenderingLaw, step: float) -> tuple[Table, Table, Table]:
    """Pressure, force and area at equal steps of the display's push."""
    if law.mode is Mode.KINESTHETIC:
        return np.zeros(POINTS), np.zeros(POINTS), np.zeros(POINTS)
    state = law.at(step * np.arange(POINTS))
    pressure = state.pressure_pa.copy()
    pressure[0] = pressure[1]  # at no area any pressure gives no force
    return pressure, state.force_n, state.area_m2


def _from_first_touch(law: RenderingLaw, displacement_m: Table) -> Table:
    """Force over displacement, from 0 where its table begins later."""
    curve = law.object.displacement
    return np.interp(displacement_m, curve.x, curve.force_n)
