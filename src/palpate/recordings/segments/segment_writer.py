"""The append side of a segment: two MCAP files that are claimed, grown and closed, never rewritten.

Messages of a segment: standard ROS 2 types in CDR, so that other MCAP readers open them.

| file | topic | type | holds |
|---|---|---|---|
| both | /segment | std_msgs/msg/String | JSON: run, number, manifest's SHA-256, where the clock stood |
| frames | /frames | sensor_msgs/msg/CompressedImage | one PNG a chunk; the k-th has sequence k |
| signals | /labels | std_msgs/msg/String | JSON: ``frame`` (its sequence), ``exposure_s``, ``labels`` |
| signals | /force | geometry_msgs/msg/WrenchStamped | N, Nm |
| signals | /stage | geometry_msgs/msg/PointStamped | m |
| signals | /events | std_msgs/msg/String | JSON: ``kind``, ``fields`` |
| signals | /force_raw | geometry_msgs/msg/WrenchStamped | N, Nm, as the sensor says it: its axes, its bias |

Frames have a file of their own because a reader takes whole chunks: force would drag images along.
A channel's id is its place in its file's row of `CHANNELS`, from 1, so that a message can be told even
where the record that declares its channel is lost.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from palpate.core import NS_PER_S, ExistsError, InputError, RecordingError, StorageError, storage_errors, sync
from palpate.recordings.manifest import StoredManifest
from palpate.recordings.segments.mcap_file import HeldFile, McapFile
from palpate.version import __version__

FileKind = Literal["frames", "signals"]
MAX_TIME_NS = (2**31 - 1) * NS_PER_S  # a ROS stamp's seconds are 32-bit: until 19 January 2038


@dataclass(frozen=True, slots=True)
class Channel:
    """Topic of a segment and the ROS 2 type of its messages."""

    topic: str
    type: str

    @property
    def name(self) -> str:
        """The topic without its slash."""
        return self.topic[1:]


SEGMENT = Channel("/segment", "std_msgs/msg/String")
FRAMES = Channel("/frames", "sensor_msgs/msg/CompressedImage")
LABELS = Channel("/labels", "std_msgs/msg/String")
FORCE = Channel("/force", "geometry_msgs/msg/WrenchStamped")
STAGE = Channel("/stage", "geometry_msgs/msg/PointStamped")
EVENTS = Channel("/events", "std_msgs/msg/String")
RAW = Channel("/force_raw", "geometry_msgs/msg/WrenchStamped")

CHANNELS: dict[FileKind, tuple[Channel, ...]] = {
    "frames": (SEGMENT, FRAMES),
    "signals": (SEGMENT, LABELS, FORCE, STAGE, EVENTS, RAW),
}
RECORDED = (FRAMES, FORCE, STAGE, EVENTS, RAW)  # what a caller writes; labels come with their frame


def channel_id(kind: FileKind, channel: Channel) -> int:
    """The id of a channel in one kind of file."""
    return CHANNELS[kind].index(channel) + 1


@cache
def _store() -> Any:
    return get_typestore(Stores.ROS2_HUMBLE)


def definition(channel: Channel) -> bytes:
    """The text that tells any MCAP reader how to decode a channel's messages."""
    text, _ = _store().generate_msgdef(channel.type, ros_version=2)
    return str(text).encode()


def _header(time_ns: int) -> Any:
    types = _store().types
    seconds, rest = divmod(time_ns, NS_PER_S)
    return types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest), frame_id=""
    )


def _encoded(message: Any, channel: Channel) -> bytes:
    return bytes(_store().serialize_cdr(message, channel.type))


def encode_image(png: np.ndarray, time_ns: int) -> bytes:
    """A compressed image from PNG bytes ``[n]``, stamped [ns since 1970]."""
    image = _store().types[FRAMES.type]
    return _encoded(image(header=_header(time_ns), format="png", data=png), FRAMES)


def encode_wrench(wrench: Sequence[float], time_ns: int) -> bytes:
    """Force [N] and torque [Nm], three each."""
    types = _store().types
    vector, pair = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Wrench"]
    both = pair(force=vector(*wrench[:3]), torque=vector(*wrench[3:]))
    return _encoded(types[FORCE.type](header=_header(time_ns), wrench=both), FORCE)


def encode_point(position_m: Sequence[float], time_ns: int) -> bytes:
    """A position [m]."""
    types = _store().types
    point = types["geometry_msgs/msg/Point"](*position_m)
    return _encoded(types[STAGE.type](header=_header(time_ns), point=point), STAGE)


def encode_json(fields: dict[str, Any]) -> bytes:
    """A text message that holds JSON."""
    try:
        text = json.dumps(fields, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError, RecursionError) as e:
        raise InputError(
            f"{fields!r:.200} cannot be recorded as JSON ({e}); give text, finite numbers, flags, lists",
            code="not-json",
        ) from e
    return _encoded(_store().types[EVENTS.type](data=text), EVENTS)


def decode(data: memoryview, channel: Channel) -> Any:
    """A message from its CDR bytes."""
    try:
        return _store().deserialize_cdr(data, channel.type)
    except (SerdeError, ValueError) as e:
        raise RecordingError(f"a message on {channel.topic} is no {channel.type} ({e})") from e


def decode_json(data: memoryview, channel: Channel) -> dict[str, Any]:
    """The JSON object in a text message."""
    try:
        fields = json.loads(decode(data, channel).data)
    except (ValueError, RecursionError) as e:
        raise RecordingError(f"a message on {channel.topic} holds no JSON ({e})") from e
    if not isinstance(fields, dict):
        raise RecordingError(f"a message on {channel.topic} holds no JSON object")
    return fields


