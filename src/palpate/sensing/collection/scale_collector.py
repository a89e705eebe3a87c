"""Presses of a live sensor labelled by a scale of their own, which is not the sensor's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palpate.core import Closing, ForceSensor, Frame, Readings, Wrench
from palpate.sensing.collection.press_collector import PressCollector


class ScaleCollector(Closing):
    """Collector that asks a scale for its samples with each frame; it opens nothing, and closes both.

    Args:
        scale: that labels them. What a force sensor beside the camera says is not heard.
    """

    def __init__(self, collector: PressCollector, scale: ForceSensor) -> None:
        self._collector, self._scale = collector, scale

    @property
    def run(self) -> Path:
        """Run of the presses."""
        return self._collector.run

    @property
    def status(self) -> dict[str, Any]:
        """Status of the collector."""
        return self._collector.status

    def on_frame(self, frame: Frame, readings: Readings | None = None) -> None:
        """Take in what the scale has said since, then the frame."""
        self._collector.on_force(self._scale.drain())
        self._collector.on_frame(frame, readings)

    def on_force(self, samples: Sequence[Wrench]) -> None:
        """Nothing: another sensor's forces label nothing here."""

    def rezero(self) -> None:
        """Take the scale's zero anew."""
        self._collector.rezero()

    def label(self, force_n: float) -> None:
        """Refuse a weight that is typed, as the collector does beside a scale."""
        self._collector.label(force_n)

    def close(self) -> None:
        """Close the run whole, and the scale."""
        self._collector.close()
        self._scale.close()
