"""References of a cone display and an arm in series that present both cues of an object.

With the display's push s and area A(s), and an object of force alpha(A) and beta(d),

    p = alpha(A) / A,     P = p A,     d_arm = beta^-1(P) - s.

alpha(A) / A diverges at contact onset if alpha(0) > 0. Below an area A_b the force is P = c1 A + c2 A^2 with
the value and slope of alpha at A_b, the smallest tabulated area at which c1 and c1 + c2 A_b lie within 0 and
the greatest pressure. A state is not rendered below A_b, beyond the bounds of pressure, force, area, or arm,
or where a sleeve already pushes more than alpha(A).

Modes: ``CM1`` renders both cues; ``CM2`` has a rigid plate on the arm and renders beta; ``CM3`` renders alpha
while the arm retracts the display's push.

Reference: E. P. Scilingo, M. Bianchi, G. Grioli, A. Bicchi, Rendering softness, IEEE Trans. Haptics 3 (2010)
109, doi:10.1109/TOH.2010.2, sections 3.2 and 4.3.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np

from palpate.core import Bool, Float, InputError, RangeError, ndarray
from palpate.softness.characteristics import Characteristic, SoftObject
from palpate.softness.display_parts import ConeDisplay

Array = Float[ndarray, "*n"]
SLACK = 1e-9  # of a bound, for rounding


class Mode(StrEnum):
    """Which cues are rendered."""

    BOTH = "CM1"
    KINESTHETIC = "CM2"
    CUTANEOUS = "CM3"


class Limit(StrEnum):
    """Why a state is not rendered."""

    ONSET = "onset"
    PRESSURE = "pressure"
    SLEEVE = "sleeve"
    FORCE = "force"
    AREA = "area"
    ARM = "arm"


LIMIT_WORDS: Mapping[str, str] = {
    Limit.ONSET: "onset, blended",
    Limit.PRESSURE: "needs more pressure",
    Limit.SLEEVE: "the sleeve pushes more",
    Limit.FORCE: "needs more force",
    Limit.AREA: "beyond the object's curve",
    Limit.ARM: "beyond the arm's way",
}
"""Reasons in words."""


@dataclass(frozen=True, slots=True)
class DisplayBounds:
    """Limits of the devices; `arm_m` is towards the finger's press."""

    pressure_pa: float = 100e3
    force_n: float = 10.0
    arm_m: tuple[float, float] = (-15e-3, 15e-3)

    def __post_init__(self) -> None:
        if not (0 < self.pressure_pa < np.inf and 0 < self.force_n < np.inf):
            raise RangeError(
                f"bounds of {self.pressure_pa / 1e3:g} kPa and {self.force_n:g} N; both have to be finite "
                "and above 0"
            )
        low, high = self.arm_m
        if not -np.inf < low <= 0 <= high < np.inf:
            raise RangeError(
                f"an arm from {low * 1e3:g} to {high * 1e3:g} mm; give finite ends around 0 mm, where the "
                "finger touches first",
                code="arm-range",
            )


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """References at display pushes; `limit` is the reason why a state is not rendered, or ""."""

    pushed_m: Array
    area_m2: Array
    pressure_pa: Array
    force_n: Array
    arm_m: Array
    limit: ndarray

    @property
    def displacement_m(self) -> Array:
        """Displacement of the finger: the display's and the arm's [m]."""
        return np.asarray(self.pushed_m + self.arm_m)

    @property
    def rendered(self) -> Bool[ndarray, "*n"]:
        """Where the object is felt as it is."""
        return np.asarray(self.limit == "")


