"""Reader of one segment: its chunks, cut or whole, none trusted unchecked; its frames, signals and damage."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from mcap.writer import MCAP0_MAGIC

from palpate.core import Image, ImageError, RecordingError, storage_errors
from palpate.core.parsing import parser
from palpate.recordings.exchange import image_files
from palpate.recordings.manifest import MANIFEST, StoredManifest
from palpate.recordings.segments.segment_writer import (
    FRAMES,
    KINDS,
    SEGMENT,
    Channel,
    FileKind,
    channel_id,
    decode,
    decode_json,
    file_name,
)

MAX_CHUNK_BYTES = 512 << 20  # the largest image that is read, stored without gain, and room to spare
MAX_INDEX_BYTES = 1 << 30  # some ten million frames

_RECORD = struct.Struct("<BQ")  # opcode, length of what follows
_CHUNK = struct.Struct("<BQQQQIIQ")  # record; first and last time, size, CRC; no compression; length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_FOOTER = struct.Struct("<BQQQI")  # record; where the summary and its offsets start, CRC
_TAIL = _FOOTER.size + len(MCAP0_MAGIC)
_DATA_END = struct.Struct("<BQI")  # record; CRC of all before it
_OPCODES = frozenset(int(code) for code in Opcode)


@dataclass(frozen=True, slots=True)
class Damage:
    """Something in a run that is not as it was written.

    Attributes:
        file: name of the file in the run's folder.
        at_byte: where in it, from 0.
        what: what is wrong there and what it costs.
    """

    file: str
    at_byte: int
    what: str

    def __str__(self) -> str:
        return f"{self.file} at byte {self.at_byte}: {self.what}"


@dataclass(frozen=True, slots=True)
class Chunk:
    """Chunk: where it lies and what is in it.

    Attributes:
        offset, length: of its record in the file [bytes].
        channels: ids of the channels that have messages in it.
        end_ns: its last message's time [ns since 1970].
        sequence: its first message's; None where only the index was read.
    """

    offset: int
    length: int
    channels: frozenset[int]
    end_ns: int
    sequence: int | None = None


@dataclass(frozen=True, slots=True)
class StoredMessage:
    """Message as stored; `data` is CDR."""

    channel: int
    sequence: int
    time_ns: int
    data: memoryview


@dataclass(frozen=True, slots=True)
class SegmentScan:
    """Scan of what a file holds.

    Attributes:
        chunks: its readable chunks, in order. Of a closed file they are as its index says, and their bytes
            are checked when read; of one that was never closed they have been checked.
        data_end: where the chunks end and the index begins; None in a file that was never closed.
        damage: what is wrong with it as far as was looked.
    """

    path: Path
    chunks: tuple[Chunk, ...]
    data_end: int | None
    damage: tuple[Damage, ...]


@parser("run segment", RecordingError, max_bytes=1 << 40)
def scan(path: Path) -> SegmentScan:
    """Find the chunks of a segment file, up to where it was cut."""
    with storage_errors(path), path.open("rb") as file:
        size = path.stat().st_size
        damage = []
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            damage.append(Damage(path.name, 0, "does not begin as an MCAP file"))
        indexed = _from_index(file, size)
        if indexed is not None:
            return SegmentScan(path, *indexed, tuple(damage))
        chunks, more = _by_walking(file, size, path.name)
        return SegmentScan(path, chunks, None, (*damage, *more))


def _from_index(file: BinaryIO, size: int) -> tuple[tuple[Chunk, ...], int] | None:
    """The chunks as the file's own index lists them, and where they end; None without a sound index."""
    if size < len(MCAP0_MAGIC) + _DATA_END.size + _TAIL:
        return None
    file.seek(size - _TAIL)
    tail = file.read(_TAIL)
    opcode, length, start, _, crc = _FOOTER.unpack_from(tail)
    if opcode != Opcode.FOOTER or length != _FOOTER.size - _RECORD.size or tail[-8:] != MCAP0_MAGIC:
        return None
    if not len(MCAP0_MAGIC) + _DATA_END.size <= start <= size - _TAIL:
        return None
    if size - start > MAX_INDEX_BYTES:
        return None
    file.seek(start)
    summary = file.read(size - _TAIL - start)
    if zlib.crc32(tail[: _FOOTER.size - 4], zlib.crc32(summary)) != crc:
        return None
    try:
        chunks = tuple(_indexed_chunks(summary))
    except (ValueError, McapError, struct.error):
        return None
    ends = [0, *(chunk.offset + chunk.length for chunk in chunks)]
    apart = all(chunk.offset >= end for chunk, end in zip(chunks, ends, strict=False))
    return (chunks, start - _DATA_END.size) if apart and ends[-1] <= start - _DATA_END.size else None


