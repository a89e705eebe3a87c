"""The loop: frames in, readings out, with the time each took."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from palpate.calibration.evaluate import zeros_of
from palpate.core.reading import Drift, Reading
from palpate.estimators.certified import Estimator, Zero
from palpate.live.sources import RunFrames, Source, Unreadable


@dataclass(frozen=True, slots=True)
class Sensed:
    """What one frame told.

    Attributes:
        frame: its name.
        time_s: its capture time [s].
        readings: in SI, by target column.
        columns: unit symbol of each column, to show it in.
        latency_s: from the image in memory to the readings [s].
    """

    frame: str
    time_s: float
    readings: Mapping[str, Reading]
    columns: Mapping[str, str]
    latency_s: float

    def shown(self) -> dict[str, Reading]:
        """The readings in the units of their columns."""
        return {name: reading.in_unit(self.columns[name]) for name, reading in self.readings.items()}

    def to_dict(self) -> dict[str, Any]:
        """As one JSON object; a value that could not be read is null."""
        shown = self.shown()
        first = next(iter(shown.values()))
        return {
            "frame": self.frame,
            "time_s": round(self.time_s, 6),
            "readings": {name: _reading(reading) for name, reading in shown.items()},
            "drift": _drift(first.drift),
            "calibration": first.calibration,
        }


def sense(estimator: Estimator, source: Source, zero: Zero | None = None) -> Iterator[Sensed]:
    """Read every frame of a source.

    Args:
        estimator: the calibration.
        source: where frames come from.
        zero: the untouched sensor; a run that recorded it by the calibration's rule needs none.

    Raises:
        ImageError: the calibration is differential, and there is no image of the untouched sensor.
    """
    zeros = zeros_of(estimator, source.run) if zero is None and isinstance(source, RunFrames) else {}
    columns = {target.column: target.unit for target in estimator.card.targets}
    for i, frame in enumerate(source):
        started = time.perf_counter()
        if isinstance(frame, Unreadable):
            readings = estimator.unread(frame.name, frame.time_s, frame.why)
        else:
            readings = estimator.read(frame, zero or zeros.get(i))
        yield Sensed(frame.name, frame.time_s, readings, columns, time.perf_counter() - started)


def _reading(reading: Reading) -> dict[str, Any]:
    return {
        "value": _number(reading.value),
        "unit": reading.unit,
        "low": _number(reading.low),
        "high": _number(reading.high),
        "range": [_number(end) for end in reading.calibrated_range],
        "valid": reading.valid,
        "why": reading.why,
    }


def _drift(drift: Drift | None) -> dict[str, Any] | None:
    if drift is None:
        return None
    return {"statistic": _number(drift.statistic), "limit": _number(drift.limit), "drifted": drift.drifted}


def _number(value: float) -> float | None:
    """Six significant digits, or null for what is not a number."""
    return float(f"{value:.6g}") if math.isfinite(value) else None
