"""Integrity of a run: a check of its rates, gaps and damage, and a repair that copies what is readable."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import NS_PER_S, PathText, RecordingError, new_folder
from palpate.recordings.manifest import Manifest, StoredManifest
from palpate.recordings.run_reader import ZERO_MOVED, Run
from palpate.recordings.run_writer import DROPPED
from palpate.recordings.segments import (
    EVENTS,
    FORCE,
    FRAMES,
    LABELS,
    RAW,
    RECORDED,
    STAGE,
    Channel,
    Damage,
    Segment,
    StoredMessage,
    StoredSegment,
    decode,
    decode_json,
    segment_writer,
)


@dataclass(frozen=True, slots=True)
class ChannelReport:
    """Report on one channel of a run.

    Attributes:
        rate_Hz: Message rate within segments; None below two messages or for ordinal times.
        longest_gap_s: Longest time between messages of one segment; None likewise [s].
        dropped: Number of messages that the writer dropped.
    """

    count: int
    rate_Hz: float | None  # noqa: N815  # the unit's own spelling
    longest_gap_s: float | None
    dropped: int


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Report on the content and integrity of a run.

    Attributes:
        duration_s: Recorded time without pauses between segments; None for ordinal times [s].
        drops: Messages dropped by the writer, for channels with any.
        labels: Column -> unit symbol; None for unitless numbers, texts, and flags.
        missing_labels: Column -> number of frames without it, if any.
        duplicated_frames: Number of frames equal to the previous one.
        orphan_frames: Number of frames without a label record, as after a kill.
        orphan_records: Number of label records without a frame.
        void_frames: Number of frames withdrawn because the force zero moved.
        zero_moved_N: Largest zero shift over a press; None if not measured [N].
        sound: Whether there is no damage.
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
    orphan_frames: int
    orphan_records: int
    void_frames: int
    zero_moved_N: float | None  # noqa: N815
    damage: tuple[Damage, ...]
    sound: bool

    def to_dict(self) -> dict[str, Any]:
        """The same as plain dictionaries and lists, ready for JSON."""
        return asdict(self)


def check(path: PathText) -> CheckReport:
    """Read a run whole and report on it."""
    run = Run.open(path)
    times = {channel: [_times_ns(segment, channel) for segment in run.segments] for channel in RECORDED}
    measured = run.manifest.clock == "measured"
    dropped = _dropped(run)
    missing = run.labels.isna().sum()
    orphans = [_orphans(segment) for segment in run.segments]
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
        orphan_frames=sum(frames for frames, _ in orphans),
        orphan_records=sum(records for _, records in orphans),
        void_frames=run.void_frames,
        zero_moved_N=_zero_moved_n(run),
        damage=run.damage,
        sound=not run.damage,
    )


def _times_ns(segment: StoredSegment, channel: Channel) -> np.ndarray:
    source = segment.frames if channel is FRAMES else segment.messages(channel)
    return np.array([message.time_ns for message in source], np.int64)


def _channel(parts: list[np.ndarray], dropped: int, *, measured: bool) -> ChannelReport:
    count = sum(len(part) for part in parts)
    gaps_s = np.concatenate([np.empty(0), *(np.diff(part) for part in parts)]) / NS_PER_S
    if not measured or not gaps_s.sum() > 0:
        return ChannelReport(count, None, None, dropped)
    return ChannelReport(count, float(gaps_s.size / gaps_s.sum()), float(gaps_s.max()), dropped)


def _duration_s(channels: list[list[np.ndarray]]) -> float:
    """Time from each segment's first message to its last, together [s]."""
    segments = [np.concatenate(times) for times in zip(*channels, strict=True)]
    return sum(float(np.ptp(times)) / NS_PER_S for times in segments if times.size)


def _dropped(run: Run) -> dict[str, int]:
    """Drops that the writer noted: within a segment its notes count up."""
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


def _zero_moved_n(run: Run) -> float | None:
    """Most that the force sensor's zero moved over a press; None where no event says so."""
    moved = [
        float(event["fields"]["moved_N"])
        for segment in run.segments
        for message in segment.messages(EVENTS)
        for event in [decode_json(message.data, EVENTS)]
        if event.get("kind") == ZERO_MOVED
    ]
    return max(moved, default=None)


