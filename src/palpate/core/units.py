"""Units live in names at the edges (`depth_mm`) and are SI inside.

A label column, a target and a JSON key are written ``quantity_unit``. `split_column` takes such a
name apart, `Unit.to_si` and `Unit.from_si` convert, and `rounded` writes a value as far as its interval bears
it out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from palpate.core.errors import UnitError

Number = TypeVar("Number", float, np.ndarray)


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of measure.

    Attributes:
        symbol: as it stands in a column's name, e.g. ``mm``.
        si: symbol of the SI unit of the same quantity, e.g. ``m``.
        factor: one `symbol` in `si` units.
    """

    symbol: str
    si: str
    factor: float

    def to_si(self, value: Number) -> Number:
        """Convert a value, or an array of them, in this unit to SI."""
        return value * self.factor

    def from_si(self, value: Number) -> Number:
        """Convert a value, or an array of them, in SI to this unit."""
        return value / self.factor


# Exact by definition (SI Brochure, 9th ed., tables 2, 4 and 8); kgf by CGPM 1901: 9.80665 N.
_DEGREE = math.pi / 180.0
UNITS: dict[str, Unit] = {
    u.symbol: u
    for u in (
        Unit("m", "m", 1.0),
        Unit("mm", "m", 1e-3),
        Unit("um", "m", 1e-6),
        Unit("mm2", "m2", 1e-6),
        Unit("m2", "m2", 1.0),
        Unit("rad", "rad", 1.0),
        Unit("deg", "rad", _DEGREE),
        Unit("mm2_per_N", "m2_per_N", 1e-6),
        Unit("m2_per_N", "m2_per_N", 1.0),
        Unit("N", "N", 1.0),
        Unit("mN", "N", 1e-3),
        Unit("kgf", "N", 9.80665),
        Unit("Nm", "Nm", 1.0),
        Unit("Nmm", "Nm", 1e-3),
        Unit("Pa", "Pa", 1.0),
        Unit("kPa", "Pa", 1e3),
        Unit("MPa", "Pa", 1e6),
        Unit("N_per_mm", "N_per_m", 1e3),
        Unit("N_per_m", "N_per_m", 1.0),
        Unit("kg", "kg", 1.0),
        Unit("g", "kg", 1e-3),
        Unit("s", "s", 1.0),
        Unit("ms", "s", 1e-3),
        Unit("px", "px", 1.0),
        Unit("ratio", "ratio", 1.0),
    )
}


def unit(symbol: str) -> Unit:
    """Look a unit up by its symbol."""
    try:
        return UNITS[symbol]
    except KeyError:
        raise UnitError(f"unit {symbol!r} is not known; known are {', '.join(UNITS)}") from None


def split_column(name: str) -> tuple[str, Unit]:
    """Take ``depth_mm`` apart into its quantity and its unit.

    Example:
        >>> quantity, unit_ = split_column("stiffness_N_per_mm")
        >>> quantity, unit_.symbol
        ('stiffness', 'N_per_mm')
    """
    for symbol in sorted(UNITS, key=len, reverse=True):
        quantity, separator, rest = name.rpartition(f"_{symbol}")
        if separator and not rest and quantity:
            return quantity, UNITS[symbol]
    raise UnitError(
        f"column {name!r} carries no unit; name it quantity_unit, as in depth_mm, force_N or tilt_deg "
        f"(a dimensionless one ends in _ratio); known units are {', '.join(UNITS)}",
        code="no-unit",
    )


def has_unit(name: str) -> bool:
    """True where a column's name ends in a known unit."""
    try:
        split_column(name)
    except UnitError:
        return False
    return True


DIGITS = 2
"""Significant digits of an uncertainty: JCGM 100:2008 (GUM), 7.2.6, https://doi.org/10.59161/JCGM100-2008E."""


def decimals_for(half_width: float) -> int | None:
    """Decimals at which a half-width has two significant digits; negative for tens, None where it has none.

    Example:
        >>> decimals_for(0.0137), decimals_for(0.62), decimals_for(0.0996), decimals_for(340.0)
        (3, 2, 2, -1)
    """
    if not (math.isfinite(half_width) and half_width > 0):
        return None
    place = DIGITS - 1 - math.floor(math.log10(half_width))
    # 0.0996 has two digits as 0.10: rounding may carry into the place before.
    return DIGITS - 1 - math.floor(math.log10(round(half_width, place)))


def rounded(value: float | None, half_width: float) -> str:
    """A value to the decimal place of its interval's half-width; three digits where there is none.

    Example:
        >>> rounded(1.83456, 0.2137), rounded(12345.0, 340.0), rounded(1.5, 0.0), rounded(None, 0.1)
        ('1.83', '12340', '1.5', '–')
    """
    if value is None or not math.isfinite(value):
        return "–"
    decimals = decimals_for(half_width)
    if decimals is None:
        return f"{value:.3g}"
    shown = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return shown.removeprefix("-") if float(shown) == 0 else shown


def half_width_text(half_width: float) -> str:
    """A half-width to its own two digits."""
    return rounded(half_width, half_width)


MAX_LEAN = 0.01  # share of an interval's length by which its two sides differ and it is still written as ±


def interval_text(value: float, low: float, high: float) -> tuple[str, str]:
    """A value, and its interval around it: ± where its two sides are alike, else each side or both ends.

    All are written to the place of half the interval's length.

    Example:
        >>> interval_text(1.1234, 0.9, 1.3468), interval_text(1.1234, 0.575, 1.62)
        (('1.12', '± 0.22'), ('1.12', '+0.50 −0.55'))
    """
    above, below, half = high - value, value - low, (high - low) / 2
    if abs(above - below) <= MAX_LEAN * (above + below):
        return rounded(value, half), f"± {half_width_text(half)}"
    if not math.isfinite(half):
        return rounded(value, half), f"({low:.3g} to {high:.3g})"
    return rounded(value, half), f"+{rounded(above, half)} −{rounded(below, half)}"
