"""One writer at a time: a lock that the operating system drops when its holder dies."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import BinaryIO

from palpate.core.errors import RecordingError
from palpate.core.files import storage_errors

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

    Raises:
        RecordingError: another holds it.
        StorageError: it cannot be opened.
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
