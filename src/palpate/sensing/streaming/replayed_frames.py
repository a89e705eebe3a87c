"""Frames of what lies on disk or comes through a pipe, also while it is still being written."""

from __future__ import annotations

import os
import select
import sys
import time
from collections import deque
from pathlib import Path
from typing import BinaryIO

from palpate.core import (
    NS_PER_S,
    Closing,
    ForceSensor,
    Frame,
    ImageError,
    PalpateError,
    RecordingError,
    StorageError,
    lock,
    storage_errors,
)
from palpate.recordings.exchange.image_files import IMAGE_SUFFIXES, image_from_bytes, read_image
from palpate.recordings.exchange.image_stream import ImageCutter
from palpate.recordings.manifest import MANIFEST, StoredManifest
from palpate.recordings.segments import file_name, frames_in, scan, scan_growing, segment_numbers
from palpate.sensing.frame_sources import open_source
from palpate.sensing.live_sources import LiveSource, NoFrameYetError

GROWS_LOOK_S = 0.02  # between two looks at what is being written
STEADY_S = 0.3  # after which a file that cannot be read, and does not change, never will be
CHUNK = 1 << 16


class GrowingFrames(Closing):
    """Frames of a folder or run that is still being written, until nothing arrives for `idle_s`."""

    unfinished = ""

    waits = True
    force: ForceSensor | None = None

    def __init__(self, path: Path, idle_s: float) -> None:
        """Follow it.

        Args:
            idle_s: after which it has ended where nothing more came [s].
        """
        self.name = str(path)
        self._path, self._idle_s = path, idle_s
        self._found: deque[Frame] = deque()
        self._number = 0
        self._news_s: float | None = None

    def grab(self, timeout_s: float) -> Frame | None:
        """Return the next frame; None after `idle_s` without one, or once its writer closed the run."""
        end_s = time.monotonic() + timeout_s
        if self._news_s is None:  # however long it takes to be looked at after it was opened
            self._news_s = time.monotonic()
        while True:
            with storage_errors(self._path):
                item = self._next()
                ended = item is None and self._ended()
            now_s = time.monotonic()
            if item is not None:
                self._number, self._news_s = self._number + 1, now_s
                return item.arrived(self._number - 1)
            if ended or (now_s - self._news_s >= self._idle_s and not self._is_pending()):
                return None
            if now_s >= end_s:
                raise NoFrameYetError(f"nothing new lies in {self.name} since {timeout_s:g} s")
            time.sleep(min(GROWS_LOOK_S, max(end_s - now_s, 1e-3)))

    def close(self) -> None:
        """Forget it; nothing is held open."""
        self._idle_s = 0.0

    def _next(self) -> Frame | None:
        raise NotImplementedError

    def _ended(self) -> bool:
        return False

    def _is_pending(self) -> bool:
        """Whether something was found that has not been read yet."""
        return False


class FillingFolder(GrowingFrames):
    """Images of a folder in the order in which they appear, those of one look by their names."""

    may_change = True

    def __init__(self, path: Path, idle_s: float) -> None:
        super().__init__(path, idle_s)
        self._known: set[str] = set()
        self._unread: deque[Path] = deque()
        self._size, self._since_s = -1, 0.0

    def _next(self) -> Frame | None:
        if not self._unread:
            names = {name for name in os.listdir(self._path) if Path(name).suffix.lower() in IMAGE_SUFFIXES}
            self._unread.extend(self._path / name for name in sorted(names - self._known))
            self._known |= names
            if self._unread:
                self._news_s = time.monotonic()
        if not self._unread:
            return None
        path = self._unread[0]
        try:
            item = Frame(read_image(path), float(self._number), name=path.name)
        except ImageError as e:
            if self._is_written(path):
                return None
            item = Frame.unreadable(str(e), float(self._number), path.name)
        self._unread.popleft()
        self._size = -1
        return item

    def _is_pending(self) -> bool:
        return bool(self._unread)

    def _is_written(self, path: Path) -> bool:
        """Whether a file that cannot be read has changed of late, and so may be read later."""
        size = path.stat().st_size if path.is_file() else 0
        if size != self._size:
            self._size, self._since_s = size, time.monotonic()
        return time.monotonic() - self._since_s < STEADY_S


