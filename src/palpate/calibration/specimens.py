"""Specimens of known section: how much fringe order a load makes in each.

A strip of width w in tension carries s = P / (w t) through the thickness t, so N = C s t / l0 = C P / (w l0).
At the centre of a disc of diameter D pressed across it s1 - s2 = 8 P / (pi D t), so N = 8 C P / (pi D l0).
The thickness cancels in both: N = C P / (b l0), with b = w, or pi D / 8.

Reference for the disc: S. Timoshenko and J. N. Goodier, Theory of Elasticity, 3rd ed. (1970), art. 41.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from palpate.core.errors import RangeError


@dataclass(frozen=True, slots=True)
class Strip:
    """A strip in tension; the region lies where the stress is uniform, or across the whole width.

    Attributes:
        width_m: across the load and across the light, w [m].
        thickness_m: along the light, t [m]; C does not depend on it.
    """

    width_m: float
    thickness_m: float

    def __post_init__(self) -> None:
        _positive("the strip's width", self.width_m)
        _positive("the strip's thickness", self.thickness_m)

    @property
    def breadth_m(self) -> float:
        """What divides P in N = C P / (b l0) [m]."""
        return self.width_m

    def stress_pa(self, load_n: float) -> float:
        """s1 - s2 at a load [Pa]."""
        return load_n / (self.width_m * self.thickness_m)

    def __str__(self) -> str:
        return f"strip {self.width_m * 1e3:g} mm wide, {self.thickness_m * 1e3:g} mm thick"


@dataclass(frozen=True, slots=True)
class Disc:
    """A disc pressed across its diameter between flat plates; the region is a small box at its centre.

    Attributes:
        diameter_m: D [m].
    """

    diameter_m: float

    def __post_init__(self) -> None:
        _positive("the disc's diameter", self.diameter_m)

    @property
    def breadth_m(self) -> float:
        """What divides P in N = C P / (b l0) [m]."""
        return math.pi * self.diameter_m / 8

    def __str__(self) -> str:
        return f"disc {self.diameter_m * 1e3:g} mm across"


def _positive(name: str, value: float) -> None:
    if not (value > 0.0 and math.isfinite(value)):
        raise RangeError(f"{name} is {value} m; give a positive number of m")