def _duplicated(run: Run) -> int:
    """Count of readable frames with the same PNG as the one before."""
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


def _orphans(segment: StoredSegment) -> tuple[int, int]:
    """Count of frames without a record, and of records without a frame."""
    frames = {frame.sequence for frame in segment.frames}
    records = {decode_json(message.data, LABELS)["frame"] for message in segment.messages(LABELS)}
    every_frame_has_one = "manifest" in segment.about or records
    return len(frames - records) if every_frame_has_one else 0, len(records - frames)


@dataclass(frozen=True, slots=True)
class RepairReport:
    """Report of what a repair carried over.

    Attributes:
        messages: how many messages of force, stage, labels and events.
        lost: what could not be read, and stays in the old run only.
    """

    frames: int
    messages: int
    lost: tuple[Damage, ...]


def repair(run_path: PathText, new_path: PathText) -> RepairReport:
    """Copy what is readable of a run, byte for byte, into a new run; the old one is not touched.

    The new run keeps the old one's identity and times, and its origin says what it was repaired from.
    """
    run = Run.open(run_path)
    if not run.segments:
        raise RecordingError(
            f"{run_path} holds no segment, so there is nothing to repair; record a new run",
            code="no-segments",
        )
    lost = list(run.damage)
    frames = messages = 0
    with new_folder(Path(new_path)) as folder:
        manifest = _manifest(run)
        manifest.write(folder)
        stored = StoredManifest.of(manifest)
        for number, segment in enumerate(run.segments):
            begin_ns = manifest.created_ns if segment.begin_ns is None else segment.begin_ns
            claimed = Segment.claim(
                folder,
                number,
                stored,
                begin_ns=begin_ns,
                clock_ns=segment.about.get("clock_ns"),
                note=segment.note,
            )
            with closing(claimed) as new:
                sequences, unread = _copy_frames(segment, new)
                frames += len(sequences)
                copied, orphans = _copy_signals(segment, new, sequences)
            messages += copied
            lost += [damage for damage in unread if damage not in lost]
            lost += [_orphaned(segment, orphans)] if orphans else []
    return RepairReport(frames, messages, tuple(lost))


def _manifest(run: Run) -> Manifest:
    note = f"repaired from the run with data hash {run.hash}"
    origin = f"{run.manifest.origin}; {note}" if run.manifest.origin else note
    return run.manifest.model_copy(update={"origin": origin})


def _copy_frames(old: StoredSegment, new: Segment) -> tuple[dict[int, int], list[Damage]]:
    """New sequence of each old one, and what could not be read."""
    sequences: dict[int, int] = {}
    lost = []
    for frame in old.frames:
        try:
            message = frame.message()
        except RecordingError as e:
            lost.append(Damage(frame.path.name, frame.chunk.offset, str(e.__cause__)))
            continue
        new.frames.write(FRAMES, message.time_ns, len(sequences), bytes(message.data))
        sequences[frame.sequence] = len(sequences)
    return sequences, lost


def _copy_signals(old: StoredSegment, new: Segment, sequences: dict[int, int]) -> tuple[int, int]:
    """Count of messages copied, and of labels that had lost their frame."""

    def of(channel: Channel) -> Iterator[tuple[Channel, StoredMessage]]:
        return ((channel, message) for message in old.messages(channel))

    copied = orphans = 0
    for channel, message in merge(*map(of, (LABELS, FORCE, STAGE, EVENTS, RAW)), key=lambda m: m[1].time_ns):
        data = bytes(message.data) if channel is not LABELS else _renumbered(message, sequences)
        if data is None:
            orphans += 1
        else:
            new.signals.write(channel, message.time_ns, 0, data)
            copied += 1
    return copied, orphans


def _renumbered(label: StoredMessage, sequences: dict[int, int]) -> bytes | None:
    """A label that names its frame by the new sequence; None where the frame is lost."""
    about = segment_writer.decode_json(label.data, LABELS)
    old = about.get("frame")
    if not isinstance(old, int) or old not in sequences:
        return None
    return segment_writer.encode_json({**about, "frame": sequences[old]})


def _orphaned(old: StoredSegment, count: int) -> Damage:
    return Damage(old.signals_file.path.name, 0, f"{count} labels belong to frames that could not be read")
