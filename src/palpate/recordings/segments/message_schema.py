"""Messages of a segment: standard ROS 2 types in CDR, so that other MCAP readers open them.

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
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from palpate.core import NS_PER_S, InputError, RecordingError

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
