"""The live loop: frames as they come, the newest of them read, and whoever subscribed told.

One thread fetches frames into a place for the newest, another takes them from there, reads them and tells.
Frames of a camera that were not taken in time are replaced and counted, never queued; those of a file wait.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from palpate.core import (
    NS_PER_S,
    Closing,
    DeviceError,
    Frame,
    Image,
    InputError,
    PalpateError,
    Readings,
    Wrench,
)
from palpate.core.failure_log import record_failure, report_to_stderr
from palpate.core.reading import OF_ALL_FRAMES, frame_record, plain_number
from palpate.core.shared_history import SharedHistory
from palpate.sensing.live_sources import LiveSource, NoFrameYetError
from palpate.sensing.streaming.live_readers import FrameReader, mean_image
from palpate.sensing.streaming.live_slots import NewestSlot, Subscriber, SubscriberLine
from palpate.sensing.streaming.live_statistics import DriftWatch, LiveStatistics, StatisticsKeeper

GRAB_S = 0.25  # so that closing waits no longer
TAKE_S = 0.05  # between two looks at the force while no frame comes
SILENT_S = 2.0  # without a frame, after which a camera is lost
REOPEN_S = 0.5  # between two tries to open a lost camera
ZERO_FRAMES = 15  # half a second at 30 frames a second, in which a lamp's flicker shows
TOLD_S = 0.2  # age of the rate and latencies that a reading carries
BIAS_S = 0.5  # of the force sensor's last samples, whose median is its bias
MAX_FAULTS = 20


class LiveState(StrEnum):
    """State of a live loop.

    "lost" is a camera that went away, or is not there yet: it is opened again when it comes back.
    """

    OPENING = "opening"
    LIVE = "live"
    ENDED = "ended"
    FAILED = "failed"
    LOST = "lost"


@dataclass(frozen=True, slots=True, eq=False)
class LiveReading:
    """Frame and its readings.

    Attributes:
        time_s: Time by the source's clock [s].
        readings: Readings of the calibration; None without one.
        latency_s: Time from the arrival of the frame to its readings [s].
        image: 8-bit gray ``[h w]`` or RGB ``[h w 3]``.
        force_n: Normal force at the capture time, bias of the last zero removed; None without a sensor [N].
        why: Reason why the frame could not be decoded; empty otherwise.
    """

    frame: str
    number: int
    time_s: float
    readings: Readings | None
    latency_s: float
    image: Image
    force_n: float | None
    why: str
    source: str
    stats: LiveStatistics

    def to_dict(self) -> dict[str, Any]:
        """Plain values for one JSON object; those of `palpate read` and the loop's own."""
        return {
            **frame_record(self.frame, self.time_s, self.readings),
            "source": self.source,
            "number": self.number,
            "latency_ms": round(1e3 * self.latency_s, 3),
            "force_N": None if self.force_n is None else plain_number(self.force_n),
            "why": self.why,
            "rate_hz": None if self.stats.rate_hz is None else round(self.stats.rate_hz, 2),
            "dropped": self.stats.dropped,
            "lost": self.stats.lost,
        }


