"""A Reading: a measured quantity that says how far it can be trusted; Readings: those of one frame.

The scalar kind is here. Angles that wrap, vectors, fields and sets of candidates are in `core.quantity`; all
carry what `MeasurementResult` holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from html import escape
from typing import Any, TypeVar

from palpate.core.errors import ColumnError, UnitError
from palpate.core.units import has_unit, split_column, unit

Same = TypeVar("Same", bound="MeasurementResult")


@dataclass(frozen=True, slots=True)
class Drift:
    """How far the untouched sensor has moved from what it was at calibration.

    Attributes:
        statistic: distance of the no-contact image from the calibration's, in units of the spread among
            the calibration's own no-contact images; around 1 when nothing has changed.
        limit: the statistic above which the calibration is stale.
    """

    statistic: float
    limit: float

    @property
    def drifted(self) -> bool:
        """Whether the sensor must be re-zeroed or calibrated anew."""
        return self.statistic > self.limit


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class MeasurementResult:
    """What every kind of reading carries beside its value.

    Attributes:
        quantity: what was measured, e.g. ``depth``.
        unit: of all that has one; SI until `in_unit` converts it.
        coverage: how often such intervals or regions hold the truth, by calibration (0.9 is nine in ten).
        valid: False when the value should not be used.
        why: why it should not be; empty when valid.
        drift: of the sensor since calibration; None where no no-contact image was given or kept.
        calibration: id of the calibration that made the estimate.
        frame: name of the frame it was read from.
        time_s: that frame's capture time [s].
    """

    quantity: str
    unit: str
    coverage: float
    valid: bool
    why: str
    drift: Drift | None
    calibration: str
    frame: str
    time_s: float

    @property
    def column(self) -> str:
        """The name at the edges, with the unit in it: ``depth_mm``."""
        return f"{self.quantity}_{self.unit}"

    @property
    def verdict(self) -> str:
        """Whether it may be used, in words."""
        return "inside the calibrated range" if self.valid else self.why

    def in_unit(self: Same, symbol: str) -> Same:
        """The same reading in another unit of the same quantity.

        Raises:
            UnitError: the unit measures something else.
        """
        if symbol == self.unit:
            return self
        return replace(self, unit=symbol, **self._converted(self._conversion(symbol)))

    def to_dict(self) -> dict[str, Any]:
        """The value, its interval and its verdict as plain values for JSON; what is no number is None."""
        return {**self._numbers(), "valid": self.valid, "why": self.why}

    def _conversion(self, symbol: str) -> Callable[[Any], Any]:
        """What makes a number or an array in this unit one in another."""
        old, new = unit(self.unit), unit(symbol)
        if old.si != new.si:
            raise UnitError(f"{self.quantity} is in {self.unit}, which cannot be shown in {symbol}")
        return lambda value: new.from_si(old.to_si(value))

    def _converted(self, convert: Callable[[Any], Any]) -> dict[str, Any]:
        """The fields that have the unit, converted."""
        raise NotImplementedError

    def _numbers(self) -> dict[str, Any]:
        """The value and what surrounds it, as plain values."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self}>"

    def _repr_html_(self) -> str:
        return f"<code>{escape(str(self))}</code>"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Reading(MeasurementResult):
    """One scalar read from one frame.

    Attributes:
        value: the estimate, in `unit`.
        low, high: the interval around it, in `unit`.
        calibrated_range: least and greatest value the calibration saw, in `unit`.
    """

    value: float
    low: float
    high: float
    calibrated_range: tuple[float, float]

    def contains(self, truth: float) -> bool:
        """Whether a value, in `unit`, lies in the interval."""
        return bool(self.low <= truth <= self.high)

    def _converted(self, convert: Callable[[Any], Any]) -> dict[str, Any]:
        least, greatest = self.calibrated_range
        ends = {"value": convert(self.value), "low": convert(self.low), "high": convert(self.high)}
        return {**ends, "calibrated_range": (convert(least), convert(greatest))}

    def _numbers(self) -> dict[str, Any]:
        return {
            "value": plain_number(self.value),
            "unit": self.unit,
            "low": plain_number(self.low),
            "high": plain_number(self.high),
            "range": [plain_number(end) for end in self.calibrated_range],
        }

    def __str__(self) -> str:
        half = (self.high - self.low) / 2
        return f"{self.quantity} {self.value:.3g} {self.unit} ± {half:.2g} {self.unit}, {self.verdict}"


class Readings(Mapping[str, MeasurementResult]):
    """The readings of one frame, each in the unit that the key asks for.

    The keys are the calibration's columns. A quantity's name alone gives it in SI, and with another unit of
    the same quantity behind it, in that one.

    Example:
        readings = estimator.read(frame)
        readings["depth_mm"].value      # in mm
        readings["depth_um"].value      # the same in µm
        readings["depth"].value         # the same in m
    """

    def __init__(self, readings: Mapping[str, MeasurementResult]) -> None:
        """Keep readings in SI by their columns.

        Args:
            readings: a reading for each column, whose name ends in its unit.
        """
        self._by_column = dict(readings)

    def __getitem__(self, key: str) -> Any:
        if key in self._by_column:
            return self._by_column[key].in_unit(split_column(key)[1].symbol)
        quantity, asked = split_column(key) if has_unit(key) else (key, None)
        alike = [one for one in self._by_column.values() if one.quantity in (key, quantity)]
        if asked is not None:
            alike = [one for one in alike if one.quantity == key or unit(one.unit).si == asked.si]
        if len(alike) != 1:
            several = f"{len(alike)} readings are called" if alike else "there is no reading"
            raise ColumnError(f"{several} {key!r}; there are {', '.join(self)}")
        (one,) = alike
        return one.in_unit(asked.symbol if asked is not None and one.quantity != key else unit(one.unit).si)

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_column)

    def __len__(self) -> int:
        return len(self._by_column)

    @property
    def valid(self) -> bool:
        """Whether every reading may be used."""
        return all(one.valid for one in self._by_column.values())

    def __repr__(self) -> str:
        return f"<Readings {'; '.join(str(one) for one in self.values())}>"

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><td>{name}</td><td>{escape(str(one))}</td></tr>" for name, one in self.items())
        return f"<table>{rows}</table>"


def plain_number(value: float) -> float | None:
    """Six significant digits, or None for what is not a number."""
    return float(f"{value:.6g}") if math.isfinite(value) else None
