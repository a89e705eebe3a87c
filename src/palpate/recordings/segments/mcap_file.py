"""MCAP file that can always be ended: room for its end is held on the disk, and its index is kept packed.

It writes what the library's own writer would, byte for byte, from the library's own records. That one keeps
an object in memory for every chunk, and a frame is a chunk; nor can it say how many bytes an end will take.
"""

from __future__ import annotations

import errno
import os
import zlib
from collections import defaultdict
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

HELD_AT_ONCE = 1 << 20  # bytes: how far ahead room is taken, so that it is seldom asked for
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_CANNOT_HOLD = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)  # a file system that promises nothing

_MESSAGE_BYTES = 9 + 22  # of a message's record, before its data
_CHUNK_BYTES = 9 + 40  # of a chunk's record, before its messages
_INDEX_BYTES = 9 + 64  # of a chunk's entry in the index, without its channels
_CHANNEL_BYTES = 10 + 9 + 6  # for a channel in a chunk: in the chunk's entry, and its index's own record
_ENTRY_BYTES = 16  # of a message in its channel's index
_END_BYTES = 512  # data's end, statistics, offsets of the summary, footer and the closing magic


class HeldFile:
    """New file, unbuffered, that holds room on the disk beyond what is written into it.

    Until it is closed it is longer than what was written, by zeros. Room is held where the operating system
    can promise it (`posix_fallocate`); elsewhere a full disk is noticed by the write that finds it.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._size = 0
        self._held = 0
        self._holds = hasattr(os, "posix_fallocate")

    def hold(self, count: int) -> None:
        """Make sure that so many bytes more can be written."""
        needed = self._size + count
        if not self._holds or needed <= self._held:
            return
        for end in (needed + HELD_AT_ONCE, needed):
            try:
                os.posix_fallocate(self._file.fileno(), self._held, end - self._held)
            except OSError as e:
                if e.errno in _CANNOT_HOLD:
                    self._holds = False
                    return
                if e.errno not in _NO_ROOM or end == needed:
                    raise
            else:
                self._held = end
                return

    def write(self, data: bytes) -> None:
        """Write all of it, or raise."""
        rest = memoryview(data)
        while rest:
            done = self._file.write(rest)
            self._size += done
            rest = rest[done:]

    def tell(self) -> int:
        """Count of bytes written."""
        return self._size

    def sync(self) -> None:
        """Have the disk hold what was written."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Give back the room that was not needed, and close."""
        try:
            if self._held:
                self._file.truncate(self._size)
                self.sync()
        finally:
            self._file.close()


