"""Notes on a run: what somebody saw in it, when; kept beside the run, which itself is never altered."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from palpate.core import InputError, PathText, RecordingError, storage_errors
from palpate.core.parsing import parser
from palpate.recordings.manifest import MANIFEST

NOTES = "notes.jsonl"
MAX_NOTE = 500
"""Characters of a note."""
MAX_NOTES = 2000
MAX_NOTES_BYTES = 4 << 20


@dataclass(frozen=True, slots=True)
class RunNote:
    """Note on a moment of a run.

    Attributes:
        time_s: from the run's first instant [s].
        written_utc: when, in ISO 8601.
    """

    time_s: float
    text: str
    written_utc: str


@parser("run notes", RecordingError)
def read_notes(run: PathText) -> list[RunNote]:
    """Read the notes on a run, in the order of their times; lines that are none are left out."""
    path = Path(run) / NOTES
    if path.is_symlink():
        raise RecordingError(f"{path} is a link; notes lie beside their run: move the file there")
    if not path.is_file():
        return []
    with storage_errors(path):
        if path.stat().st_size > MAX_NOTES_BYTES:
            raise RecordingError(f"{path} is larger than {MAX_NOTES_BYTES} bytes, and notes never are")
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return sorted((note for line in lines if (note := _note(line))), key=lambda note: note.time_s)


def add_note(run: PathText, time_s: float, text: str) -> RunNote:
    """Add a note to a run.

    Args:
        time_s: what the note is on, from the run's first instant [s].
        text: 1 to `MAX_NOTE` characters; line ends become spaces.
    """
    path, text = Path(run) / NOTES, " ".join(text.split())
    if not (path.parent / MANIFEST).is_file():
        raise RecordingError(
            f"{run} is not a run: it holds no {MANIFEST}; name a run's folder", code="not-a-run"
        )
    if not 0 < len(text) <= MAX_NOTE or not math.isfinite(time_s):
        raise InputError(
            f"a note of {len(text)} characters at {time_s} s; it takes 1 to {MAX_NOTE} characters at a time "
            "within the run"
        )
    if len(read_notes(run)) >= MAX_NOTES:
        raise InputError(f"{run} has {MAX_NOTES} notes, and no more are kept; take some out of {NOTES}")
    note = RunNote(round(time_s, 6), text, datetime.now(UTC).isoformat(timespec="seconds"))
    line = json.dumps(asdict(note), ensure_ascii=False, allow_nan=False) + "\n"
    with storage_errors(path):
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        handle = os.open(path, flags, 0o644)
        try:
            os.write(handle, line.encode())
            os.fsync(handle)
        finally:
            os.close(handle)
    return note


def _note(line: str) -> RunNote | None:
    try:
        fields = json.loads(line)
        note = RunNote(
            float(fields["time_s"]), str(fields["text"])[:MAX_NOTE], str(fields["written_utc"])[:40]
        )
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return note if math.isfinite(note.time_s) else None
