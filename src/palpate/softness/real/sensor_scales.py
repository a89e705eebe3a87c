"""Scales of a display's sensors: volts to millimeters by a table, volts to pascals by a line.

A voltage outside its scale, beyond a stated tolerance, has no value; it is never clipped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from palpate.core import InputError, RangeError


class OffScaleError(RangeError):
    """A voltage that stands for nothing: a broken wire, a lost magnet, a sensor beyond its range."""


@dataclass(frozen=True, slots=True)
class HallTable:
    """Piecewise linear calibration of the displacement sensor.

    Attributes:
        volts: strictly monotonic, two or more [V].
        pushed_mm: strictly rising, including 0 [mm].
        tolerance_mm: allowed excess beyond the table or below 0 [mm].

    Example:
        >>> table = HallTable(volts=(2.5, 3.1, 4.5), pushed_mm=(0.0, 4.0, 10.0))
        >>> round(1e3 * table.pushed_m(2.8), 6)
        2.0
    """

    volts: tuple[float, ...]
    pushed_mm: tuple[float, ...]
    tolerance_mm: float = 0.1

    def __post_init__(self) -> None:
        if len(self.volts) != len(self.pushed_mm) or len(self.volts) < 2:
            raise InputError(
                f"a table of {len(self.volts)} voltages and {len(self.pushed_mm)} displacements; give as "
                "many of each, two at least, measured on this display: no line is assumed",
                code="table-size",
            )
        if not all(map(math.isfinite, (*self.volts, *self.pushed_mm))):
            raise InputError(
                "the Hall sensor's table holds what is no finite number; give V and mm", code="not-finite"
            )
        if not (_rises(self.volts) or _rises(self.volts[::-1])) or not _rises(self.pushed_mm):
            raise InputError(
                f"the Hall sensor's table is not monotone: {self.volts} V at {self.pushed_mm} mm; the "
                "millimetres have to rise, and the volts to rise or to fall throughout: move the magnet, or "
                "shorten the table",
                code="not-monotone",
            )
        if not self.pushed_mm[0] <= 0 < self.pushed_mm[-1]:
            raise InputError(
                f"the Hall sensor's table goes from {self.pushed_mm[0]:g} to {self.pushed_mm[-1]:g} mm; it "
                "has to hold 0 mm, where nobody presses",
                code="no-zero",
            )
        if not 0 <= self.tolerance_mm < math.inf:
            raise RangeError(f"a tolerance of {self.tolerance_mm} mm; give 0 mm or more")

    def pushed_m(self, volts: float) -> float:
        """Displacement of the tip at a voltage [m]."""
        v, d = self.volts, self.pushed_mm
        passed = sum((volts - each) * (v[-1] - v[0]) > 0 for each in v)
        i = max(1, min(passed, len(v) - 1))  # end of the segment, or of the nearest one
        pushed_mm = d[i - 1] + (volts - v[i - 1]) * (d[i] - d[i - 1]) / (v[i] - v[i - 1])
        if not -self.tolerance_mm <= pushed_mm <= d[-1] + self.tolerance_mm:
            raise OffScaleError(
                f"the displacement's sensor gives {volts:.4g} V, outside its table of {v[0]:g} to {v[-1]:g} "
                "V or below 0 mm: check the magnet, the plug and the table"
            )
        return 1e-3 * pushed_mm


@dataclass(frozen=True, slots=True)
class PressureScale:
    """Linear scale from `low_v` at 0 Pa to `high_v` at `high_pa`, with a tolerance beyond both ends.

    Example:
        >>> PressureScale(low_v=1.0, high_v=5.0, high_pa=100e3).volts(25e3)
        2.0
    """

    low_v: float
    high_v: float
    high_pa: float
    tolerance_pa: float = 2e3

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.low_v, self.high_v, self.high_pa, self.tolerance_pa))):
            raise InputError(f"a scale of pressure holds what is no finite number: {self}; give V and Pa")
        if not (self.low_v < self.high_v and self.high_pa > 0 and self.tolerance_pa >= 0):
            raise RangeError(
                f"a scale of {self.low_v:g} V at 0 Pa to {self.high_v:g} V at {self.high_pa:g} Pa; the volts "
                "have to rise and the pressure to be above 0 Pa: the regulator's manual has both"
            )

    def volts(self, pressure_pa: float) -> float:
        """Volts that stand for a pressure [V]."""
        return self.low_v + (self.high_v - self.low_v) * pressure_pa / self.high_pa

    def pressure_pa(self, volts: float) -> float:
        """Gauge pressure at a voltage [Pa]."""
        pressure_pa = (volts - self.low_v) / (self.high_v - self.low_v) * self.high_pa
        if not -self.tolerance_pa <= pressure_pa <= self.high_pa + self.tolerance_pa:
            raise OffScaleError(
                f"the pressure's sensor gives {volts:.4g} V, outside its {self.low_v:g} to {self.high_v:g} "
                "V: check its supply and plug"
            )
        return pressure_pa


def _rises(values: tuple[float, ...]) -> bool:
    return all(b > a for a, b in pairwise(values))
