"""The loop: frames in, readings out, with the time each took.

Live readings in Python: ``for reading in palpate.live("cal", camera=0): ...``, async as well.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import Closing, DeviceError, Image, PathText, Readings
from palpate.core.reading import ReasonCode, Refusal, frame_record
from palpate.estimators.certified import Estimator, Zero
from palpate.estimators.session_folder import calibration_in
from palpate.recordings.exchange.image_files import read_image
from palpate.sensing.frame_sources import FileFrames
from palpate.sensing.live_loop import LiveLoop, LiveReading, LiveState
from palpate.sensing.live_sources import LiveSource, open_live_source
from palpate.sensing.streaming.live_readers import FrameReader, open_reader
from palpate.sensing.streaming.live_slots import NewestSlot, Subscriber
from palpate.sensing.streaming.live_statistics import LiveStatistics


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

    def to_dict(self) -> dict[str, Any]:
        """Plain values for one JSON object; None for a value that could not be read."""
        return frame_record(self.frame, self.time_s, self.readings)


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


TAKE_S = 0.1  # so that an interrupt is heard


class Live(Closing):
    """Readings of one sensor as they arrive, for one iteration; made by `live`.

    A slow consumer receives the newest reading of a camera and every reading of a file. Leaving the ``with``
    block releases the camera.
    """

    def __init__(self, loop: LiveLoop, slot: NewestSlot[LiveReading]) -> None:
        self.loop = loop
        self._slot = slot
        self._begun = False

    def __iter__(self) -> Iterator[LiveReading]:
        self.start()
        return self

    def __next__(self) -> LiveReading:
        self.start()
        while True:
            reading = self.take(TAKE_S)
            if reading is not None:
                return reading
            if self.over:
                self.refuse_failed()
                raise StopIteration

    def __aiter__(self) -> AsyncIterator[LiveReading]:
        self.start()
        return self

    async def __anext__(self) -> LiveReading:
        self.start()
        while True:
            reading = await asyncio.to_thread(self.take, TAKE_S)
            if reading is not None:
                return reading
            if self.over:
                self.refuse_failed()
                raise StopAsyncIteration

    async def __aenter__(self) -> Live:
        return self

    async def __aexit__(self, *_: object) -> None:
        await asyncio.to_thread(self.close)

    def __del__(self) -> None:
        if not sys.is_finalizing():
            self.close()

    def zero(self, untouched: Image | None = None) -> None:
        """Take the untouched sensor anew: from an image, or the next frames, with nothing on the skin."""
        self.loop.zero(untouched)

    @property
    def stats(self) -> LiveStatistics:
        """Counts and times so far."""
        return self.loop.stats

    @property
    def advice(self) -> str:
        """What to do about the sensor, in words; empty where nothing has to be done."""
        return self.loop.advice

    def close(self) -> None:
        """End, and let go of the camera. Closing again does nothing."""
        self.loop.close()

    def start(self) -> None:
        """Begin, as the first reading that is asked for does. Doing it again does nothing."""
        if not self._begun:
            self._begun = True
            self.loop.start()

    def take(self, timeout_s: float) -> LiveReading | None:
        """The next reading; None where none came in time, or all was read."""
        return self._slot.take(timeout_s)

    @property
    def over(self) -> bool:
        """Whether all was read, or it was closed."""
        return self._slot.over

    def refuse_failed(self) -> None:
        """Raise what ended it, where that was a failure."""
        if self.loop.state is LiveState.FAILED:
            raise DeviceError(self.loop.why)


def live(
    calibration: PathText | None = None,
    *,
    camera: str | int | Path = 0,
    zero: bool | Image | PathText | None = None,
    settings: Any = None,
    paced: bool = False,
    idle_s: float = 2.0,
    threads: int = 1,
    shear: str = "",
    subscribers: Sequence[Subscriber] = (),
    max_frames: int | None = None,
) -> Live:
    """Open a sensor and read it live.

    Args:
        calibration: Folder of a calibration or of a session with calibrations; None for frames alone.
        camera: Address as of `open_live_source`.
        zero: No-contact image or its path; True takes it from the first frames, False does not. None takes
            it from the first frames of a camera, or from a run's own no-contact frames.
        settings: Settings of a USB camera, `palpate.rig.real.uvc_camera.UvcSettings`.
        paced: Play a file at its own rate and drop late frames.
        idle_s: Time without frames after which a growing folder or run has ended [s].
        threads: Threads of the inference engine; 0 lets it choose.
        shear: Sensor with a patterned skin, such as "nusense:7", or a file of one: touch is read from its
            marks, in newtons with a calibration of `palpate calibrate --method shear-force`.
        subscribers: Further receivers of frames, readings, and forces.
        max_frames: Number of frames after which it ends; None for no limit.

    Example:
        for reading in palpate.live("cal", camera=0):
            print(reading.readings["force_N"])
    """

    def opener() -> LiveSource:
        return open_live_source(camera, settings=settings, paced=paced, idle_s=idle_s)

    calibration = None if calibration is None else calibration_in(calibration)
    image: Image | None = None
    if zero is not None and not isinstance(zero, bool):
        image = zero if isinstance(zero, np.ndarray) else read_image(zero)
    source = opener()
    try:
        reader: FrameReader | None = None
        if shear:
            from palpate.sensing.streaming.touch_readers import open_shear_reader

            reader = open_shear_reader(shear, calibration, reference=image)
        elif calibration is not None:
            reader = open_reader(calibration, source, reference=image, threads=threads)
        slot: NewestSlot[LiveReading] = NewestSlot()
        at_start = zero if isinstance(zero, bool) else image is None and not source.waits
        loop = LiveLoop(
            opener, reader, source=source, subscribers=subscribers, zero_at_start=at_start, hand_over=slot,
            max_frames=max_frames,
        )  # fmt: skip
    except BaseException:
        source.close()
        raise
    return Live(loop, slot)
