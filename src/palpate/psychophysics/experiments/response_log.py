"""The table of a participant's judgements as it grows: a row at a time, on disk before the next trial.

Whoever holds it holds its lock. A row that a kill or a full disk cut short has no end of line. When the table
is opened again it is taken off, so that at most the judgement that was being given is lost; if nothing but
the end of line is missing, that is put there, and the judgement stays.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from palpate.core import Closing, LabelError, RecordingError, lock, storage_errors
from palpate.psychophysics.judgements import (
    RESPONSE_COLUMNS,
    RESPONSES,
    Judgement,
    judgement_row,
    read_judgements,
)

COLUMNS = (*RESPONSE_COLUMNS, "simulated")
HEADER = ",".join(COLUMNS) + "\n"


def response_lines(judgements: Iterable[Judgement], simulated: bool) -> str:
    """Rows of a table that has `HEADER` above them."""
    text = io.StringIO(newline="")
    marked = {"simulated": "yes" if simulated else "no"}
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    table.writerows(judgement_row(one) | marked for one in judgements)
    return text.getvalue()


class ResponseLog(Closing):
    """A participant's response table, open for one writer; `torn` bytes of an incomplete row were removed."""

    def __init__(self, folder: Path, simulated: bool, fsync: Callable[[int], None] = os.fsync) -> None:
        self._path, self._simulated, self._fsync = folder / RESPONSES, simulated, fsync
        try:
            self._file = lock(self._path)
        except RecordingError as e:
            raise RecordingError(
                f"{folder.name} is being run in another terminal; end that sitting first, by q or Ctrl-C",
                code="session-in-use",
            ) from e
        try:
            self.torn = self._mend_tail()
            self.judgements = list(read_judgements(self._path))
            self._size = self._path.stat().st_size
        except BaseException:
            self._file.close()
            raise

    def append(self, judgement: Judgement) -> None:
        """Put a judgement on disk; when this returns no kill can take it away."""
        line, handle = response_lines([judgement], self._simulated).encode(), self._file.fileno()
        with storage_errors(self._path):
            if os.fstat(handle).st_size != self._size:
                raise LabelError(f"{self._path} was changed while it was being written; put it back")
            try:
                os.lseek(handle, self._size, os.SEEK_SET)
                written = 0
                while written < len(line):
                    written += os.write(handle, line[written:])
                self._fsync(handle)
            except OSError:
                with suppress(OSError):
                    os.ftruncate(handle, self._size)
                raise
        self._size += len(line)
        self.judgements.append(judgement)

    def close(self) -> None:
        self._file.close()

    def _mend_tail(self) -> int:
        """Complete or take off a row without an end of line; bytes that were taken off."""
        with storage_errors(self._path):
            data = self._path.read_bytes()
            whole = data.rfind(b"\n") + 1
            if not whole or whole == len(data):
                return len(data) - whole
            handle = self._file.fileno()
            if complete := _is_row(data[whole:]):
                os.lseek(handle, len(data), os.SEEK_SET)
                os.write(handle, b"\n")
            else:
                os.ftruncate(handle, whole)
            os.fsync(handle)
        return 0 if complete else len(data) - whole


def _is_row(tail: bytes) -> bool:
    """Whether a row has all its columns, the last of them whole."""
    fields = tail.decode("ascii", "replace").split(",")
    return len(fields) == len(COLUMNS) and fields[-1] in ("yes", "no")
