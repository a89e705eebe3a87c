"""Force over contact area and force over displacement: the two cues by which an object feels soft.

A characteristic is a piecewise linear table, rising in both columns, so that its inverse is exact.

Reference: E. P. Scilingo, M. Bianchi, G. Grioli, A. Bicchi, Rendering softness, IEEE Trans. Haptics 3 (2010)
109, doi:10.1109/TOH.2010.2, equation (6).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.mechanics.fingertip_laws import Fingertip
from palpate.mechanics.half_space.hertz import Body

Cue = Literal["area", "displacement"]
SHOWN = {"area": (1e6, "mm²"), "displacement": (1e3, "mm")}
SAMPLES = 2049  # of a law between 0 and its end, closer where it begins

Array = Float[ndarray, "*n"]
Points = Float[ndarray, " _"]


@dataclass(frozen=True, slots=True, eq=False)
class Characteristic:
    """Force over area [m^2] or displacement [m], both rising from 0 or above."""

    cue: Cue
    x: Points
    force_n: Points

    def __post_init__(self) -> None:
        factor, unit = SHOWN[self.cue]
        if len(self.x) != len(self.force_n) or len(self.x) < 2:
            raise InputError(
                f"force over {self.cue} of {len(self.x)} values and {len(self.force_n)} forces; give as many "
                "of each, and 2 at least",
                code="table-size",
            )
        if not (np.isfinite(self.x).all() and np.isfinite(self.force_n).all()):
            raise InputError(f"force over {self.cue}: all values must be finite numbers", code="not-finite")
        if self.x[0] < 0 or self.force_n[0] < 0:
            raise RangeError(
                f"force over {self.cue} begins at {self.x[0] * factor:g} {unit} and {self.force_n[0]:g} N; "
                "neither may lie below 0: count from first touch, a press being positive",
                code="below-zero",
            )
        for name, values, scale, of in (
            (self.cue, self.x, factor, unit), ("force", self.force_n, 1.0, "N"),
        ):  # fmt: skip
            level = np.flatnonzero(np.diff(values) <= 0)
            if len(level):
                k = int(level[0])
                raise InputError(
                    f"force over {self.cue}: {name} goes from {values[k] * scale:g} to "
                    f"{values[k + 1] * scale:g} {of} after value {k + 1}; it has to rise throughout, since "
                    "otherwise two states have one force: give the way down alone, smoothed",
                    code="not-monotone",
                )

    @property
    def greatest_n(self) -> float:
        """Force at its end [N]."""
        return float(self.force_n[-1])

    def force_at(self, x: float | Array) -> Array:
        """Force at an area [m^2] or displacement [m]."""
        given = np.asarray(x, float)
        if np.any((given < self.x[0]) | (given > self.x[-1]) | np.isnan(given)):
            factor, unit = SHOWN[self.cue]
            raise RangeError(
                f"force is known from {self.x[0] * factor:g} to {self.x[-1] * factor:g} {unit} of "
                f"{self.cue}, and was asked outside it",
                code="cue-range",
            )
        return np.asarray(np.interp(given, self.x, self.force_n))

    def at_force(self, force_n: float | Array) -> Array:
        """Area [m^2] or displacement [m] at a force; below the first force where the table begins."""
        given = np.asarray(force_n, float)
        if np.any((given < 0) | (given > self.greatest_n * (1 + 1e-12)) | np.isnan(given)):
            raise RangeError(
                f"{self.cue} is known from 0 to {self.greatest_n:g} N, and was asked outside that",
                code="force-range",
            )
        return np.asarray(np.interp(given, self.force_n, self.x))

    @classmethod
    def from_law(
        cls, cue: Cue, law: Callable[[Points], Points], until: float, begins: float = 0.0
    ) -> Characteristic:
        """Tabulate a law from area [m^2] or displacement [m] to force [N]."""
        if not begins < until < np.inf:
            factor, unit = SHOWN[cue]
            raise RangeError(
                f"force over {cue} from {begins * factor:g} to {until * factor:g} {unit}; the end has to be "
                "finite and above the beginning",
                code="range-ends",
            )
        x = begins + (until - begins) * np.linspace(0.0, 1.0, SAMPLES) ** 2
        return cls(cue, x, np.asarray(law(x), float))


@dataclass(frozen=True, slots=True)
class SoftObject:
    """An object as a finger feels it: force over area, and over displacement."""

    name: str
    area: Characteristic
    displacement: Characteristic
    source: str

    def __post_init__(self) -> None:
        if self.area.cue != "area" or self.displacement.cue != "displacement":
            raise InputError(f"{self.name}: give area first, then displacement", code="cue-order")

    @property
    def greatest_n(self) -> float:
        """Force up to which both cues are known [N]."""
        return min(self.area.greatest_n, self.displacement.greatest_n)


def pressed_object(
    name: str, force_n: Points, displacement_m: Points, area_m2: Points, source: str
) -> SoftObject:
    """Return an object from displacement [m] and area [m^2] at the same rising forces [N]."""
    return SoftObject(
        name,
        Characteristic("area", area_m2, force_n),
        Characteristic("displacement", displacement_m, force_n),
        source,
    )


def fingertip_object(name: str, tip: Fingertip, greatest_n: float | None = None) -> SoftObject:
    """Return what a fingertip feels of a flat, up to `greatest_n` or the limit of the model."""
    end = tip.greatest_n if greatest_n is None else greatest_n
    if not end > 0:
        raise RangeError(f"a greatest force of {end:g} N; give one above 0 N", code="force-range")
    force = end * np.linspace(0.0, 1.0, SAMPLES) ** 3
    return pressed_object(name, force, tip.approach_m(force), tip.area_m2(force), tip.source)


def hertz_object(name: str, ball: Body, finger: Body, greatest_n: float) -> SoftObject:
    """Return an elastic ball or flat under an elastic finger (Hertz)."""
    if not 0 < greatest_n < np.inf:
        raise RangeError(f"greatest force {greatest_n:g} N; give one above 0 N", code="force-range")
    both = ball.against(finger)
    ends = float(both.area_m2(greatest_n)), float(both.approach_m(greatest_n))
    return SoftObject(
        name,
        Characteristic.from_law("area", lambda A: _force_of_area(both, A), ends[0]),
        Characteristic.from_law("displacement", lambda d: np.asarray(both.force_n(d)), ends[1]),
        f"Hertz: {ball.modulus_pa / 1e3:g} kPa (over 1 - nu²) and {ball.radius_m * 1e3:g} mm under a finger "
        f"of {finger.modulus_pa / 1e3:g} kPa and {finger.radius_m * 1e3:g} mm",
    )


def _force_of_area(both: Body, area_m2: Points) -> Points:
    """P = 4/3 E / R (A / pi)^(3/2) [N]."""
    return np.asarray(4 / 3 * both.modulus_pa / both.radius_m * (area_m2 / np.pi) ** 1.5)


def polynomial(cue: Cue, coefficients_n: Sequence[float], per: float, until: float) -> Characteristic:
    """Return force as a polynomial of x / per, with coefficients [N] of the powers 0, 1, 2, ..."""
    return Characteristic.from_law(
        cue, lambda x: np.polynomial.polynomial.polyval(x / per, np.asarray(coefficients_n, float)), until
    )
