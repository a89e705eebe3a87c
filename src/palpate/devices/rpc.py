"""Address, lock and language that a process that holds devices shares with its clients.

An address file holds a port and a token. Only its user can read it: whoever can may drive the devices, and
nobody else on the machine can. A lock lets one process at a time hold them.

The language is one JSON object a line, of bounded length, in both directions. A request is
``{"id": 7, "do": "pause"}``; its reply carries the same id, ``"ok"``, and what came of it or ``"error"``
and ``"kind"``. What is pushed carries ``"push"`` instead of an id. Whoever connects says ``{"token": ...}``
first.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

from palpate.core import DeviceError, PalpateError, ProtocolError, RecordingError, lock, storage_errors

_MAX_BYTES = 4096
MAX_NAME = 80  # characters of a file's name
WORKSPACES = "workspaces"  # folder of the address files of processes that belong to a workspace


@dataclass(frozen=True, slots=True)
class Address:
    """Address of a process that holds devices.

    Attributes:
        name: of what the process holds, such as a rig's.
        port: on 127.0.0.1.
        token: said first by whoever connects.
        pid: of the process.
    """

    name: str
    port: int
    token: str
    pid: int


def folder_of(folder: Path | None = None) -> Path:
    """Folder of the files: the user's runtime folder, or the one in their home, closed to everybody else.

    Raises:
        StorageError: it cannot be made.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    home = folder or (Path(runtime) if runtime else Path.home() / ".cache") / "palpate"
    with storage_errors(home):
        home.mkdir(parents=True, exist_ok=True, mode=0o700)
        home.chmod(0o700)
    return home


def path_of(name: str, folder: Path | None = None, kind: str = "json") -> Path:
    """The file of a process, by the name of what it holds or its file's path."""
    stem = re.sub("[^A-Za-z0-9]+", "-", name)
    if len(stem) > MAX_NAME:  # two long paths may end alike
        stem = f"{stem[-MAX_NAME:]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    return folder_of(folder) / f"devices-{stem}.{kind}"


def workspace_folder(workspace: Path) -> Path:
    """Folder of the address files of processes that belong to one workspace."""
    digest = hashlib.sha256(str(workspace.resolve()).encode()).hexdigest()[:16]
    return folder_of(folder_of() / WORKSPACES / digest)


def shared_folder(folder: Path | None) -> Path | None:
    """Folder of the address files that all workspaces share, such as those of supervisors of real devices."""
    return folder.parents[1] if folder is not None and folder.parent.name == WORKSPACES else folder


def supervisor_name(name: str) -> str:
    """Name of the process that supervises the motion of what a process holds."""
    return f"{name} supervisor"


def hold(name: str, folder: Path | None = None) -> BinaryIO:
    """The right to be the only process of this name, until what is returned is closed or the process ends.

    Raises:
        DeviceError: another process drives it.
    """
    path = path_of(name, folder, "lock")
    with storage_errors(path):
        path.touch(mode=0o600)
    try:
        return lock(path)
    except RecordingError as e:
        holder = find(name, folder)
        who = "another process" if holder is None else f"process {holder.pid}"
        raise DeviceError(f"{who} drives {name} already; end that one first", code="already-driven") from e


def publish(address: Address, folder: Path | None = None) -> Path:
    """Write the file, whole, in place of one that a process left that is gone."""
    path = path_of(address.name, folder)
    with storage_errors(path):
        handle, name = tempfile.mkstemp(prefix=".devices-", dir=path.parent)  # of mode 0600
        with os.fdopen(handle, "w") as file:
            json.dump(asdict(address), file)
        Path(name).replace(path)
    return path


def find(name: str, folder: Path | None = None) -> Address | None:
    """Address in the file; None where there is none, or none that can be read as one.

    That there is a file does not mean that there is a process: one that was killed leaves it behind. Without
    a folder, a process of a workspace is returned if no other process of this name is alive.
    """
    try:
        path = path_of(name, folder)
    except PalpateError:
        return None
    found = _read_address(path)
    if folder is None and (found is None or not _is_alive(found.pid)):
        others = map(_read_address, path.parent.glob(f"{WORKSPACES}/*/{path.name}"))
        found = next((one for one in others if one and _is_alive(one.pid)), found)
    return found


def running(prefix: str, folder: Path | None = None) -> list[str]:
    """Names that begin so, of processes that are alive, in order."""
    found = [_read_address(path) for path in folder_of(folder).glob("devices-*.json")]
    return sorted({one.name for one in found if one and one.name.startswith(prefix) and _is_alive(one.pid)})


def _read_address(path: Path) -> Address | None:
    try:
        fields = json.loads(path.read_bytes()[:_MAX_BYTES])
        return Address(str(fields["name"]), int(fields["port"]), str(fields["token"]), int(fields["pid"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _is_alive(pid: int) -> bool:
    if pid <= 0 or os.name != "posix":  # elsewhere there is no asking without a signal
        return pid > 0
    try:
        os.kill(pid, 0)
    except PermissionError:
        return True
    except (OSError, OverflowError):
        return False
    return True


ASKED_BYTES = 256 * 1024
"""Longest line that a service reads: a plan of many thousand places by hand."""
SAID_BYTES = 16 * 1024 * 1024
"""Longest line that a client reads: a large picture."""


def encode_message(message: Mapping[str, Any]) -> bytes:
    """A message as a line.

    Raises:
        ValueError: a number in it is not finite.
    """
    return json.dumps(message, allow_nan=False, separators=(",", ":"), default=_plain).encode() + b"\n"


def _plain(value: Any) -> Any:
    """Return a NumPy number, as plug-ins measure and comparisons of it return, as Python's own."""
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be sent")


def decode_message(line: bytes) -> dict[str, Any]:
    """A line as a message.

    Raises:
        ProtocolError: it is none.
    """
    try:
        message = json.loads(line)
    except (ValueError, RecursionError) as e:
        raise ProtocolError("a line that is not JSON; send one JSON object a line, in UTF-8") from e
    if not isinstance(message, dict):
        raise ProtocolError("a line of JSON that is not an object; send one such as {'do': 'status'}")
    return message


class Lines:
    """Cuts bytes into lines, and keeps no more of them than one line may have."""

    def __init__(self, most_bytes: int) -> None:
        self._most = most_bytes
        self._line = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[bytes | None]:
        """Each line that is whole now, without its end; None for one that was too long."""
        for i, part in enumerate(data.split(b"\n")):
            if i:
                yield self._end_line()
            if not self._skipping:
                self._line += part
                if len(self._line) > self._most:
                    self._line.clear()
                    self._skipping = True

    def _end_line(self) -> bytes | None:
        if self._skipping:
            self._skipping = False
            return None
        line = bytes(self._line)
        self._line.clear()
        return line
