"""Words of readings in a terminal's line: each value in units of a bench, with interval and verdict."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from palpate.core import MeasurementResult, Readings

BENCH_UNITS = {"m": "mm", "rad": "deg"}
"""Units in which a line tells what a reader gives in SI; others stay as the calibration has them."""


def reading_words(readings: Readings) -> list[str]:
    """Parts of a line: readings that have a value, and then those that have none, each reason once.

    Example:
        "x -11.541 mm ± 0.013 mm, inside the calibrated range", "y, rotation –: no contact"
    """
    told: list[str] = []
    without: dict[str, list[str]] = {}
    for one in readings.values():
        if _has_value(one):
            told.append(_in_bench_units(one))
        else:
            without.setdefault(one.verdict, []).append(one.quantity)
    return told + [f"{', '.join(names)} –: {why}" for why, names in without.items()]


def _has_value(reading: MeasurementResult) -> bool:
    value = getattr(reading, "value", "")
    return not math.isnan(value) if isinstance(value, float) else not isinstance(value, str) or bool(value)


def _in_bench_units(reading: MeasurementResult) -> str:
    shown = reading.in_unit(BENCH_UNITS[reading.unit]) if reading.unit in BENCH_UNITS else reading
    return str(shown).replace(" ratio", "")