def _indexed_chunks(summary: bytes) -> Iterator[Chunk]:
    for opcode, body in _records(memoryview(summary)):
        if opcode == Opcode.CHUNK_INDEX:
            index = ChunkIndex.read(ReadDataStream(BytesIO(body)))
            yield Chunk(
                index.chunk_start_offset,
                index.chunk_length,
                frozenset(index.message_index_offsets),
                index.message_end_time,
            )


def _by_walking(file: BinaryIO, size: int, name: str) -> tuple[tuple[Chunk, ...], list[Damage]]:
    """The sound chunks of a file without an index, and what else is in it."""
    chunks: list[Chunk] = []
    damage: list[Damage] = []
    at = len(MCAP0_MAGIC)
    while True:
        file.seek(at)
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size or not any(head):  # zeros: room that a killed writer held
            damage.append(Damage(name, at, "ends without an index: interrupted while written, or cut"))
            break
        opcode, length = _RECORD.unpack(head)
        end = at + _RECORD.size + length
        if opcode not in _OPCODES or end > size:
            damage.append(Damage(name, at, "cut or damaged here: nothing can be read beyond"))
            break
        if opcode == Opcode.DATA_END:
            damage.append(Damage(name, end, "the index is cut or damaged"))
            break
        if opcode == Opcode.CHUNK:
            try:
                chunks.append(_examined(file, at, end - at))
            except RecordingError as e:
                damage.append(Damage(name, at, str(e)))
        at = end
    return tuple(chunks), damage


def scan_growing(path: Path, offset: int = 0) -> tuple[tuple[Chunk, ...], int]:
    """Chunks that lie whole in a file that is being written, from an offset on, and where to look next.

    What comes behind the last whole chunk is not judged: it may still be written.
    """
    chunks: list[Chunk] = []
    at = max(offset, len(MCAP0_MAGIC))
    with storage_errors(path), path.open("rb") as file:
        size = path.stat().st_size
        while at + _RECORD.size <= size:
            file.seek(at)
            opcode, length = _RECORD.unpack(file.read(_RECORD.size))
            end = at + _RECORD.size + length
            if opcode not in _OPCODES or opcode == Opcode.DATA_END or end > size:
                break
            if opcode == Opcode.CHUNK:
                try:
                    chunks.append(_examined(file, at, end - at))
                except RecordingError:
                    break
            at = end
    return tuple(chunks), at


def _examined(file: BinaryIO, offset: int, length: int) -> Chunk:
    contents = list(messages(_chunk_records(_bytes_at(file, offset, length), check=True)))
    if not contents:
        raise RecordingError("a chunk without messages")
    channels = frozenset(message.channel for message in contents)
    end_ns = max(message.time_ns for message in contents)
    return Chunk(offset, length, channels, end_ns, contents[0].sequence)


@parser("run chunk", RecordingError, max_bytes=1 << 40)
def read_chunk(path: Path, chunk: Chunk, *, check: bool = True) -> list[StoredMessage]:
    """The messages in a chunk, compared with their CRC unless that was done before.

    The file is opened anew, which costs 0.02 ms and leaves a reader free to be copied between processes.
    """
    with storage_errors(path), path.open("rb", buffering=0) as file:
        data = _bytes_at(file, chunk.offset, chunk.length)
    return list(messages(_chunk_records(data, check=check)))


def _bytes_at(file: BinaryIO, offset: int, length: int) -> bytes:
    if length > MAX_CHUNK_BYTES:
        raise RecordingError(f"a chunk of {length} bytes, and at most {MAX_CHUNK_BYTES} are read")
    file.seek(offset)
    data = file.read(length)
    if len(data) < length:
        raise RecordingError("a chunk is cut")
    return data


