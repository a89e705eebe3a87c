"""Where a rig's process listens, in a file that only its user can read, and a lock that only one can hold.

The file holds the port and a token. Whoever can read it may drive the rig; nobody else on the machine can.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO

from palpate.core.errors import DeviceError, PalpateError, RecordingError
from palpate.core.files import storage_errors
from palpate.recordings.lock import lock

_MOST_BYTES = 4096
MOST_NAME = 80  # characters of a file's name


@dataclass(frozen=True, slots=True)
class Address:
    """How to reach a rig's process.

    Attributes:
        rig: its name.
        port: on 127.0.0.1.
        token: said first by whoever connects.
        pid: of the process.
    """

    rig: str
    port: int
    token: str
    pid: int


def folder_of(folder: Path | None = None) -> Path:
    """Where the files lie: the user's runtime folder, or the one in their home, closed to everybody else.

    Raises:
        StorageError: it cannot be made.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    found = folder or (Path(runtime) if runtime else Path.home() / ".cache") / "palpate"
    with storage_errors(found):
        found.mkdir(parents=True, exist_ok=True, mode=0o700)
        found.chmod(0o700)
    return found


def path_of(rig: str, folder: Path | None = None, kind: str = "json") -> Path:
    """The file of a rig, by its name or its file's path."""
    name = re.sub("[^A-Za-z0-9]+", "-", rig)
    if len(name) > MOST_NAME:  # two long paths may end alike
        name = f"{name[-MOST_NAME:]}-{hashlib.sha256(rig.encode()).hexdigest()[:8]}"
    return folder_of(folder) / f"rig-{name}.{kind}"


def hold(rig: str, folder: Path | None = None) -> BinaryIO:
    """The right to be this rig's only process, until what is returned is closed or the process ends.

    Raises:
        DeviceError: another process drives it.
    """
    path = path_of(rig, folder, "lock")
    with storage_errors(path):
        path.touch(mode=0o600)
    try:
        return lock(path)
    except RecordingError as e:
        raise DeviceError(f"another process drives the rig {rig} already; end that one first") from e


def publish(address: Address, folder: Path | None = None) -> Path:
    """Write the file, whole, in place of one that a process left that is gone."""
    path = path_of(address.rig, folder)
    with storage_errors(path):
        handle, name = tempfile.mkstemp(prefix=".rig-", dir=path.parent)  # of mode 0600
        with os.fdopen(handle, "w") as file:
            json.dump(asdict(address), file)
        Path(name).replace(path)
    return path


def find(rig: str, folder: Path | None = None) -> Address | None:
    """What the file says; None where there is none, or none that can be read as one.

    That there is a file does not mean that there is a process: one that was killed leaves it behind.
    """
    try:
        data = path_of(rig, folder).read_bytes()[:_MOST_BYTES]
        said = json.loads(data)
        return Address(str(said["rig"]), int(said["port"]), str(said["token"]), int(said["pid"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError, PalpateError):
        return None