@dataclass(frozen=True)
class RenderingLaw:
    """References of both devices for one object."""

    object: SoftObject
    display: ConeDisplay = field(default_factory=ConeDisplay)
    bounds: DisplayBounds = field(default_factory=DisplayBounds)
    mode: Mode = Mode.BOTH

    def __post_init__(self) -> None:
        if self.display.greatest_m2 <= self.object.area.x[0]:
            raise RangeError(
                f"{self.object.name}: force over area begins at {self.object.area.x[0] * 1e6:g} mm², and the "
                f"display has {self.display.greatest_m2 * 1e6:.4g} mm² at most",
                code="area",
            )
        _ = self.onset

    @cached_property
    def onset(self) -> Onset:
        """How the force begins."""
        return find_onset(self.object, self.bounds.pressure_pa, self.display.greatest_m2)

    def at(self, pushed_m: float | Array) -> Rendered:
        """Return the references at display pushes of 0 to the height [m]."""
        if self.mode is Mode.KINESTHETIC:
            raise InputError("in CM2 a rigid plate is in place of the display; ask plate_force")
        pushed = np.atleast_1d(np.asarray(pushed_m, float))
        area = self.display.area_m2(pushed)
        sleeve = self.display.sleeve_n_m * pushed
        asked = self.onset.force_n(area) - sleeve
        at_none = self.onset.c1 if self.display.sleeve_n_m == 0.0 else 0.0
        wanted = np.divide(asked, area, out=np.full_like(area, at_none), where=area > 0)
        pressure = np.clip(wanted, 0.0, self.bounds.pressure_pa)
        force = pressure * area + sleeve
        held = np.minimum(force, self.object.displacement.greatest_n)
        ideal = -pushed if self.mode is Mode.CUTANEOUS else self.object.displacement.at_force(held) - pushed
        arm = np.clip(ideal, *self.bounds.arm_m)
        limit = np.full(area.shape, "", dtype=object)
        for reason, where in (
            (Limit.ARM, arm != ideal),
            (Limit.FORCE, force > self.bounds.force_n * (1 + SLACK)),
            (Limit.FORCE, force > self.object.displacement.greatest_n * (1 + SLACK)),
            (Limit.AREA, area > self.object.area.x[-1] * (1 + SLACK)),
            (Limit.SLEEVE, wanted < -SLACK * self.bounds.pressure_pa),
            (Limit.PRESSURE, wanted > self.bounds.pressure_pa * (1 + SLACK)),
            (Limit.ONSET, area < self.onset.area_m2 * (1 - SLACK)),
        ):
            limit[where] = reason.value
        return Rendered(pushed, area, pressure, force, arm, limit)

    def plate_force(self, displacement_m: float | Array) -> Array:
        """Force of the arm in CM2, at its displacement [N]; no more than the bound."""
        return np.minimum(self.object.displacement.force_at(displacement_m), self.bounds.force_n)

    def envelope(self, samples: int = 2000) -> Rendered:
        """References over the whole way of the display, from first touch."""
        return self.at(np.linspace(0.0, self.display.height_m, samples + 1)[1:])


@dataclass(frozen=True, slots=True, eq=False)
class Onset:
    """Force over area, replaced by c1 A + c2 A^2 below `area_m2`."""

    alpha: Characteristic
    area_m2: float
    c1: float
    c2: float

    def force_n(self, area_m2: Array) -> Array:
        """Force at an area; beyond the table as at its end [N]."""
        begun = self.c1 * area_m2 + self.c2 * area_m2**2
        return np.where(area_m2 < self.area_m2, begun, np.interp(area_m2, self.alpha.x, self.alpha.force_n))


def find_onset(soft: SoftObject, pressure_pa: float, greatest_m2: float) -> Onset:
    """The smallest area from which on an object can be rendered as it is."""
    alpha = soft.area
    for area, force, slope in _corners(alpha):
        if area > greatest_m2:
            break
        if area == 0.0:
            if force == 0.0 and 0.0 < slope <= pressure_pa:
                return Onset(alpha, 0.0, slope, 0.0)
            continue
        mean = force / area
        c1, c2 = 2 * mean - slope, (slope - mean) / area
        if 0 <= c1 <= pressure_pa * (1 + SLACK) and mean <= pressure_pa * (1 + SLACK):
            return Onset(alpha, area, c1, c2)
    raise RangeError(
        f"{soft.name}: its force over area needs more than {pressure_pa / 1e3:g} kPa at every area up to "
        f"{greatest_m2 * 1e6:.4g} mm²; give a softer object, or a display of more pressure",
        code="pressure",
    )


def _corners(alpha: Characteristic) -> Iterator[tuple[float, float, float]]:
    """Area, force and the slope that follows, at each point of a table but the last."""
    slopes = np.diff(alpha.force_n) / np.diff(alpha.x)
    for area, force, slope in zip(alpha.x[:-1], alpha.force_n[:-1], slopes, strict=True):
        yield float(area), float(force), float(slope)