def _chunk_records(data: bytes, *, check: bool) -> memoryview:
    if len(data) < _CHUNK.size:
        raise RecordingError("a chunk is cut")
    opcode, length, _, _, size, crc, compressed, stored = _CHUNK.unpack_from(data)
    if opcode != Opcode.CHUNK or length != len(data) - _RECORD.size:
        raise RecordingError("there is no chunk")
    if compressed or size != stored or stored != len(data) - _CHUNK.size:
        raise RecordingError("a chunk's header is damaged, or of a file that palpate did not write")
    records = memoryview(data)[_CHUNK.size :]
    if check and zlib.crc32(records) != crc:
        raise RecordingError("a chunk fails its checksum: its bytes have changed")
    return records


def messages(records: memoryview) -> Iterator[StoredMessage]:
    """The messages among a chunk's records."""
    for opcode, body in _records(records):
        if opcode == Opcode.MESSAGE:
            if len(body) < _MESSAGE.size:
                raise RecordingError("a message is cut")
            channel, sequence, time_ns, _ = _MESSAGE.unpack_from(body)
            yield StoredMessage(channel, sequence, time_ns, body[_MESSAGE.size :])


def _records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    at = 0
    while at < len(data):
        if at + _RECORD.size > len(data):
            raise RecordingError("a record is cut")
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if length > len(data) - at:
            raise RecordingError("a record is longer than its chunk")
        yield opcode, data[at : at + length]
        at += length


def verify(whole: SegmentScan) -> tuple[Damage, ...]:
    """Compare every byte of a file with its checksums; what was found on the way, known damage included."""
    damage = _checked(whole).damage
    if whole.data_end is None or damage or _data_sound(whole.path, whole.data_end):
        return damage
    return (Damage(whole.path.name, whole.data_end, "bytes outside the chunks have changed"),)


def _checked(file: SegmentScan) -> SegmentScan:
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


def _data_sound(path: Path, end: int) -> bool:
    """Whether everything before the data's end has the CRC that stands there."""
    crc, at = 0, 0
    with storage_errors(path), path.open("rb") as file:
        while at < end and (data := file.read(min(1 << 20, end - at))):
            crc = zlib.crc32(data, crc)
            at += len(data)
        last = file.read(_DATA_END.size)
    return last == _DATA_END.pack(Opcode.DATA_END, 4, crc)


@dataclass(frozen=True, slots=True)
class StoredFrame:
    """Frame as stored: where it lies.

    Attributes:
        sequence: its number in its segment, which its labels name.
        time_ns: when it was taken [ns since 1970].
    """

    path: Path
    chunk: Chunk
    sequence: int
    time_ns: int

    def message(self, *, check: bool = True) -> StoredMessage:
        """The frame's message, compared with its checksum unless that was done before."""
        try:
            contents = read_chunk(self.path, self.chunk, check=check)
            if [(m.channel, m.sequence, m.time_ns) for m in contents] != [self._key]:
                raise RecordingError("the chunk is not the frame that the index promises")  # noqa: TRY301
        except RecordingError as e:
            raise self.error(e) from e
        return contents[0]

    def image(self, *, check: bool = True) -> Image:
        """The frame's image."""
        try:
            return image_files.decode(decode(self.message(check=check).data, FRAMES).data)
        except ImageError as e:
            raise self.error(e) from e

    def error(self, reason: Exception) -> RecordingError:
        """Error of a frame that cannot be read."""
        return RecordingError(
            f"{self.path} at byte {self.chunk.offset}: {reason}; `palpate check --repair` copies what is "
            "readable into a new run",
            code="segment-damaged",
        )

    @property
    def _key(self) -> tuple[int, int, int]:
        return channel_id("frames", FRAMES), self.sequence, self.time_ns


