"""Writer of a run: frames, force, stage and events on one clock, on disk at least once a second.

Those who record put into a bounded queue; one thread writes, into a segment claimed under the run's lock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from threading import Condition, Event, Lock, Thread
from types import MappingProxyType, TracebackType
from typing import Any, BinaryIO, Literal

import numpy as np

from palpate.core import (
    NS_PER_S,
    Clock,
    Frame,
    Image,
    ImageError,
    InputError,
    MonotonicClock,
    PalpateError,
    PathText,
    RecordingError,
    StorageError,
    lock,
    new_folder,
)
from palpate.recordings.exchange import image_files
from palpate.recordings.label_tables import Label, finite, label_values
from palpate.recordings.manifest import MANIFEST, Manifest
from palpate.recordings.run_reader import Run
from palpate.recordings.segments import (
    EVENTS,
    FORCE,
    FRAMES,
    LABELS,
    RAW,
    RECORDED,
    STAGE,
    Channel,
    Segment,
    segment_numbers,
    segment_writer,
)

Overflow = Literal["drop", "wait"]

MAX_FRAME_BYTES = 32 << 20  # about half a second of encoding, so that what was accepted is soon on disk
MAX_SIGNALS = 1 << 16  # nine seconds of a 7 kHz force sensor


@dataclass(frozen=True, slots=True)
class Item:
    """Item to write, and when it was recorded [ns since 1970].

    Attributes:
        about: a frame's exposure and labels; None where it has neither.
    """

    channel: Channel
    time_ns: int
    data: bytes | Image
    about: dict[str, object] | None = None


class Buffer:
    """A first-in, first-out queue with room for so many frames, so many bytes of them, and so many signals.

    Signals have room of their own, so that a thousand force samples do not push out an image.
    """

    def __init__(self, frames: int, overflow: Overflow) -> None:
        self._items: deque[Item | Event] = deque()
        self._changed = Condition()
        self._max_frames = frames
        self._overflow = overflow
        self._frames = 0
        self._frame_bytes = 0
        self._closed = False
        self.dropped: dict[str, int] = {channel.name: 0 for channel in RECORDED}

    def put(self, item: Item) -> bool:
        """Queue an item; False when there was no room and it was counted as dropped, or after closing."""
        with self._changed:
            if self._overflow == "wait":
                self._changed.wait_for(lambda: self._closed or self._has_room(item))
            if self._closed:
                return False
            if not self._has_room(item):
                self.dropped[item.channel.name] += 1
                return False
            self._items.append(item)
            self._count(item, 1)
            self._changed.notify_all()
            return True

    def mark(self, reached: Event) -> None:
        """Queue a mark behind all that is inside, for which there is always room."""
        with self._changed:
            self._items.append(reached)
            self._changed.notify_all()

    def take(self, timeout_s: float) -> Item | Event | None:
        """The oldest item or mark; None when none came in time [s] or none can come."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._items, timeout_s)
            if not self._items:
                return None
            item = self._items.popleft()
            self._count(item, -1)
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Let nothing in any more; what is inside can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def drained(self) -> bool:
        """Whether nothing is inside and nothing can come."""
        with self._changed:
            return self._closed and not self._items

    def _has_room(self, item: Item) -> bool:
        if isinstance(item.data, bytes):
            return len(self._items) - self._frames < MAX_SIGNALS
        fits = self._frame_bytes + item.data.nbytes <= MAX_FRAME_BYTES
        return self._frames < self._max_frames and (fits or self._frames == 0)

    def _count(self, item: Item | Event, step: int) -> None:
        if isinstance(item, Item) and not isinstance(item.data, bytes):
            self._frames += step
            self._frame_bytes += step * item.data.nbytes


@dataclass(frozen=True)
class OpenedSegment:
    """A claimed segment of a locked run.

    Attributes:
        lock_file: the lock, until it is closed.
        start_ns: the segment's first instant [ns since 1970].
        zero_ns: what the clock's reading is added to, to count from 1970.
    """

    manifest: Manifest
    segment: Segment
    lock_file: BinaryIO
    start_ns: int
    zero_ns: int


