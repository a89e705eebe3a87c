"""Copy everything readable of a damaged run into a new, sound one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from heapq import merge
from pathlib import Path

from palpate.core.errors import RecordingError
from palpate.core.files import PathText, new_folder, sha256_of
from palpate.recordings import schema
from palpate.recordings.manifest import MANIFEST, Manifest
from palpate.recordings.reader import Run
from palpate.recordings.scan import Damage, Message
from palpate.recordings.schema import EVENTS, FORCE, FRAMES, LABELS, RAW, STAGE, Channel
from palpate.recordings.segment import Segment
from palpate.recordings.stored import StoredSegment


@dataclass(frozen=True, slots=True)
class RepairReport:
    """What a repair carried over.

    Attributes:
        frames: how many frames.
        messages: how many messages of force, stage, labels and events.
        lost: what could not be read, and stays in the old run only.
    """

    frames: int
    messages: int
    lost: tuple[Damage, ...]


def repair(run_path: PathText, new_path: PathText) -> RepairReport:
    """Copy what is readable of a run, byte for byte, into a new run; the old one is not touched.

    The new run keeps the old one's identity and times, and its origin says what it was repaired from.

    Raises:
        ExistsError: `new_path` exists.
        RecordingError: `run_path` is not a run.
        StorageError: the disk refused.
    """
    run = Run.open(run_path)
    if not run.segments:
        raise RecordingError(f"{run_path} holds no segment, so there is nothing to repair; record a new run")
    lost = list(run.damage)
    frames = messages = 0
    with new_folder(Path(new_path)) as folder:
        manifest = _manifest(run)
        manifest.write(folder)
        for number, segment in enumerate(run.segments):
            with closing(_claimed(folder, manifest, number, segment)) as new:
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


def _claimed(folder: Path, manifest: Manifest, number: int, old: StoredSegment) -> Segment:
    about = {
        "run_id": manifest.run_id,
        "segment": number,
        "manifest_sha256": sha256_of(folder / MANIFEST),
        "clock_ns": old.about.get("clock_ns"),
    }
    begin_ns = old.begin_ns if old.begin_ns is not None else manifest.created_ns
    return Segment.claim(folder, number, about, begin_ns)


def _copy_frames(old: StoredSegment, new: Segment) -> tuple[dict[int, int], list[Damage]]:
    """Which old sequence became which new one, and what could not be read."""
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
    """How many messages were copied, and how many labels had lost their frame."""

    def of(channel: Channel) -> Iterator[tuple[Channel, Message]]:
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


def _renumbered(label: Message, sequences: dict[int, int]) -> bytes | None:
    """A label that names its frame by the new sequence; None where the frame is lost."""
    about = schema.decode_json(label.data, LABELS)
    old = about.get("frame")
    if not isinstance(old, int) or old not in sequences:
        return None
    return schema.encode_json({**about, "frame": sequences[old]})


def _orphaned(old: StoredSegment, count: int) -> Damage:
    return Damage(old.signals_file.path.name, 0, f"{count} labels belong to frames that could not be read")
