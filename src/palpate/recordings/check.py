"""Say what a run holds, at which rates and with which gaps, and whether it is sound."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from palpate.core.clock import NS_PER_S
from palpate.core.errors import RecordingError
from palpate.core.files import PathText
from palpate.recordings.reader import Run
from palpate.recordings.scan import Damage
from palpate.recordings.schema import EVENTS, FRAMES, RECORDED, Channel, decode, decode_json
from palpate.recordings.stored import StoredSegment
from palpate.recordings.writer import DROPPED


@dataclass(frozen=True, slots=True)
class ChannelReport:
    """One channel of a run.

    Attributes:
        count: how many messages can be read.
        rate_Hz: messages a second within the segments; None below two messages, or where times are ordinal.
        longest_gap_s: longest time between two messages of one segment [s]; None likewise.
        dropped: how many the writer had to drop, as it recorded.
    """

    count: int
    rate_Hz: float | None  # noqa: N815  # the unit's own spelling
    longest_gap_s: float | None
    dropped: int


@dataclass(frozen=True, slots=True)
class CheckReport:
    """What a run holds and whether it can be relied on.

    Attributes:
        path, run_id, sensor: which run.
        frames: how many can be read.
        duration_s: recorded time, pauses between segments left out [s]; None where times are ordinal.
        channels: by name, frames among them.
        drops: how many messages the writer dropped, by channel; only channels that did.
        segments: how many.
        labels: column -> unit symbol; None for a number without a unit, a text or a flag.
        missing_labels: column -> how many frames lack it; only columns that some lack.
        duplicated_frames: how many frames equal the one before, as of a camera that froze.
        damage: what is not as it was written.
        sound: whether nothing is damaged.
    """

    path: str
    run_id: str
    sensor: str
    frames: int
    duration_s: float | None
    channels: dict[str, ChannelReport]
    drops: dict[str, int]
    segments: int
    labels: dict[str, str | None]
    missing_labels: dict[str, int]
    duplicated_frames: int
    damage: tuple[Damage, ...]
    sound: bool

    def to_dict(self) -> dict[str, Any]:
        """The same as plain dictionaries and lists, ready for JSON."""
        return asdict(self)


def check(path: PathText) -> CheckReport:
    """Read a run whole and report on it.

    Raises:
        RecordingError: not a run.
        StorageError: the disk refused.
    """
    run = Run.open(path)
    times = {channel: [_times_ns(segment, channel) for segment in run.segments] for channel in RECORDED}
    measured = run.manifest.clock == "measured"
    dropped = _dropped(run)
    missing = run.labels.isna().sum()
    return CheckReport(
        path=str(path),
        run_id=run.manifest.run_id,
        sensor=run.manifest.sensor,
        frames=len(run),
        duration_s=_duration_s(list(times.values())) if measured else None,
        channels={
            channel.name: _channel(parts, dropped.get(channel.name, 0), measured=measured)
            for channel, parts in times.items()
        },
        drops=dropped,
        segments=len(run.segments),
        labels={name: run.manifest.units.get(name) for name in run.manifest.labels},
        missing_labels={str(name): int(count) for name, count in missing.items() if count},
        duplicated_frames=_duplicated(run),
        damage=run.damage,
        sound=not run.damage,
    )


def _times_ns(segment: StoredSegment, channel: Channel) -> np.ndarray:
    """Times of one channel's messages in one segment ``[n]`` [ns since 1970]."""
    source = segment.frames if channel is FRAMES else segment.messages(channel)
    return np.array([message.time_ns for message in source], np.int64)


def _channel(parts: list[np.ndarray], dropped: int, *, measured: bool) -> ChannelReport:
    """A channel from its times in each segment."""
    count = sum(len(part) for part in parts)
    gaps_s = np.concatenate([np.empty(0), *(np.diff(part) for part in parts)]) / NS_PER_S
    if not measured or not gaps_s.sum() > 0:
        return ChannelReport(count, None, None, dropped)
    return ChannelReport(count, float(gaps_s.size / gaps_s.sum()), float(gaps_s.max()), dropped)


def _duration_s(channels: list[list[np.ndarray]]) -> float:
    """From each segment's first message to its last, together [s]."""
    segments = [np.concatenate(times) for times in zip(*channels, strict=True)]
    return sum(float(np.ptp(times)) / NS_PER_S for times in segments if times.size)


def _dropped(run: Run) -> dict[str, int]:
    """What the writer noted as dropped: within a segment its notes count up."""
    total: dict[str, int] = {}
    for segment in run.segments:
        last: dict[str, int] = {}
        for message in segment.messages(EVENTS):
            match decode_json(message.data, EVENTS):
                case {"kind": str(kind), "fields": {"channel": str(name), "count": int(count)}}:
                    if kind == DROPPED:
                        last[name] = count
        for name, count in last.items():
            total[name] = total.get(name, 0) + count
    return total


def _duplicated(run: Run) -> int:
    """How many readable frames hold the same PNG as the one before."""
    count, before = 0, None
    for segment in run.segments:
        for frame in segment.frames:
            try:
                image = bytes(decode(frame.message().data, FRAMES).data)
            except RecordingError:
                continue  # told as damage
            count += image == before
            before = image
    return count