def open_segment(path: Path, now_ns: int, note: Mapping[str, Any] | None) -> OpenedSegment:
    """Claim the next segment of a run; it begins when the clock reads `now_ns`."""
    if not (path / MANIFEST).is_file():
        Run.open(path).stored_manifest.write(path)  # it was lost, and a segment has kept a copy
    with ExitStack() as undo:
        lock_file = undo.enter_context(lock(path / MANIFEST))
        run = Run.open(path)
        number = max(segment_numbers(path), default=-1) + 1
        start_ns = _start(run, now_ns)
        stored = run.stored_manifest
        segment = Segment.claim(path, number, stored, begin_ns=start_ns, clock_ns=now_ns, note=note)
        undo.pop_all()
    return OpenedSegment(run.manifest, segment, lock_file, start_ns, start_ns - now_ns)


def _start(run: Run, now_ns: int) -> int:
    """Begin of the next segment [ns since 1970]: as the clock says, and after all that is there."""
    if not run.segments:
        return run.manifest.created_ns
    start_ns = run.end_ns + 1
    last = run.segments[-1]
    clock_ns = last.about.get("clock_ns")
    if last.begin_ns is not None and isinstance(clock_ns, int):
        start_ns = max(start_ns, last.begin_ns + now_ns - clock_ns)
    if start_ns > segment_writer.MAX_TIME_NS:
        raise RecordingError(f"{run.path} ends in 2038, beyond which no stamp can tell; record a new run")
    return start_ns


SYNC_EVERY_S = 0.5  # half of the second that is promised; the disk may take the rest
DROPPED = "dropped"  # the kind of event that the writer itself records
_MACHINE_CLOCK = MonotonicClock()