KINDS: tuple[FileKind, ...] = ("frames", "signals")
# A frame is a chunk, so that reading it decodes nothing else. Signals share chunks, which time closes too.
_CHUNK_BYTES: dict[FileKind, int] = {"frames": 0, "signals": 64 * 1024}
LAST_BYTES = 64 * 1024  # held for what is said of a run's end, when the disk takes nothing else
_NAME = re.compile(r"([0-9]{4,9})-(?:frames|signals)\.mcap")


def file_name(number: int, kind: FileKind) -> str:
    """Name of one file of a segment."""
    return f"{number:04d}-{kind}.mcap"


def segment_numbers(run: Path) -> list[int]:
    """The numbers of the segments in a run's folder, ascending; half a segment counts."""
    with storage_errors(run):
        matches = (_NAME.fullmatch(name) for name in os.listdir(run))
        return sorted({int(match[1]) for match in matches if match})


class SegmentFile:
    """File of a segment, open for appending.

    Every method raises `StorageError` when the disk refuses. A message for which the disk has no room is
    refused before anything of it is written, and the file can still be ended: room for that is held. After
    any other refusal the file takes nothing more; what is whole in it stays readable.

    Attributes:
        broken: whether a write has failed, so that nothing may follow it.
    """

    def __init__(self, path: Path, kind: FileKind, about: dict[str, Any], time_ns: int) -> None:
        self._path = path
        self._kind = kind
        self._dirty = True
        self.broken = False
        with storage_errors(path):
            self._sink = HeldFile(path)
        self._mcap = McapFile(self._sink, _CHUNK_BYTES[kind])
        try:
            self._begin(about, time_ns)
        except BaseException:
            with suppress(OSError):
                self._sink.close()
            _remove(path)  # made here, and nothing is recorded in it
            raise

    def _begin(self, about: dict[str, Any], time_ns: int) -> None:
        with self._writing():
            self._mcap.start(profile="ros2", library=f"palpate {__version__}")
        schemas: dict[str, int] = {}
        for channel in CHANNELS[self._kind]:
            if channel.type not in schemas:
                text = definition(channel)
                schemas[channel.type] = self._mcap.add_schema(channel.type, "ros2msg", text)
            self._mcap.add_channel(channel.topic, "cdr", schemas[channel.type])
        self.write(SEGMENT, time_ns, 0, encode_json(about))
        self.sync()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            with storage_errors(self._path):
                yield
        except BaseException:
            self.broken = True  # half a record may stand at the end: nothing may follow it
            raise

    def hold(self, message_bytes: int, *, last: bool = False) -> None:
        """Have room on the disk for a message of so many bytes, and for the file's end after it.

        Args:
            last: it is one of the run's last messages, for which room was held until now.
        """
        spare = 0 if last else LAST_BYTES
        with storage_errors(self._path):
            self._sink.hold(self._mcap.bytes_to_end(message_bytes) + spare)

    def write(
        self, channel: Channel, time_ns: int, sequence: int, data: bytes, *, last: bool = False
    ) -> None:
        """Append one message, stamped [ns since 1970]; a full chunk goes to the file. `last` as in `hold`."""
        self.hold(len(data), last=last)
        with self._writing():
            self._mcap.add_message(channel_id(self._kind, channel), time_ns, sequence, data)
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
            if not self.broken:
                with self._writing():
                    self._mcap.finish()
                    self._sink.sync()
        finally:
            with storage_errors(self._path):
                self._sink.close()


@dataclass(frozen=True)
class Segment:
    """Both files of one segment, open for appending."""

    frames: SegmentFile
    signals: SegmentFile

    @classmethod
    def claim(
        cls,
        run: Path,
        number: int,
        manifest: StoredManifest,
        *,
        begin_ns: int,
        clock_ns: int | None,
        note: Mapping[str, Any] | None = None,
    ) -> Segment:
        """Create a segment that nobody else can then create; the disk holds what opens both files.

        Where the disk refuses that, the files made here are removed again: nothing is recorded in them yet.

        Args:
            manifest: of the run; each file begins with a copy of it.
            begin_ns: its first instant [ns since 1970].
            clock_ns: what the writer's clock read then [ns]; None where that is lost.
            note: what else both files begin with, of JSON's types.
        """
        about = {
            "run_id": manifest.manifest.run_id,
            "segment": number,
            "manifest_sha256": manifest.sha256,
            "manifest": manifest.text.decode(),
            "clock_ns": clock_ns,
            "note": dict(note or {}),
        }
        with ExitStack() as opened:
            files = []
            for kind in KINDS:
                path = run / file_name(number, kind)
                files.append(_claimed(path, kind, about, begin_ns))
                opened.callback(_remove, path)
                opened.callback(files[-1].close)
            with storage_errors(run):
                sync(run)
            opened.pop_all()
        return cls(*files)

    @property
    def broken(self) -> bool:
        """Whether a write into either file has failed."""
        return self.frames.broken or self.signals.broken

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


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink()


def _claimed(path: Path, kind: FileKind, about: dict[str, Any], time_ns: int) -> SegmentFile:
    try:
        return SegmentFile(path, kind, about, time_ns)
    except StorageError as e:
        if isinstance(e.__cause__, FileExistsError):
            raise ExistsError(f"{path} was claimed by another writer; resume again") from e
        raise
