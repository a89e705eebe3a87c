"""The append side of a segment: two MCAP files that are claimed, grown and closed, never rewritten."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from palpate.core import ExistsError, StorageError, sha256_of, storage_errors, sync
from palpate.recordings.manifest import MANIFEST
from palpate.recordings.segments.message_schema import (
    CHANNELS,
    SEGMENT,
    Channel,
    FileKind,
    channel_id,
    definition,
    encode_json,
)
from palpate.version import __version__

KINDS: tuple[FileKind, ...] = ("frames", "signals")
# A frame is a chunk, so that reading it decodes nothing else. Signals share chunks, which time closes too.
_CHUNK_BYTES: dict[FileKind, int] = {"frames": 0, "signals": 64 * 1024}
_NAME = re.compile(r"([0-9]{4,9})-(?:frames|signals)\.mcap")


def file_name(number: int, kind: FileKind) -> str:
    """Name of one file of a segment."""
    return f"{number:04d}-{kind}.mcap"


def segment_numbers(run: Path) -> list[int]:
    """The numbers of the segments in a run's folder, ascending; half a segment counts."""
    with storage_errors(run):
        matches = (_NAME.fullmatch(name) for name in os.listdir(run))
        return sorted({int(match[1]) for match in matches if match})


class _Sink:
    """An unbuffered file that writes everything it is given, or raises."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._size = 0

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            done = self._file.write(rest)
            self._size += done
            rest = rest[done:]
        return len(data)

    def tell(self) -> int:
        return self._size

    def flush(self) -> None:
        """Nothing is held back."""

    def sync(self) -> None:
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()


class SegmentFile:
    """File of a segment, open for appending.

    Every method raises `StorageError` when the disk refuses. The file then takes nothing more: what is
    whole in it stays readable.
    """

    def __init__(self, path: Path, kind: FileKind, about: dict[str, Any], time_ns: int) -> None:
        self._path = path
        self._kind = kind
        self._dirty = True
        self._broken = False
        with storage_errors(path):
            self._sink = _Sink(path)
        self._mcap = Writer(
            self._sink, chunk_size=_CHUNK_BYTES[kind], compression=CompressionType.NONE, enable_data_crcs=True
        )
        self._begin(about, time_ns)

    def _begin(self, about: dict[str, Any], time_ns: int) -> None:
        with self._writing():
            self._mcap.start(profile="ros2", library=f"palpate {__version__}")
        schemas: dict[str, int] = {}
        for channel in CHANNELS[self._kind]:
            if channel.type not in schemas:
                text = definition(channel)
                schemas[channel.type] = self._mcap.register_schema(channel.type, "ros2msg", text)
            self._mcap.register_channel(channel.topic, "cdr", schemas[channel.type])
        self.write(SEGMENT, time_ns, 0, encode_json(about))
        self.sync()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            with storage_errors(self._path):
                yield
        except BaseException:
            self._broken = True  # half a record may stand at the end: nothing may follow it
            raise

    def write(self, channel: Channel, time_ns: int, sequence: int, data: bytes) -> None:
        """Append one message, stamped [ns since 1970]; a full chunk goes to the file."""
        with self._writing():
            self._mcap.add_message(
                channel_id=channel_id(self._kind, channel),
                log_time=time_ns,
                publish_time=time_ns,
                sequence=sequence,
                data=data,
            )
        self._dirty = True

    def sync(self) -> None:
        """Close the chunk in progress and have the disk hold everything."""
        if self._dirty:
            with self._writing():
                self._mcap.flush()
                self._sink.sync()
            self._dirty = False

    def close(self) -> None:
        """Append the index, unless a write failed before, and close."""
        try:
            if not self._broken:
                with self._writing():
                    self._mcap.finish()
                    self._sink.sync()
        finally:
            self._sink.close()


@dataclass(frozen=True)
class Segment:
    """Both files of one segment, open for appending."""

    frames: SegmentFile
    signals: SegmentFile

    @classmethod
    def claim(cls, run: Path, number: int, run_id: str, *, begin_ns: int, clock_ns: int | None) -> Segment:
        """Create a segment that nobody else can then create.

        Args:
            run: folder, which holds the manifest.
            number: of the segment.
            run_id: as the manifest has it.
            begin_ns: its first instant [ns since 1970].
            clock_ns: what the writer's clock read then [ns]; None where that is lost.
        """
        about = {
            "run_id": run_id,
            "segment": number,
            "manifest_sha256": sha256_of(run / MANIFEST),
            "clock_ns": clock_ns,
        }
        with ExitStack() as opened:
            files = []
            for kind in KINDS:
                files.append(_claimed(run / file_name(number, kind), kind, about, begin_ns))
                opened.callback(files[-1].close)
            with storage_errors(run):
                sync(run)
            opened.pop_all()
        return cls(*files)

    def sync(self) -> None:
        """Have the disk hold everything in both files."""
        self.frames.sync()
        self.signals.sync()

    def close(self) -> None:
        """Close both files, the second also when the first refuses."""
        try:
            self.frames.close()
        finally:
            self.signals.close()


def _claimed(path: Path, kind: FileKind, about: dict[str, Any], time_ns: int) -> SegmentFile:
    try:
        return SegmentFile(path, kind, about, time_ns)
    except StorageError as e:
        if isinstance(e.__cause__, FileExistsError):
            raise ExistsError(f"{path} was claimed by another writer; resume again") from e
        raise
