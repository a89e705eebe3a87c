"""Segments of a run: MCAP files of frames and of signals, written, read up to any damage, and their words."""

from palpate.recordings.segments.segment_reader import (
    Damage,
    StoredFrame,
    StoredMessage,
    StoredSegment,
    frames_in,
    scan,
    scan_growing,
)
from palpate.recordings.segments.segment_writer import (
    EVENTS,
    FORCE,
    FRAMES,
    KINDS,
    LABELS,
    RAW,
    RECORDED,
    STAGE,
    Channel,
    Segment,
    decode,
    decode_json,
    file_name,
    segment_numbers,
)

__all__ = [
    "EVENTS", "FORCE", "FRAMES", "KINDS", "LABELS", "RAW", "RECORDED", "STAGE", "Channel", "Damage",
    "Segment", "StoredFrame", "StoredMessage", "StoredSegment", "decode", "decode_json", "file_name",
    "frames_in", "scan", "scan_growing", "segment_numbers",
]  # fmt: skip
