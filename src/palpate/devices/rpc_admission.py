"""Authentication of connections to the process that holds devices, before they get a connection slot.

One thread accepts connections and reads their first line. Until the token has arrived, a connection costs one
socket and at most `MAX_TOKEN_BYTES` of memory, and no thread. Silent connections are closed after
`AUTH_S`, or earlier if the pool is full: the oldest silent connection makes room for the newest. A connection
whose bytes have arrived is always read before any connection is evicted.
"""

from __future__ import annotations

import contextlib
import errno
import selectors
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field

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