class LiveLoop(Closing):
    """Loop from a source to its subscribers, from `start` to `close`.

    Failures of a camera, subscriber, or force sensor do not end it; `status` reports each.
    """

    def __init__(
        self,
        opener: Callable[[], LiveSource],
        reader: FrameReader | None = None,
        *,
        source: LiveSource | None = None,
        subscribers: Sequence[Subscriber] = (),
        zero_at_start: bool = False,
        zero_frames: int = ZERO_FRAMES,
        hand_over: NewestSlot[LiveReading] | None = None,
        max_frames: int | None = None,
    ) -> None:
        """Prepare the loop.

        Args:
            opener: Opens the source, and reopens a lost camera.
            reader: Reader of the frames; None for frames alone.
            source: Source that is already open.
            zero_at_start: Take the first frames as no-contact frames.
            zero_frames: Number of frames averaged for the no-contact image.
            hand_over: Slot for a consumer; a file waits until it was emptied.
            max_frames: Number of frames after which it ends, each delivered; None for no limit.
        """
        self._opener, self._source = opener, source
        self._reader = reader
        self._drift = None if reader is None else DriftWatch(reader)
        self._frames: NewestSlot[Frame] = NewestSlot()
        if max_frames is not None and max_frames < 1:
            raise InputError(f"{max_frames} frames; ask for 1 or more, or None for no end")
        self._hand_over, self._left = hand_over, max_frames
        self._kept = StatisticsKeeper()
        self._zero_frames, self._zeros, self._zeroing = zero_frames, list[Frame](), zero_at_start
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._state, self._why = LiveState.OPENING, ""
        self._name = "" if source is None else source.name
        self._faults = SharedHistory[str](MAX_FAULTS)
        self._lines: list[SubscriberLine] = []
        self._latest: LiveReading | None = None
        self._wrench: Wrench | None = None
        self._bias_n = 0.0
        self._forces = SharedHistory[tuple[int, float]]()
        self._force_why = ""
        self._outages = 0
        self._untouched: Image | None = None
        self._untouched_frames: tuple[Image, ...] = ()
        self._last_arrival_s = time.monotonic()
        for one in subscribers:
            self.subscribe(one)
        self._grabber = threading.Thread(target=self._guarded, args=(self._grab_all,), daemon=True)
        self._worker = threading.Thread(target=self._guarded, args=(self._read_all,), daemon=True)
        self._grabber.name, self._worker.name = "palpate-live-grab", "palpate-live-read"

    def start(self) -> None:
        """Begin; returns at once."""
        if self._zeroing:
            self._let_rest(True)
        self._grabber.start()
        self._worker.start()

    def close(self) -> None:
        """End: what subscribers were promised they are given, then the source is closed."""
        self._closing.set()
        self._frames.close()
        if self._hand_over is not None:
            self._hand_over.close()
        for thread in (self._grabber, self._worker):
            if thread.is_alive() and thread is not threading.current_thread():
                thread.join(SILENT_S + 1.0)
        for line in self._lines:
            line.close()
        self._let_go()

    def subscribe(self, subscriber: Subscriber) -> None:
        """Tell one more of frames, readings and forces, from the next on."""
        line = SubscriberLine(subscriber, waits=self._waits, fault=self._faults.append)
        with self._lock:
            self._lines = [*(one for one in self._lines if not one.why), line]

    def unsubscribe(self, subscriber: Subscriber) -> None:
        """Tell this one no more, after it was given what waits for it."""
        with self._lock:
            gone = [line for line in self._lines if line.subscriber is subscriber]
            self._lines = [line for line in self._lines if line.subscriber is not subscriber]
        for line in gone:
            line.close()

    def zero(self, untouched: Image | None = None) -> None:
        """Take the untouched sensor anew: from an image, or from the next frames, with nothing on the skin.

        The force sensor's bias is taken at the same time.
        """
        with self._lock:
            self._zeros.clear()
            self._zeroing = untouched is None
        if untouched is None:
            self._let_rest(True)
        else:
            self._take_zero(untouched)

    def use(self, reader: FrameReader | None) -> None:
        """Read by another calibration from the next frame on; None shows frames without readings."""
        if reader is not None and self._untouched is not None:
            reader.zero(self._untouched)
        with self._lock:
            self._reader = reader
            self._drift = None if reader is None else DriftWatch(reader)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until it has ended; False where that did not come in time [s]."""
        self._worker.join(timeout_s)
        return not self._worker.is_alive()

    @property
    def name(self) -> str:
        """Name of its source; "" before it was opened."""
        return self._name

    @property
    def source(self) -> LiveSource | None:
        """Its source; None while there is none."""
        return self._source

    @property
    def frame_px(self) -> tuple[int, int] | None:
        """Height and width of the frames that its calibration reads [px]; None where that is any, or none."""
        found: tuple[int, int] | None = getattr(self._reader, "frame_px", None)
        return found

    @property
    def sensor(self) -> str:
        """Name of the sensor that its calibration is of; "" without one."""
        return str(getattr(self._reader, "sensor", ""))

    @property
    def doubt(self) -> str:
        """Whether its source may be of another sensor than its calibration, in words; "" else."""
        return str(getattr(self._reader, "doubt", ""))

    @property
    def state(self) -> LiveState:
        """State that it is in now."""
        return self._state

    @property
    def why(self) -> str:
        """Why it is in that state, where something went wrong."""
        return self._why

    @property
    def stats(self) -> LiveStatistics:
        """Counts and times so far."""
        return self._kept.now()

    @property
    def latest(self) -> LiveReading | None:
        """The newest reading; None before the first."""
        return self._latest

    @property
    def untouched(self) -> Image | None:
        """Image taken as that of the untouched sensor; None where none was taken here."""
        return self._untouched

    @property
    def untouched_frames(self) -> tuple[Image, ...]:
        """Frames that it was averaged from, the same object until others are taken; none without them."""
        return self._untouched_frames

    @property
    def zeroing(self) -> bool:
        """Whether frames of the untouched sensor are being taken."""
        return self._zeroing

    @property
    def faults(self) -> tuple[str, ...]:
        """Faults of late, oldest first: subscribers that were dropped, a force sensor that is gone."""
        return tuple(self._faults.items())

    @property
    def advice(self) -> str:
        """What to do about the sensor, in words; empty where nothing has to be done."""
        reader, latest, drift = self._reader, self._latest, self._drift
        if drift is not None and drift.advice:
            return drift.advice
        if needs := getattr(reader, "needs", ""):
            return str(needs)
        if reader is not None and latest is not None and latest.readings is not None and not latest.why:
            reasons = {(one.code, one.why) for one in latest.readings.values()}
            code, why = next(iter(reasons), ("", ""))
            if len(reasons) == 1 and code in OF_ALL_FRAMES:
                return why
        return ""

    def status(self) -> dict[str, Any]:
        """All of it as plain values, for a page or a log."""
        latest, reader = self._latest, self._reader
        reading = None
        if latest is not None and latest.readings is not None:
            reading = frame_record(latest.frame, latest.time_s, latest.readings)
            reading["force_N"] = None if latest.force_n is None else plain_number(latest.force_n)
        force = self._force_now()
        return {
            "state": self._state.value,
            "why": self._why,
            "source": self._name,
            "calibration": None if reader is None else reader.id,
            **self.stats.to_dict(),
            "outages": self._outages,
            "drift": None if self._drift is None else self._drift.to_dict(),
            "advice": self.advice,
            "doubt": self.doubt,
            "zeroing": self._zeroing,
            "zeroed": self._untouched is not None,
            "reading": reading,
            "force_N": None if force is None else plain_number(force),
            "force_why": self._force_why,
            "faults": self._faults.items(),
        }

    # The thread that fetches frames.

    def _grab_all(self) -> None:
        while not self._closing.is_set():
            try:
                source = self._source or self._open()
                frame = source.grab(GRAB_S)
            except NoFrameYetError as e:
                if not source.waits and time.monotonic() - self._last_arrival_s > SILENT_S:
                    self._lose(str(e))
                continue
            except DeviceError as e:
                if self._source is not None and self._source.waits:
                    self._end(LiveState.FAILED, str(e))
                    return
                self._lose(str(e))
                continue
            except PalpateError as e:
                self._end(LiveState.FAILED, str(e))
                return
            except Exception as e:  # a driver may fail in any way, and may work again
                if self._source is None or self._source.waits:
                    raise
                report_to_stderr(record_failure(e, f"the source {self._name}"))
                self._lose(f"{type(e).__name__}: {e}")
                continue
            if frame is None:
                self._end(LiveState.ENDED, str(getattr(source, "unfinished", "")))
                return
            self._arrive(frame, source)

    def _open(self) -> LiveSource:
        source = self._opener()
        self._source, self._name = source, source.name
        self._last_arrival_s = time.monotonic()
        if self._zeroing:
            self._let_rest(True)
        return source

    def _arrive(self, frame: Frame, source: LiveSource) -> None:
        if self._closing.is_set():
            return
        self._last_arrival_s = time.monotonic()
        if self._state not in (LiveState.LIVE, LiveState.FAILED):
            self._state, self._why = LiveState.LIVE, ""
        replaced = self._frames.put(frame, wait=source.waits)
        self._kept.arrived(frame.arrived_ns, frame.lost, int(replaced))

    def _lose(self, why: str) -> None:
        """Close a camera that is gone, and wait a little before it is opened again."""
        if self._closing.is_set():  # then it is gone because it was closed
            return
        if self._state is not LiveState.LOST:
            self._outages += self._state is LiveState.LIVE
            self._faults.append(why)
        self._state, self._why = LiveState.LOST, why
        self._let_go()
        self._closing.wait(REOPEN_S)

    def _let_go(self) -> None:
        source, self._source = self._source, None
        if source is not None:
            try:
                source.close()
            except PalpateError as e:
                self._faults.append(str(e))

    def _end(self, state: LiveState, why: str) -> None:
        if self._state is not LiveState.FAILED:  # the other thread's end does not hide why
            self._state, self._why = state, why
        self._frames.end()

    # The thread that reads them.

    def _read_all(self) -> None:
        while not self._frames.over:
            frame = self._frames.take(TAKE_S)
            self._poll_force()
            if frame is not None:
                self._read(frame)
                self._count_down()
        if self._hand_over is not None:
            self._hand_over.end()

    def _count_down(self) -> None:
        """End after the last of the frames that were asked for."""
        if self._left is None:
            return
        self._left -= 1
        if self._left <= 0:
            self._closing.set()  # nothing more is fetched
            self._end(LiveState.ENDED, "")
            self._frames.close()

    def _read(self, frame: Frame) -> None:
        if self._zeroing and not frame.fault and not getattr(self._source, "touched", False):
            self._collect_zero(frame)
        reader = self._reader
        readings = None if reader is None else reader.read(frame)
        done_ns = time.monotonic_ns()
        self._kept.read(frame.arrived_ns, done_ns, broken=bool(frame.fault))
        drift = self._drift
        if drift is not None and readings is not None and not frame.fault:
            drift.frame(frame.image, readings)
        self._tell(frame, readings, done_ns)

    def _tell(self, frame: Frame, readings: Readings | None, done_ns: int) -> None:
        latest = LiveReading(
            frame.name or str(frame.index),
            frame.index,
            frame.time_s,
            readings,
            (done_ns - frame.arrived_ns) / 1e9,
            frame.image,
            self._force_at(frame.time_s),
            frame.fault,
            self._name,
            self._kept.now(TOLD_S),
        )
        self._latest = latest
        for line in self._lines:
            line.frame(frame, readings)
        if self._hand_over is not None:
            self._hand_over.put(latest, wait=self._waits() or self._left is not None)

    def _waits(self) -> bool:
        source = self._source
        return source is not None and source.waits

    def _collect_zero(self, frame: Frame) -> None:
        with self._lock:  # `zero` restarts the collection from another thread
            if self._zeros and self._zeros[0].image.shape != frame.image.shape:
                self._zeros.clear()
            self._zeros.append(frame)
            if not self._zeroing or len(self._zeros) < self._zero_frames:
                return
            frames, self._zeros, self._zeroing = self._zeros, [], False
        images = [one.image for one in frames]
        self._untouched_frames = tuple(images)
        self._take_zero(mean_image(images))
        self._let_rest(False)

    def _let_rest(self, rest: bool) -> None:
        """Ask whoever presses to let go, or to go on, where that can be asked; a person is told in words."""
        let_rest = getattr(self._source, "let_rest", None)
        if let_rest is not None:
            let_rest(rest)

    def _take_zero(self, image: Image) -> None:
        self._untouched = image
        if forces := self._forces.items():
            self._bias_n = float(np.median([force for _, force in forces]))
        reader, drift = self._reader, self._drift
        if reader is not None:
            try:
                reader.zero(image)
            except PalpateError as e:
                self._faults.append(f"the sensor could not be zeroed: {e}")
        if drift is not None:
            drift.zeroed()

    # The force sensor beside the camera.

    def _poll_force(self) -> None:
        source = self._source
        force = None if source is None else source.force
        if force is None:
            return
        try:
            samples = force.drain()
        except DeviceError as e:
            if not self._force_why:
                self._faults.append(f"the force sensor: {e}")
            self._force_why = str(e)
            return
        self._force_why = ""
        good = [one for one in samples if not one.fault]
        if good:
            self._wrench = good[-1]
            self._forces.extend((one.time_ns, one.force_n[2]) for one in good)
            oldest_ns = good[-1].time_ns - BIAS_S * NS_PER_S
            self._forces.discard_while(lambda one: one[0] < oldest_ns)
        for line in self._lines if samples else ():
            line.force(samples)

    def _force_now(self) -> float | None:
        """The newest force; None where it fails, or its bias is yet to be taken."""
        wrench, unzeroed = self._wrench, self._zeroing and self._untouched is None
        return None if wrench is None or self._force_why or unzeroed else wrench.force_n[2] - self._bias_n

    def _force_at(self, time_s: float) -> float | None:
        """Force when a frame was taken, by the samples about it: a press may be newtons further by now."""
        if self._force_now() is None:
            return None
        times_ns, forces_n = zip(*self._forces.items(), strict=True)
        at = np.interp(time_s * NS_PER_S, np.array(times_ns, float), forces_n)
        return float(at) - self._bias_n

    def _guarded(self, work: Callable[[], None]) -> None:
        """Do a thread's work; what nobody thought of is told, and ends the loop as failed."""
        try:
            work()
        except Exception as e:
            failure = record_failure(e, f"the live loop of {self._name}")
            report_to_stderr(failure)
            self._end(LiveState.FAILED, failure.text)
            self._frames.close()
        finally:
            if work == self._read_all and self._hand_over is not None:
                self._hand_over.end()
