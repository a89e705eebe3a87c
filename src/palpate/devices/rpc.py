"""Address, lock and language that a process that holds devices shares with its clients.

An address file holds a port and a token. Only its user can read it: whoever can may drive the devices, and
nobody else on the machine can. A lock lets one process at a time hold them.

The language is one JSON object a line, of bounded length, in both directions. A request is
``{"id": 7, "do": "pause"}``; its reply carries the same id, ``"ok"``, and what came of it or ``"error"``
and ``"kind"``. What is pushed carries ``"push"`` instead of an id. Whoever connects says ``{"token": ...}``
first.

Authentication of connections to the process that holds devices, before they get a connection slot.

One thread accepts connections and reads their first line. Until the token has arrived, a connection costs one
socket and at most `MAX_TOKEN_BYTES` of memory, and no thread. Silent connections are closed after
`AUTH_S`, or earlier if the pool is full: the oldest silent connection makes room for the newest. A connection
whose bytes have arrived is always read before any connection is evicted.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import selectors
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
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


AUTH_S = 2.0  # time within which a connection sends the token
MAX_UNAUTHENTICATED = 256  # connections that wait for their token
MAX_TOKEN_BYTES = 4096  # length of the first line
SCARCE_S = 0.01  # pause when the process has no file descriptor or buffer left
_SCARCE = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}

Admit = Callable[[socket.socket, bytes, bytes], None]


@dataclass
class _Arrival:
    """A connection that has not sent its first line yet.

    Attributes:
        late_s: monotonic time at which it is closed [s].
        data: bytes received so far.
    """

    connection: socket.socket
    late_s: float
    data: bytearray = field(default_factory=bytearray)


class Admission:
    """Reads the first line of every connection, and hands the connection over with it.

    Args:
        listener: listening socket.
        admit: called in this object's thread with the connection, its first line without the line end, and
            the bytes received after it. It must not block. The connection belongs to the callee from then on.
        refuse: called in the same way for a first line that is too long.
    """

    def __init__(
        self, listener: socket.socket, admit: Admit, refuse: Callable[[socket.socket], None]
    ) -> None:
        self._listener, self._admit, self._refuse = listener, admit, refuse
        self._ended, self._end = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._waiting: dict[int, _Arrival] = {}  # by file descriptor, the oldest first

    def run(self) -> None:
        """Accept connections until `close`; then close the listening socket and all silent connections."""
        self._listener.setblocking(False)
        try:
            self._selector.register(self._ended, selectors.EVENT_READ)
            self._selector.register(self._listener, selectors.EVENT_READ)
            while self._serve():
                pass
        finally:
            for one in (*(arrival.connection for arrival in self._waiting.values()), self._listener):
                one.close()
            self._selector.close()
            self._ended.close()
            self._end.close()

    def close(self) -> None:
        """Request the end of `run`, from another thread."""
        with contextlib.suppress(OSError):  # it has ended
            self._end.send(b"x")

    def _serve(self) -> bool:
        """Handle what has arrived; False after the end of listening."""
        ready = [key for key, _ in self._selector.select(self._patience_s())]
        if any(key.fileobj is self._ended for key in ready):
            return False
        self._read_all(ready)
        self._expire()
        return self._accept()

    def _patience_s(self) -> float | None:
        oldest = next(iter(self._waiting.values()), None)
        return None if oldest is None else max(0.0, oldest.late_s - time.monotonic())

    def _expire(self) -> None:
        now_s = time.monotonic()
        for arrival in [one for one in self._waiting.values() if one.late_s <= now_s]:
            self._drop(arrival)

    def _accept(self) -> bool:
        """Accept one connection, if one waits. At most one, so that received tokens are read in between."""
        try:
            connection, _ = self._listener.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return True
        except OSError as e:
            if e.errno not in _SCARCE:
                return False
            for arrival in list(self._waiting.values())[:1]:
                self._drop(arrival)
            time.sleep(SCARCE_S)
            return True
        connection.setblocking(False)
        arrival = _Arrival(connection, time.monotonic() + AUTH_S)
        self._waiting[connection.fileno()] = arrival
        self._selector.register(connection, selectors.EVENT_READ)
        self._read(arrival)  # a client sends its token at once
        if len(self._waiting) > MAX_UNAUTHENTICATED:
            self._evict()
        return True

    def _evict(self) -> None:
        """Read what has arrived; where all stay silent, close the oldest."""
        self._read_all([key for key, _ in self._selector.select(0)])
        if len(self._waiting) > MAX_UNAUTHENTICATED:
            self._drop(next(iter(self._waiting.values())))

    def _read_all(self, ready: list[selectors.SelectorKey]) -> None:
        for key in ready:
            if key.fd in self._waiting:
                self._read(self._waiting[key.fd])

    def _read(self, arrival: _Arrival) -> None:
        try:
            data = arrival.connection.recv(MAX_TOKEN_BYTES + 1 - len(arrival.data))
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data:
            self._drop(arrival)
            return
        arrival.data += data
        line, ended, rest = arrival.data.partition(b"\n")
        if ended:
            self._release(arrival)
            self._admit(arrival.connection, bytes(line), bytes(rest))
        elif len(arrival.data) > MAX_TOKEN_BYTES:
            self._release(arrival)
            self._refuse(arrival.connection)

    def _release(self, arrival: _Arrival) -> None:
        self._selector.unregister(arrival.connection)
        del self._waiting[arrival.connection.fileno()]

    def _drop(self, arrival: _Arrival) -> None:
        self._release(arrival)
        with contextlib.suppress(OSError):
            arrival.connection.close()
