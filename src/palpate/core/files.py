"""Files and folders that appear whole or not at all, never over what exists; locks for one writer at a time.

The operating system drops a lock when its holder dies.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import BinaryIO, TypeVar

from palpate.core.errors import ExistsError, InputError, RecordingError, StorageError

if sys.platform == "win32":
    import msvcrt

    _FAR = 1 << 30  # a locked byte cannot be read, so lock one that is not there

    def _try_lock(file: BinaryIO) -> None:
        file.seek(_FAR)
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _try_lock(file: BinaryIO) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def lock(path: Path) -> BinaryIO:
    """Lock a file against others who lock it, until what is returned is closed or its process ends.

    The file is neither read nor written.
    """
    with storage_errors(path):
        file = path.open("r+b")
        try:
            _try_lock(file)
        except (BlockingIOError, PermissionError) as e:
            file.close()
            raise RecordingError(f"{path.parent} has another writer; end that one first") from e
        except BaseException:
            file.close()
            raise
    return file


PathText = str | os.PathLike[str]
"""A path, as a caller may give it."""


def refuse_existing(path: Path | None) -> None:
    """Raise if `path` exists in any form, a dangling link included; None names no file."""
    if path is not None and os.path.lexists(path):
        raise ExistsError(f"{path} exists, and nothing is ever overwritten; name a new path or move it away")


def is_hidden(path: Path, folder: Path) -> bool:
    """Whether its name, or that of a folder between, begins with a dot, as what is being written does."""
    return any(part.startswith(".") for part in path.relative_to(folder).parts)


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's refusals into `StorageError`s that name the path and the remedy."""
    try:
        yield
    except OSError as e:
        if isinstance(e, StorageError | ExistsError):
            raise
        if e.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise StorageError(
                f"no room left while writing {path} ({e.strerror}); free some space and run again",
                code="disk-full",
            ) from e
        raise StorageError(
            f"{path}: {e.strerror or e}; check the path and its permissions", code="file-access"
        ) from e


Opened = TypeVar("Opened", bound="Closing")


MAX_NAME = 100


def plain_name(text: str, of: str = "a run") -> str:
    """A name that is no path, so that what is made of it lies in the folder in which it is made."""
    good = text.isprintable() and 0 < len(text) <= MAX_NAME and not set(text) & set('/\\:*?"<>|')
    if not good or text.startswith(".") or text.strip() != text:
        raise InputError(
            f"{text[:MAX_NAME]!r} is no name for {of}; give 1 to {MAX_NAME} letters, digits and such, "
            "no slash, and no dot in front"
        )
    return text


class Closing:
    """What a `with` statement closes at its end, by its own `close`."""

    def close(self) -> None:
        """Let go of what is held open."""
        raise NotImplementedError

    def __enter__(self: Opened) -> Opened:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def new_folder(path: Path) -> AbstractContextManager[Path]:
    """Build a folder beside `path`, and move it there only when the block ends well.

    Returns:
        A context of the folder to fill. After an error it is removed, and `path` was never there.
    """
    return _moved_when_whole(path, Path.mkdir)


def new_file(path: Path) -> AbstractContextManager[Path]:
    """Write a file beside `path`, and move it there only when the block ends well.

    Returns:
        A context of the path to write to, of an empty file; errors as of `new_folder`.
    """
    return _moved_when_whole(path, Path.touch)


@contextmanager
def _moved_when_whole(path: Path, make: Callable[[Path], None]) -> Iterator[Path]:
    refuse_existing(path)
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        passing = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent))
        try:
            building = passing / path.name  # made by name, so that its mode is what the umask allows
            make(building)
            yield building
            sync_tree(building)
            refuse_existing(path)
            building.rename(path)
            sync(path.parent)
        finally:
            shutil.rmtree(passing, ignore_errors=True)


def sync(path: Path) -> None:
    """Have the operating system put one file or folder on disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_tree(folder: Path) -> None:
    """Have the operating system put a folder and everything in it on disk, or one file."""
    for path in sorted(folder.rglob("*")):
        sync(path)
    sync(folder)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's bytes, as 64 hexadecimal digits."""
    with storage_errors(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of_all(paths: Iterable[Path], known: Mapping[str, str] | None = None) -> str:
    """One SHA-256 over the names and the bytes of several files, in the order given.

    Args:
        paths: of the files.
        known: name -> checksum of files that come before them and are not read.
    """
    total = hashlib.sha256()
    checksums = [*(known or {}).items(), *((path.name, sha256_of(path)) for path in paths)]
    for name, checksum in checksums:
        total.update(f"{name}\0{checksum}\0".encode())
    return total.hexdigest()
