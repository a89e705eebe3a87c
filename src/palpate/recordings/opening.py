"""Lock a run, claim its next segment and say when that begins."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from palpate.core.errors import RecordingError
from palpate.core.files import lock, sha256_of
from palpate.recordings import schema
from palpate.recordings.manifest import MANIFEST, Manifest
from palpate.recordings.reader import Run
from palpate.recordings.segment import Segment, segment_numbers


@dataclass(frozen=True)
class Opened:
    """A claimed segment of a locked run.

    Attributes:
        manifest: of the run.
        segment: open for appending.
        held: the lock, until it is closed.
        start_ns: the segment's first instant [ns since 1970].
        zero_ns: what the clock's reading is added to, to count from 1970.
    """

    manifest: Manifest
    segment: Segment
    held: BinaryIO
    start_ns: int
    zero_ns: int


def open_segment(path: Path, now_ns: int) -> Opened:
    """Claim the next segment of a run; it begins when the clock reads `now_ns`.

    Raises:
        RecordingError: not a run, or another writer has it.
        ExistsError: another writer claimed the segment.
        StorageError: the disk refused.
    """
    Manifest.read(path)
    with ExitStack() as undo:
        held = undo.enter_context(lock(path / MANIFEST))
        run = Run.open(path)
        number = max(segment_numbers(path), default=-1) + 1
        start_ns = _start(run, now_ns)
        about = {
            "run_id": run.manifest.run_id,
            "segment": number,
            "manifest_sha256": sha256_of(path / MANIFEST),
            "clock_ns": now_ns,
        }
        segment = Segment.claim(path, number, about, start_ns)
        undo.pop_all()
    return Opened(run.manifest, segment, held, start_ns, start_ns - now_ns)


def _start(run: Run, now_ns: int) -> int:
    """When the next segment begins [ns since 1970]: as the clock says, and after all that is there."""
    if not run.segments:
        return run.manifest.created_ns
    start_ns = run.end_ns + 1
    last = run.segments[-1]
    clock_ns = last.about.get("clock_ns")
    if last.begin_ns is not None and isinstance(clock_ns, int):
        start_ns = max(start_ns, last.begin_ns + now_ns - clock_ns)
    if start_ns > schema.MAX_TIME_NS:
        raise RecordingError(f"{run.path} ends in 2038, beyond which no stamp can tell; record a new run")
    return start_ns
