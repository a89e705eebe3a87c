"""The loop: frames in, readings out, with the time each took."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from palpate.core import Readings
from palpate.core.refusal import ReasonCode, Refusal
from palpate.estimators.certified import Estimator, Zero
from palpate.sensing.frame_sources import FileFrames


@dataclass(frozen=True, slots=True)
class Sensed:
    """Readings of one frame.

    Attributes:
        time_s: Capture time [s].
        latency_s: Time from the decoded image to the readings [s].
    """

    frame: str
    time_s: float
    readings: Readings
    latency_s: float

    def shown(self) -> Readings:
        """Deprecated: the readings, which are in the units of their columns themselves."""
        warnings.warn("shown() is deprecated: readings are in their keys' units", DeprecationWarning, 2)
        return self.readings

    def to_dict(self) -> dict[str, Any]:
        """Plain values for one JSON object; None for a value that could not be read."""
        first = next(iter(self.readings.values()))
        return {
            "frame": self.frame,
            "time_s": round(self.time_s, 6),
            "readings": {name: reading.to_dict() for name, reading in self.readings.items()},
            "drift": None if first.drift is None else first.drift.to_dict(),
            "calibration": first.calibration,
        }


def sense(estimator: Estimator, source: FileFrames, zero: Zero | None = None) -> Iterator[Sensed]:
    """Read every frame of a source.

    Args:
        source: where frames come from.
        zero: the untouched sensor; a run that recorded it by the calibration's rule needs none.
    """
    zeros: dict[int, Zero] = {}
    if zero is None and source.run is not None:
        from palpate.calibration.evaluation import zeros_of  # loads tables, which no image needs

        zeros = zeros_of(estimator, source.run)
    for i, frame in enumerate(source):
        started = time.perf_counter()
        if frame.fault:
            readings = estimator.unread(frame.name, frame.time_s, Refusal(ReasonCode.UNREADABLE, frame.fault))
        else:
            readings = estimator.read(frame, zero or zeros.get(i))
        yield Sensed(frame.name, frame.time_s, readings, time.perf_counter() - started)