class McapFile:
    """Writer of chunks without compression, with checksums and an index.

    Args:
        chunk_bytes: a chunk that has grown beyond it is written.
    """

    def __init__(self, file: HeldFile, chunk_bytes: int) -> None:
        self._file = file
        self._chunk_bytes = chunk_bytes
        self._crc = 0
        self._records = RecordBuilder()
        self._entries: dict[int, MessageIndex] = {}
        self._count = 0
        self._begin_ns = 0
        self._end_ns = 0
        self._index = bytearray()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._repeated = 0
        self._statistics = Statistics(
            attachment_count=0,
            channel_count=0,
            channel_message_counts=defaultdict(int),
            chunk_count=0,
            message_count=0,
            message_end_time=0,
            message_start_time=0,
            metadata_count=0,
            schema_count=0,
        )

    def start(self, profile: str, library: str) -> None:
        """Write what opens a file; `library` is what wrote it."""
        self._write(MCAP0_MAGIC)
        self._write(_bytes_of(Header(profile, library)))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a type of messages; its id."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name))
        self._statistics.schema_count += 1
        self._declare(self._schemas[-1])
        return len(self._schemas)

    def add_channel(self, topic: str, encoding: str, schema_id: int) -> int:
        """Declare a channel; its id."""
        number = len(self._channels) + 1
        self._channels.append(
            Channel(id=number, topic=topic, message_encoding=encoding, schema_id=schema_id, metadata={})
        )
        self._statistics.channel_count += 1
        self._declare(self._channels[-1])
        return number

    def _declare(self, record: McapRecord) -> None:
        declared = _bytes_of(record)
        self._records.write(declared)
        self._repeated += len(declared)

    def add_message(self, channel_id: int, time_ns: int, sequence: int, data: bytes) -> None:
        """Append a message to the chunk in progress, which is written when it is full."""
        message = Message(
            channel_id=channel_id, log_time=time_ns, publish_time=time_ns, sequence=sequence, data=data
        )
        entry = self._entries.setdefault(channel_id, MessageIndex(channel_id=channel_id, records=[]))
        entry.records.append((time_ns, self._records.count))
        self._begin_ns = min(self._begin_ns, time_ns) if self._count else time_ns
        self._end_ns = max(self._end_ns, time_ns) if self._count else time_ns
        self._count += 1
        message.write(self._records)
        self._count_in(channel_id, time_ns)
        if self._records.count > self._chunk_bytes:
            self.flush()

    def _count_in(self, channel_id: int, time_ns: int) -> None:
        total = self._statistics
        first = time_ns if total.message_count == 0 else min(total.message_start_time, time_ns)
        total.message_start_time = first
        total.message_end_time = max(total.message_end_time, time_ns)
        total.channel_message_counts[channel_id] += 1
        total.message_count += 1

    def flush(self) -> None:
        """Write the chunk in progress, where it holds a message."""
        if not self._count:
            return
        data = self._records.end()
        chunk = Chunk(
            compression="",
            data=data,
            message_start_time=self._begin_ns,
            message_end_time=self._end_ns,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        offset = self._file.tell()
        record = _bytes_of(chunk)
        offsets, entries = {}, b""
        for channel_id, entry in self._entries.items():
            offsets[channel_id] = offset + len(record) + len(entries)
            entries += _bytes_of(entry)
        self._write(record)
        self._write(entries)
        self._index += _bytes_of(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=offset,
                chunk_length=len(record),
                message_index_offsets=offsets,
                message_index_length=len(entries),
                compression="",
                compressed_size=len(data),
                uncompressed_size=len(data),
            )
        )
        self._statistics.chunk_count += 1
        self._entries.clear()
        self._count = 0

    def bytes_to_end(self, message_bytes: int) -> int:
        """Bytes that the file may grow by at most, with one more message and then its end."""
        pending = sum(len(entry.records) for entry in self._entries.values()) + 1
        chunk = _CHUNK_BYTES + self._records.count + _MESSAGE_BYTES + message_bytes + _ENTRY_BYTES * pending
        entry = _INDEX_BYTES + _CHANNEL_BYTES * len(self._channels)
        return chunk + entry + len(self._index) + self._repeated + _END_BYTES

    def finish(self) -> None:
        """Write the chunk in progress, the index and the end."""
        self.flush()
        self._write(_bytes_of(DataEnd(self._crc)))
        start = self._file.tell()
        groups = (
            (Opcode.SCHEMA, b"".join(map(_bytes_of, self._schemas))),
            (Opcode.CHANNEL, b"".join(map(_bytes_of, self._channels))),
            (Opcode.STATISTICS, _bytes_of(self._statistics)),
            (Opcode.CHUNK_INDEX, bytes(self._index)),
            (Opcode.ATTACHMENT_INDEX, b""),
            (Opcode.METADATA_INDEX, b""),
        )
        summary, offsets = b"", b""
        for opcode, group in groups:
            offsets += _bytes_of(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        where = Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=0)
        crc = zlib.crc32(_bytes_of(where)[:-4], zlib.crc32(summary + offsets))
        self._file.write(summary + offsets)
        self._file.write(_bytes_of(Footer(where.summary_start, where.summary_offset_start, crc)))
        self._file.write(MCAP0_MAGIC)

    def _write(self, data: bytes) -> None:
        """Write into the data's part, over which a checksum goes."""
        self._crc = zlib.crc32(data, self._crc)
        self._file.write(data)


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