@dataclass(frozen=True)
class StoredSegment:
    """Segment as stored: what can be read of it.

    Attributes:
        signals: the file of its signals, all of whose chunks have been checked.
        abouts: what the writer noted at the beginning of each file, where that is readable.
        begin_ns: when it began [ns since 1970]; None where that is lost.
        damage: what is wrong as far as was looked.
    """

    number: int
    frames: tuple[StoredFrame, ...]
    frames_file: SegmentScan
    signals_file: SegmentScan
    abouts: tuple[dict[str, Any], ...]
    begin_ns: int | None
    damage: tuple[Damage, ...]

    @classmethod
    def open(cls, run: Path, number: int) -> StoredSegment:
        """Look through a segment, of whatever run; `of_run` then judges whether it belongs there."""
        frames, signals = (_scanned(run, number, kind) for kind in KINDS)
        signals = _checked(signals)
        begun = [message for file in (frames, signals) for message in _beginning(file)]
        abouts = tuple(decode_json(message.data, SEGMENT) for message in begun)
        return cls(
            number,
            tuple(frames_in(frames.path, frames.chunks)),
            frames,
            signals,
            abouts,
            begun[0].time_ns if begun else None,
            (*frames.damage, *signals.damage),
        )

    def of_run(self, manifest: StoredManifest) -> StoredSegment:
        """The same as a segment of the run with this manifest; left out where it is of another."""
        if any(about.get("run_id") != manifest.manifest.run_id for about in self.abouts):
            what = "belongs to another run, so it is left out; move both files of the segment away"
            frames, signals = (replace(file, chunks=()) for file in (self.frames_file, self.signals_file))
            damage: tuple[Damage, ...] = (Damage(frames.path.name, 0, what),)
            return replace(self, frames=(), frames_file=frames, signals_file=signals, damage=damage)
        if any(about.get("manifest_sha256") != manifest.sha256 for about in self.abouts):
            what = f"has changed since segment {self.number} was recorded"
            return replace(self, damage=(*self.damage, Damage(MANIFEST, 0, what)))
        return self

    @property
    def about(self) -> dict[str, Any]:
        """What the writer noted at its beginning; empty where that is lost."""
        return self.abouts[0] if self.abouts else {}

    @property
    def note(self) -> dict[str, Any]:
        """What else the recorder began it with; empty where there is none."""
        note = self.about.get("note")
        return note if isinstance(note, dict) else {}

    @property
    def manifest(self) -> StoredManifest | None:
        """The copy of the run's manifest that it begins with; None where it has none, or that is lost."""
        return StoredManifest.copied(self.about.get("manifest"), self.about.get("manifest_sha256"))

    def messages(self, channel: Channel) -> Iterator[StoredMessage]:
        """The messages on one channel of the signals, in order."""
        wanted = channel_id("signals", channel)
        for chunk in self.signals_file.chunks:
            if wanted in chunk.channels:
                contents = read_chunk(self.signals_file.path, chunk)
                yield from (message for message in contents if message.channel == wanted)

    def verify(self) -> tuple[Damage, ...]:
        """Compare every byte with its checksums; all that is wrong."""
        known = set(self.damage)
        late = [
            damage
            for file in (self.frames_file, self.signals_file)
            for damage in verify(file)
            if damage not in known
        ]
        return (*self.damage, *late)

    @property
    def end_ns(self) -> int:
        """The last message's time [ns since 1970]; 0 where none can be read."""
        chunks = (*self.frames_file.chunks, *self.signals_file.chunks)
        return max((chunk.end_ns for chunk in chunks), default=0)


def _scanned(run: Path, number: int, kind: FileKind) -> SegmentScan:
    path = run / file_name(number, kind)
    if not path.is_file():
        return SegmentScan(path, (), None, (Damage(path.name, 0, "is missing"),))
    return scan(path)


def _beginning(file: SegmentScan) -> list[StoredMessage]:
    """The message that opens a file, where it can be read."""
    if not file.chunks or 1 not in file.chunks[0].channels:
        return []
    try:
        contents = read_chunk(file.path, file.chunks[0])[:1]
        for message in contents:
            decode_json(message.data, SEGMENT)
    except RecordingError:
        return []  # told as damage when the chunk's bytes are verified
    return contents


def frames_in(path: Path, chunks: tuple[Chunk, ...]) -> Iterator[StoredFrame]:
    """Frames that lie in chunks of a segment's file of frames."""
    wanted = {channel_id("frames", FRAMES)}
    for k, chunk in enumerate(chunk for chunk in chunks if chunk.channels == wanted):
        yield StoredFrame(path, chunk, k if chunk.sequence is None else chunk.sequence, chunk.end_ns)
