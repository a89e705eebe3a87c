"""One segment as found on disk: which frames and signals can be read, and what is damaged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from palpate.core.errors import ImageError, RecordingError
from palpate.core.shapes import Image
from palpate.recordings import png
from palpate.recordings.manifest import MANIFEST
from palpate.recordings.scan import Chunk, Damage, Message, Scan, read_chunk, scan, verify
from palpate.recordings.schema import FRAMES, SEGMENT, Channel, FileKind, channel_id, decode, decode_json
from palpate.recordings.segment import KINDS, file_name


@dataclass(frozen=True, slots=True)
class StoredFrame:
    """Where one frame lies.

    Attributes:
        sequence: its number in its segment, which its labels name.
        time_ns: when it was taken [ns since 1970].
    """

    path: Path
    chunk: Chunk
    sequence: int
    time_ns: int

    def message(self, *, check: bool = True) -> Message:
        """The frame's message, compared with its checksum unless that was done before.

        Raises:
            RecordingError: it is damaged; the text names the file, the place and the remedy.
        """
        try:
            found = read_chunk(self.path, self.chunk, check=check)
            if [(m.channel, m.sequence, m.time_ns) for m in found] != [self._key]:
                raise RecordingError("the chunk is not the frame that the index promises")  # noqa: TRY301
        except RecordingError as e:
            raise self.error(e) from e
        return found[0]

    def image(self, *, check: bool = True) -> Image:
        """The frame's image.

        Raises:
            RecordingError: it is damaged; the text names the file, the place and the remedy.
        """
        try:
            return png.decode(decode(self.message(check=check).data, FRAMES).data)
        except ImageError as e:
            raise self.error(e) from e

    def error(self, reason: Exception) -> RecordingError:
        """What to tell about a frame that cannot be read."""
        return RecordingError(
            f"{self.path} at byte {self.chunk.offset}: {reason}; `palpate repair` copies what is readable "
            "into a new run"
        )

    @property
    def _key(self) -> tuple[int, int, int]:
        return channel_id("frames", FRAMES), self.sequence, self.time_ns


@dataclass(frozen=True)
class StoredSegment:
    """What can be read of a segment.

    Attributes:
        number: of the segment in its run.
        frames: its frames, in order.
        signals: the file of its signals, all of whose chunks have been checked.
        about: what the writer noted at its beginning; empty where that is lost.
        begin_ns: when it began [ns since 1970]; None where that is lost.
        damage: what is wrong as far as was looked.
    """

    number: int
    frames: tuple[StoredFrame, ...]
    frames_file: Scan
    signals_file: Scan
    about: dict[str, Any]
    begin_ns: int | None
    damage: tuple[Damage, ...]

    @classmethod
    def open(cls, run: Path, number: int, run_id: str, manifest_sha256: str) -> StoredSegment:
        """Look through a segment of the run that has this id and manifest."""
        frames, signals = (_scanned(run, number, kind) for kind in KINDS)
        signals = _checked(signals)
        begun = [message for file in (frames, signals) for message in _beginning(file)]
        abouts = [decode_json(message.data, SEGMENT) for message in begun]
        damage = (*frames.damage, *signals.damage)
        if any(about.get("run_id") != run_id for about in abouts):
            what = "belongs to another run, so it is left out; move both files of the segment away"
            stranger = Damage(frames.path.name, 0, what)
            frames, signals = replace(frames, chunks=()), replace(signals, chunks=())
            damage = (stranger,)
        elif any(about.get("manifest_sha256") != manifest_sha256 for about in abouts):
            damage = (*damage, Damage(MANIFEST, 0, f"has changed since segment {number} was recorded"))
        return cls(
            number,
            tuple(_frames(frames)),
            frames,
            signals,
            abouts[0] if abouts else {},
            begun[0].time_ns if begun else None,
            damage,
        )

    def messages(self, channel: Channel) -> Iterator[Message]:
        """The messages on one channel of the signals, in order."""
        wanted = channel_id("signals", channel)
        for chunk in self.signals_file.chunks:
            if wanted in chunk.channels:
                found = read_chunk(self.signals_file.path, chunk)
                yield from (message for message in found if message.channel == wanted)

    def verify(self) -> tuple[Damage, ...]:
        """Compare every byte with its checksums; all that is wrong."""
        known = set(self.damage)
        late = [
            found
            for file in (self.frames_file, self.signals_file)
            for found in verify(file)
            if found not in known
        ]
        return (*self.damage, *late)

    @property
    def end_ns(self) -> int:
        """The last message's time [ns since 1970]; 0 where none can be read."""
        chunks = (*self.frames_file.chunks, *self.signals_file.chunks)
        return max((chunk.end_ns for chunk in chunks), default=0)


def _scanned(run: Path, number: int, kind: FileKind) -> Scan:
    path = run / file_name(number, kind)
    if not path.is_file():
        return Scan(path, (), None, (Damage(path.name, 0, "is missing"),))
    return scan(path)


def _checked(file: Scan) -> Scan:
    """Leave the chunks out that fail their checksum, so that no table can change once it was read."""
    if file.data_end is None:
        return file
    sound, damage = [], list(file.damage)
    for chunk in file.chunks:
        try:
            read_chunk(file.path, chunk)
            sound.append(chunk)
        except RecordingError as e:
            damage.append(Damage(file.path.name, chunk.offset, str(e)))
    return replace(file, chunks=tuple(sound), damage=tuple(damage))


def _beginning(file: Scan) -> list[Message]:
    """The message that opens a file, where it can be read."""
    if not file.chunks or 1 not in file.chunks[0].channels:
        return []
    try:
        found = read_chunk(file.path, file.chunks[0])[:1]
        for message in found:
            decode_json(message.data, SEGMENT)
    except RecordingError:
        return []  # told as damage when the chunk's bytes are verified
    return found


def _frames(file: Scan) -> Iterator[StoredFrame]:
    wanted = {channel_id("frames", FRAMES)}
    chunks = [chunk for chunk in file.chunks if chunk.channels == wanted]
    for k, chunk in enumerate(chunks):
        yield StoredFrame(file.path, chunk, k if chunk.sequence is None else chunk.sequence, chunk.end_ns)