class RunWriter:
    """Appends to a run from any thread; a thread of its own encodes and writes.

    What was accepted is on disk a second later, also when few messages come, also when the process is then
    killed. A full queue drops what comes and counts it, or waits. Leaving the ``with`` block closes the
    segment, also after an exception.

    Every call raises `StorageError` once the disk has refused a write; all that was written before stays
    readable. Where the disk is full, `event` is still taken: room is held for what is said of a run's end,
    and for the segment's index.

    Example:
        >>> import tempfile
        >>> from palpate.recordings.run_reader import Run
        >>> manifest = Manifest.new(sensor="tactip-3", labels={"depth_mm": "number"})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with RunWriter.create(Path(folder, "run"), manifest) as writer:
        ...         writer.frame(np.zeros((48, 64), np.uint8), labels={"depth_mm": 1.5})
        ...     Run.open(Path(folder, "run")).labels["depth_mm"].tolist()
        True
        [1.5]
    """

    def __init__(self, opened: OpenedSegment, clock: Clock, buffer: Buffer) -> None:
        self._opened = opened
        self._segment = opened.segment
        self._labels = opened.manifest.labels
        self._clock = clock
        self._latest = dict.fromkeys(segment_writer.RECORDED, opened.start_ns)
        self._locks = {channel: Lock() for channel in segment_writer.RECORDED}
        self._buffer = buffer
        self._reported = dict(buffer.dropped)
        self._stored = 0
        self._failure: BaseException | None = None
        self._full = False
        self._closed = False
        self._thread = Thread(target=self._work, name="palpate-run-writer", daemon=True)
        self._thread.start()

    @classmethod
    def create(
        cls,
        path: PathText,
        manifest: Manifest,
        *,
        clock: Clock = _MACHINE_CLOCK,
        queue_frames: int = 64,
        overflow: Overflow = "drop",
        note: Mapping[str, Any] | None = None,
    ) -> RunWriter:
        """Begin a run in a new folder; its time starts now.

        Args:
            path: the folder, which must not exist.
            clock: what stamps messages that come without a time.
            queue_frames: how many frames may wait to be written.
            overflow: drop and count what finds the queue full, or let its caller wait.
            note: what the segment's files begin with, on disk before this returns; of JSON's types.
        """
        buffer = _buffer(queue_frames, overflow)
        path, now_ns = Path(path), clock.now_ns()
        with new_folder(path) as folder:
            manifest.write(folder)
        return cls(open_segment(path, now_ns, note), clock, buffer)

    @classmethod
    def resume(
        cls,
        path: PathText,
        *,
        clock: Clock = _MACHINE_CLOCK,
        queue_frames: int = 64,
        overflow: Overflow = "drop",
        note: Mapping[str, Any] | None = None,
    ) -> RunWriter:
        """Begin the next segment of a run; nothing that is there is touched.

        Time continues on the same clock, and strictly after all that can be read. After a restart of the
        machine, whose clock then starts anew, the length of the pause is not known.
        """
        buffer = _buffer(queue_frames, overflow)
        return cls(open_segment(Path(path), clock.now_ns(), note), clock, buffer)

    def frame(
        self,
        image: np.ndarray,
        *,
        time_ns: int | None = None,
        exposure_s: float | None = None,
        labels: Mapping[str, Label] | None = None,
    ) -> bool:
        """Record an image, which is copied: the caller may reuse it at once.

        Args:
            image: 8-bit grey ``[h w]`` or RGB ``[h w 3]``.
            time_ns: when it was taken, on the writer's clock [ns]; now when left out.
            exposure_s: how long [s].
            labels: what is known of it; columns may be left out, and then count as missing.

        Returns:
            False when the queue was full and the frame was dropped and counted.
        """
        Frame(image)
        if image.shape[0] * image.shape[1] > image_files.MAX_PIXELS:
            raise ImageError(
                f"an image {list(image.shape)} is too large; at most {image_files.MAX_PIXELS} pixels"
            )
        about: dict[str, object] = {}
        if exposure_s is not None:
            about["exposure_s"] = finite([exposure_s], 1, "exposure [s]")[0]
        if labels:
            about["labels"] = label_values(labels, self._labels)
        return self._put(FRAMES, time_ns, lambda _: np.array(image, order="C"), about or None)

    def force(
        self, wrench: Sequence[float] | np.ndarray, *, time_ns: int | None = None, raw: bool = False
    ) -> bool:
        """Record force [N] and torque [Nm] along x, y, z; False when dropped.

        Args:
            wrench: in the skin's axes, the normal force positive in compression.
            time_ns: when it was measured, on the writer's clock [ns]; now when left out.
            raw: it is what the sensor said, in its own axes and with its bias: recorded apart.
        """
        values = finite(wrench, 6, "force and torque [N, Nm]")
        return self._put(
            RAW if raw else FORCE, time_ns, lambda at_ns: segment_writer.encode_wrench(values, at_ns)
        )

    def stage(self, position_m: Sequence[float] | np.ndarray, *, time_ns: int | None = None) -> bool:
        """Record where the stage is [m]; False when dropped."""
        values = finite(position_m, 3, "stage position [m]")
        return self._put(STAGE, time_ns, lambda at_ns: segment_writer.encode_point(values, at_ns))

    def event(self, kind: str, **fields: Any) -> bool:
        """Record that something happened; False when dropped. A full disk still has room for some."""
        if kind == DROPPED:
            raise InputError(
                f"events of kind {DROPPED!r} are the writer's own; choose another kind", code="event-kind"
            )
        data = segment_writer.encode_json({"kind": kind, "fields": fields})
        return self._put(EVENTS, None, lambda _: data)

    def sync(self) -> None:
        """Wait until the disk holds all that was accepted so far."""
        self._refuse_if_over()
        mark = Event()
        self._buffer.mark(mark)
        while not mark.wait(SYNC_EVERY_S):
            self._refuse_if_over()
        self._raise_failure()

    @property
    def dropped(self) -> Mapping[str, int]:
        """Count of messages of each channel that found no room in this segment's queue."""
        return MappingProxyType(self._buffer.dropped)

    @property
    def stored(self) -> int:
        """Count of frames that were written in this segment."""
        return self._stored

    def close(self) -> None:
        """Write what is queued, close the segment and let go of the run. Closing again does nothing."""
        if self._closed:
            return
        self._closed = True
        self._buffer.close()
        self._thread.join()
        self._opened.lock_file.close()
        self._raise_failure()

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except PalpateError as e:
            if error is None:
                raise
            if str(e) != str(error):
                error.add_note(str(e))

    def _put(
        self,
        channel: Channel,
        time_ns: int | None,
        data: Callable[[int], bytes | Image],
        about: dict[str, object] | None = None,
    ) -> bool:
        self._refuse_if_over(channel)
        with self._locks[channel]:
            at_ns = self._stamp(channel, time_ns)
            accepted = self._buffer.put(Item(channel, at_ns, data(at_ns), about))
        if not accepted:
            self._refuse_if_over(channel)
        return accepted

    def _refuse_if_over(self, channel: Channel | None = None) -> None:
        if not (self._full and channel is EVENTS):
            self._raise_failure()
        if self._closed:
            raise RecordingError("this writer is closed; resume the run to record more")

    def _stamp(self, channel: Channel, time_ns: int | None) -> int:
        """The time of a message since 1970 [ns], never before the channel's last."""
        if time_ns is None:
            time_ns = self._clock.now_ns()
        elif not isinstance(time_ns, Integral):
            raise InputError(f"time_ns is a whole number of ns on the writer's clock, got {time_ns!r}")
        at_ns = int(time_ns) + self._opened.zero_ns
        if not self._latest[channel] <= at_ns <= segment_writer.MAX_TIME_NS:
            least = self._latest[channel] - self._opened.zero_ns
            raise InputError(
                f"{channel.name} at {time_ns} ns, but time only goes forwards, to 2038 at most: give "
                f"{least} ns or more here; sort what is recorded, or stamp it on the writer's own clock",
                code="time-order",
            )
        self._latest[channel] = at_ns
        return at_ns

    def _raise_failure(self) -> None:
        if isinstance(self._failure, PalpateError):
            raise type(self._failure)(str(self._failure), code=self._failure.code) from self._failure
        if self._failure is not None:
            raise RecordingError(f"the run could not be written: {self._failure!r}") from self._failure

    def _work(self) -> None:
        """The thread: take, write, and sync by the machine's time, whatever clock the run is on."""
        try:
            try:
                self._write_until_drained()
            finally:
                self._segment.close()
        except BaseException as e:
            self._failure = e
        finally:
            self._buffer.close()

    def _write_until_drained(self) -> None:
        due_s = 0.0
        while not self._buffer.drained:
            item = self._buffer.take(max(0.0, due_s - _now_s()))
            if isinstance(item, Event):
                self._segment.sync()
                item.set()
            elif item is not None:
                self._store_if_room(item)
            if _now_s() >= due_s:
                self._report_drops()
                self._segment.sync()
                due_s = _now_s() + SYNC_EVERY_S
        self._report_drops()

    def _store_if_room(self, item: Item) -> None:
        """Store an item; once the disk is full, the events of the run's end alone."""
        if self._full and item.channel is not EVENTS:
            return
        try:
            self._store(item)
        except StorageError as e:
            if self._segment.broken:
                raise
            self._failure, self._full = self._failure or e, True
            if item.channel is EVENTS:
                self._store(item)

    def _store(self, item: Item) -> None:
        if isinstance(item.data, bytes):
            self._segment.signals.write(item.channel, item.time_ns, 0, item.data, last=self._full)
            return
        image = segment_writer.encode_image(image_files.encode(item.data), item.time_ns)
        about = segment_writer.encode_json({"frame": self._stored, **(item.about or {})})
        self._segment.signals.hold(len(about))  # first, so that no frame is left without its record
        self._segment.frames.write(FRAMES, item.time_ns, self._stored, image)
        self._segment.signals.write(LABELS, item.time_ns, 0, about)
        self._stored += 1

    def _report_drops(self) -> None:
        """Record how many were dropped so far, where that has changed."""
        for name, count in self._buffer.dropped.items():
            if count != self._reported[name]:
                at_ns = max(self._latest[EVENTS], self._clock.now_ns() + self._opened.zero_ns)
                fields = {"channel": name, "count": count}
                data = segment_writer.encode_json({"kind": DROPPED, "fields": fields})
                self._store_if_room(Item(EVENTS, at_ns, data))
                self._reported[name] = count


def _now_s() -> float:
    return _MACHINE_CLOCK.now_ns() / NS_PER_S


def _buffer(queue_frames: int, overflow: Overflow) -> Buffer:
    if queue_frames < 1 or overflow not in ("drop", "wait"):
        raise InputError(
            f"queue_frames={queue_frames!r}, overflow={overflow!r}: give 1 frame or more, and drop or wait",
            code="queue",
        )
    return Buffer(queue_frames, overflow)
