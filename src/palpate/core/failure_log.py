"""Log of exceptions that nothing handled: the traceback goes to a file, one line to whoever must know.

No uncaught exception reaches a user as a traceback. `Failure.text` is one line with a code and a path.
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from palpate.core.errors import PalpateError
from palpate.core.shared_history import SharedHistory

INTERNAL = "internal"
INTERNAL_STATUS = 70  # EX_SOFTWARE of sysexits.h
FILE = "errors.log"
MAX_BYTES = 1_000_000  # after which the log is renamed to "errors.log.1" and begun anew
MAX_TEXT = 300


@dataclass(frozen=True, slots=True)
class Failure:
    """Exception that nothing handled.

    Attributes:
        code: "internal", or the code of a `PalpateError`.
        message: kind and text of the exception, on one line.
        where: thread or command in which it was raised.
        log: file that holds its traceback; None if no folder could be written to.
    """

    code: str
    message: str
    where: str
    log: Path | None

    @property
    def text(self) -> str:
        """One line for a user."""
        kept = f"The traceback is in {self.log}." if self.log else "The traceback could not be saved."
        return f"Internal error in {self.where}: {self.message} [{self.code}]. {kept}"

    def to_dict(self) -> dict[str, str | None]:
        """Return plain values for JSON."""
        return {"code": self.code, "message": self.message, "log": str(self.log) if self.log else None}


recent_failures: SharedHistory[Failure] = SharedHistory(100)
"""Failures of this process, oldest first; the studio's pages show them."""

_workspace: list[Path] = []
_lock = threading.Lock()


def state_folder() -> Path:
    """Return the folder of the user's logs: XDG_STATE_HOME/palpate, by default ~/.local/state/palpate."""
    home = os.environ.get("XDG_STATE_HOME")
    return (Path(home) if home else Path.home() / ".local" / "state") / "palpate"


def log_in_workspace(folder: Path) -> None:
    """Write the logs of this process to a workspace's hidden folder from now on."""
    _workspace[:] = [folder.absolute() / ".palpate"]


def record_failure(error: BaseException, where: str) -> Failure:
    """Write an exception's traceback to the log, and return what a user is shown.

    An exception that several handlers receive is written once.
    """
    known = getattr(error, "_palpate_failure", None)
    if isinstance(known, Failure):
        return known
    code = error.code if isinstance(error, PalpateError) else INTERNAL
    message = " ".join(f"{type(error).__name__}: {error}".split())[:MAX_TEXT]
    failure = Failure(code, message, where, _append(error, where))
    recent_failures.append(failure)
    with suppress(AttributeError):  # of an exception with slots
        error._palpate_failure = failure  # type: ignore[attr-defined]
    return failure


def _append(error: BaseException, where: str) -> Path | None:
    lines = traceback.format_exception(error)
    at = datetime.now(UTC).isoformat(timespec="seconds")
    entry = f"--- {at}, process {os.getpid()}, {where}: {' '.join(sys.argv)[:200]}\n{''.join(lines)}\n"
    for folder in (*_workspace, state_folder(), Path(tempfile.gettempdir()) / f"palpate-{_user()}"):
        with _lock, suppress(OSError, RuntimeError):
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            path = folder / FILE
            if path.exists() and path.stat().st_size > MAX_BYTES:
                path.replace(path.with_name(f"{FILE}.1"))
            with path.open("a", encoding="utf-8", errors="replace") as file:
                file.write(entry)
            return path
    return None


def _user() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"


def report_to_stderr(failure: Failure) -> None:
    """Print a failure as one line."""
    with suppress(OSError, ValueError):
        print(f"palpate: {failure.text}", file=sys.stderr, flush=True)


Report = Callable[[Failure], object]


@contextmanager
def thread_failures(report: Report = report_to_stderr) -> Iterator[None]:
    """Log exceptions that end a thread of this process.

    Args:
        report: Receives each failure, in the thread that failed.
    """

    def hook(ended: threading.ExceptHookArgs) -> None:
        if ended.exc_value is not None and not isinstance(ended.exc_value, SystemExit):
            where = ended.thread.name if ended.thread is not None else "a thread"
            report(record_failure(ended.exc_value, where))

    before, threading.excepthook = threading.excepthook, hook
    try:
        yield
    finally:
        threading.excepthook = before


@contextmanager
def contained(where: str, report: Report = report_to_stderr) -> Iterator[None]:
    """Log every exception that would end a process or one of its threads; the process ends with status 70.

    Args:
        where: What the process does, as a phrase.
        report: Receives each failure.
    """
    with thread_failures(report):
        try:
            yield
        except Exception as e:
            report(record_failure(e, where))
            raise SystemExit(INTERNAL_STATUS) from None
