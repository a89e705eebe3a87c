"""Readers of live frames: what turns one into readings, and what it must know of the untouched sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from palpate.core import Drift, Frame, Image, ImageError, PathText, Readings
from palpate.core.reading import ReasonCode, Refusal
from palpate.estimators.certified import Estimator, Zero
from palpate.sensing.live_sources import LiveSource
from palpate.sensing.streaming.live_slots import refuse_other_sensor, stated_sensor

Zeros = dict[int, Zero]
"""Untouched images of single frames, by their numbers."""
NO_ZERO = Refusal(
    ReasonCode.NO_REFERENCE_IMAGE,
    "this calibration reads the difference to the untouched sensor, and there is no image of it yet: take "
    "everything off the skin and zero it",
)


@runtime_checkable
class FrameReader(Protocol):
    """Reader of one frame after another, in their order."""

    @property
    def id(self) -> str:
        """Id of the calibration."""

    @property
    def differential(self) -> bool:
        """Whether it reads the difference to the untouched sensor."""

    def read(self, frame: Frame) -> Readings:
        """Readings of a frame; not valid, with the reason, where it cannot be read."""

    def zero(self, untouched: Image) -> Drift | None:
        """Take an image as that of the untouched sensor; its drift since calibration where that is known."""

    def drift_of(self, image: Image) -> Drift | None:
        """Distance of an image from the calibration's untouched sensor; None where that is not known."""

    def kind_of(self, image: Image) -> str:
        """Kind of change that an image looks most like, by the guard's names; "" for none."""


class CalibrationReader:
    """Reads frames with a calibration folder, as `palpate read` does.

    Attributes:
        doubt: Reason why the source may be another sensor than the calibration's; "" for none.
    """

    def __init__(self, estimator: Estimator, zero: Zero | None = None) -> None:
        self.estimator = estimator
        self.doubt = ""
        self._zero, self._zeros = zero, Zeros()

    def attach(self, source: LiveSource) -> None:
        """Take the untouched images that a source has within, as a run does, unless one was given."""
        former = self.estimator.card.copy_of
        of_copy = former is not None and former.name == stated_sensor(source)
        self.doubt = "" if of_copy else refuse_other_sensor(self.estimator.card.sensor, source)
        run: Any = getattr(source, "run", None)
        if run is not None and self._zero is None:
            from palpate.calibration.evaluation import zeros_of  # loads tables, which no camera needs

            self._zeros = zeros_of(self.estimator, run)

    @property
    def id(self) -> str:
        """Id of the calibration."""
        return self.estimator.card.id

    @property
    def differential(self) -> bool:
        """Whether it reads the difference to the untouched sensor."""
        return bool(self.estimator.card.input.delta)

    @property
    def sensor(self) -> str:
        """Name of the sensor that it was calibrated on."""
        return self.estimator.card.sensor

    @property
    def frame_px(self) -> tuple[int, int]:
        """Height and width of the frames that it reads [px]."""
        return self.estimator.card.input.frame_px

    def read(self, frame: Frame) -> Readings:
        """Readings of a frame, those of `Estimator.read`."""
        if frame.fault:
            return self.estimator.unread(
                frame.name, frame.time_s, Refusal(ReasonCode.UNREADABLE, frame.fault)
            )
        zero = self._zero or self._zeros.get(frame.index)
        if zero is None and self.differential:
            return self.estimator.unread(frame.name, frame.time_s, NO_ZERO)
        return self.estimator.read(frame, zero)

    def zero(self, untouched: Image) -> Drift | None:
        """Take an image as that of the untouched sensor."""
        self._zero = self.estimator.zero(untouched)
        return self._zero.drift

    def drift_of(self, image: Image) -> Drift | None:
        """Distance of an image from the calibration's untouched sensor."""
        if image.shape[:2] != self.estimator.card.input.frame_px:
            return None
        return self.estimator.zero(image).drift

    def kind_of(self, image: Image) -> str:
        """Kind of change that the guard sees in an image that it refuses; "" for none."""
        verdict = self.estimator.verdict(Frame(image))
        return verdict.kind if verdict.atypicality > 1 else ""


def open_reader(
    calibration: PathText,
    source: LiveSource | None = None,
    *,
    reference: Image | None = None,
    threads: int = 1,
) -> CalibrationReader:
    """Open a calibration for live frames.

    Args:
        source: of the frames; a run has the untouched sensor's images within.
        threads: of the inference engine; 0 lets it choose.
    """
    folder = Path(calibration)
    estimator = Estimator.open(folder, threads=threads)
    reader = CalibrationReader(estimator, None if reference is None else estimator.zero(reference))
    if source is not None:
        reader.attach(source)
    return reader


def mean_image(images: list[Image]) -> Image:
    """Mean of several images in whole grey levels, as a run's untouched frames are averaged."""
    if len({image.shape for image in images}) != 1:
        raise ImageError("no images, or of different sizes; the untouched sensor is filmed as it is used")
    return np.asarray(np.mean(images, axis=0).round(), np.uint8)