class GrowingRun(GrowingFrames):
    """Frames of a run as its writer stores them, at most about a second later.

    Each file is read from where it was left, so the cost does not grow with the length.
    """

    def __init__(self, path: Path, idle_s: float) -> None:
        super().__init__(path, idle_s)
        self.manifest = StoredManifest.read(path).manifest
        self._segment, self._offset = -1, 0

    def _next(self) -> Frame | None:
        if not self._found and not self._look(self._segment):
            later = [number for number in segment_numbers(self._path) if number > self._segment]
            if later:
                self._segment, self._offset = later[0], 0
                self._look(self._segment)
        return self._found.popleft() if self._found else None

    def _look(self, number: int) -> bool:
        """Read what is new in a segment; False where there is nothing."""
        path = self._path / file_name(number, "frames")
        if number < 0 or not path.is_file() or path.stat().st_size <= self._offset:
            return False
        chunks, self._offset = scan_growing(path, self._offset)
        for stored in frames_in(path, chunks):
            at_s = (stored.time_ns - self.manifest.created_ns) / NS_PER_S
            index = self._number + len(self._found)
            try:
                image = stored.image(check=False)  # compared with its checksum a moment ago
            except PalpateError as e:
                self._found.append(Frame.unreadable(str(e), at_s, str(index)))
                continue
            self._found.append(Frame(image, at_s, None, self.manifest.sensor, str(index)))
        return bool(self._found)

    def _closed(self, number: int) -> bool:
        path = self._path / file_name(number, "frames")
        return path.is_file() and scan(path).data_end is not None

    def _ended(self) -> bool:
        last = max(segment_numbers(self._path), default=-1)
        return self._segment == last >= 0 and self._closed(last)

    @property
    def unfinished(self) -> str:  # type: ignore[override]
        """Why the run is not whole though its writer is gone, in words; empty where it is."""
        return unfinished(self._path)


def open_file_frames(path: Path, idle_s: float) -> LiveSource:
    """Open an image, a folder, a run or a video, whole or still being written.

    Args:
        idle_s: after which a folder or run has ended where nothing more came [s]; 0 takes what is there.
    """
    if (path / MANIFEST).is_file():
        if idle_s > 0 and _being_written(path):
            return GrowingRun(path, idle_s)
    elif path.is_dir() and idle_s > 0:
        return FillingFolder(path, idle_s)
    return open_source(path)


def _being_written(run: Path) -> bool:
    """Whether the last segment has no index yet, as one that is written or whose writer was killed."""
    last = max(segment_numbers(run), default=-1)
    if last < 0:
        return True
    path = run / file_name(last, "frames")
    return path.is_file() and scan(path).data_end is None


def unfinished(run: Path) -> str:
    """Why a run is not whole though nobody records into it, in words; empty where it is."""
    files = [run / file_name(number, "frames") for number in segment_numbers(run)]
    if all(file.is_file() and scan(file).data_end is not None for file in files) and files:
        return ""
    try:
        lock(run / MANIFEST).close()
    except RecordingError:  # its writer is at work
        return ""
    except StorageError:  # where nothing can be written nobody records
        pass
    return (
        f"{run} was not closed by its writer, which was killed or lost its disk: what can be read of it was "
        f"read, and `palpate check {run}` tells what is missing"
    )


class PipedFrames(Closing):
    """Images on standard input: concatenated JPEG or PNG files, or MJPEG.

    The pipe blocks its writer, so no frame is lost; times count from the first arrival.
    """

    waits = True
    may_change = True
    force: ForceSensor | None = None

    def __init__(self, stream: BinaryIO | None = None, name: str = "standard input") -> None:
        self.name = name
        self._stream = stream or sys.stdin.buffer
        self._cutter = ImageCutter()
        self._images: deque[bytes] = deque()
        self._number, self._first_ns, self._over = 0, 0, False

    def grab(self, timeout_s: float) -> Frame | None:
        """The next image; None at the end of the stream."""
        end_s = time.monotonic() + timeout_s
        why = ""
        while not self._images and not self._over and not why:
            if not self._ready(max(end_s - time.monotonic(), 0.0)):
                raise NoFrameYetError(f"{self.name} gave no whole image within {timeout_s:g} s")
            data = os.read(self._stream.fileno(), CHUNK)
            self._over = not data
            try:
                self._images.extend(self._cutter.feed(data))
            except ImageError as e:
                why = str(e)
        if not self._images and not why:
            return None
        return self._shown(why)

    def close(self) -> None:
        """Read no more; the stream is its owner's to close."""
        self._over = True
        self._images.clear()

    def _shown(self, why: str) -> Frame:
        number, now_ns = self._number, time.monotonic_ns()
        self._first_ns = self._first_ns or now_ns
        at_s = (now_ns - self._first_ns) / NS_PER_S
        item = Frame.unreadable(why, at_s, str(number))
        if not why:
            try:
                image = image_from_bytes(self._images.popleft(), Path(f"{self.name}, image {number}"))
                item = Frame(image, at_s, name=str(number))
            except ImageError as e:
                item = Frame.unreadable(str(e), at_s, str(number))
        self._number += 1
        return item.arrived(number, now_ns)

    def _ready(self, timeout_s: float) -> bool:
        if os.name == "nt":  # a pipe cannot be waited for: the read itself waits
            return True
        return bool(select.select([self._stream], [], [], timeout_s)[0])
