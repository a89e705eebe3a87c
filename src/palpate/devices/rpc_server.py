"""Server of the process that holds devices: loopback only, a token first, then one JSON object a line.

Each client has a thread that reads, one that writes and one for what takes time, so that nothing that one
client does, sends or fails to read holds up another, and an emergency stop never waits behind a plan.
"""

from __future__ import annotations

import contextlib
import hmac
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from palpate.core import DeviceError, InputError, PalpateError, ProtocolError
from palpate.core.failure_log import record_failure, report_to_stderr
from palpate.devices.rpc import ASKED_BYTES, MAX_TOKEN_BYTES, Admission, Lines, decode_message, encode_message

MAX_REPLIES = 1000  # that a client may leave unread


class Outbox:
    """Sends from a thread of its own, so that a client that does not read holds nobody up.

    Attributes:
        sent: nothing is sent any more: all was, or the client has gone.
    """

    def __init__(self, to: socket.socket, give_up: Callable[[], None]) -> None:
        self._socket = to
        self._give_up = give_up
        self._changed = threading.Condition()
        self._replies: deque[bytes] = deque()
        self._pushes: dict[str, bytes] = {}
        self._closed = False
        self.pictured = False
        self.sent = threading.Event()
        threading.Thread(target=self._send, name="palpate-rpc-outbox", daemon=True).start()

    def reply(self, message: Mapping[str, Any]) -> None:
        """Send it in order; a client that lets too many lie is dropped."""
        line = encode_message(message)
        with self._changed:
            self._replies.append(line)
            full = len(self._replies) > MAX_REPLIES
            self._changed.notify()
        if full:
            self._give_up()

    def push(self, kind: str, line: bytes) -> None:
        """Send it in place of the last of its kind, if that still waits."""
        with self._changed:
            self._pushes[kind] = line
            self._changed.notify()

    def close(self) -> None:
        """Send the replies that wait, then let go of the socket."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def _send(self) -> None:
        with self._socket:
            try:
                while (line := self._next()) is not None:
                    self._socket.sendall(line)
            except OSError:
                pass  # it has gone
            self.sent.set()
            self._give_up()

    def _next(self) -> bytes | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._replies or self._pushes)
            if self._replies:
                return self._replies.popleft()
            if self._closed:
                return None
            return self._pushes.pop(next(iter(self._pushes)))


HOST = "127.0.0.1"
TOLD_S = 0.2  # between two pushes
ANSWERED_S = 0.5  # in which a client that is let go of takes its last answers
MAX_CLIENTS = 32  # authenticated connections
MAX_WAITING = 8  # slow requests of one client
CHUNK = 65_536

Request = Callable[[Mapping[str, Any]], Any]


class RpcServer:
    """Lets others on this machine ask the process that holds devices.

    Args:
        name: of what it holds, told to every client that is let in.
        status: what is pushed to every client, a few times a second; plain values.
        picture: the newest picture with its "number", or None where there is none newer than that number.
        quick: requests answered in the thread that reads, never behind another: all that stops something.
        slow: requests that may take time; those of one client wait for each other.

    Attributes:
        port: on 127.0.0.1, chosen by the system.
        token: that a client says first.
        serial: of the last status that was pushed.
    """

    def __init__(
        self,
        name: str,
        status: Callable[[], Mapping[str, Any]],
        picture: Callable[[int], Mapping[str, Any] | None],
        quick: Mapping[str, Request],
        slow: Mapping[str, Request],
    ) -> None:
        self.name, self.quick, self.slow = name, quick, slow
        self._status, self._picture = status, picture
        self.token = secrets.token_urlsafe(32)
        listener = socket.create_server((HOST, 0))
        self.port: int = listener.getsockname()[1]
        self._closing = threading.Event()
        self._news = threading.Event()
        self._lock = threading.Lock()
        self._clients: set[_Connection] = set()
        self.serial = 0
        self._admission = Admission(listener, self._admit, self._too_long)
        self._threads = [
            threading.Thread(target=work, name=f"palpate-rpc-{name}", daemon=True)
            for name, work in (("admission", self._admission.run), ("tell", self._tell))
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Let go of every client, after what it asked last has been answered; the service goes on."""
        self._closing.set()
        self._news.set()
        self._admission.close()
        self._threads[0].join(ANSWERED_S)  # no client is admitted after this
        clients, late_s = self._all(), time.monotonic() + ANSWERED_S
        for client in clients:
            client.hear_no_more()
        for client in clients:
            client.outbox.sent.wait(max(0.0, late_s - time.monotonic()))
            client.drop()

    def nudge(self) -> None:
        """Something has changed: tell it sooner."""
        self._news.set()

    def forget(self, client: _Connection) -> None:
        """A client has gone."""
        with self._lock:
            self._clients.discard(client)

    def leave(self, leaver: _Connection) -> int:
        """Count those that stay when this one leaves; of all that leave at once, the last is told 0."""
        with self._lock:
            leaver.leaves = True
            return sum(not client.leaves for client in self._clients)

    def _all(self) -> list[_Connection]:
        with self._lock:
            return list(self._clients)

    def _admit(self, connection: socket.socket, line: bytes, rest: bytes) -> None:
        """Give a connection slot to a connection whose first line holds the token."""
        request: dict[str, Any] = {}
        try:
            request = decode_message(line)
            self._check_token(request)
            with self._lock:
                if len(self._clients) >= MAX_CLIENTS:
                    raise DeviceError(
                        f"{MAX_CLIENTS} clients are connected, which is the limit. Close one.",
                        code="rpc-clients",
                    )
                client = _Connection(self, connection)
                self._clients.add(client)
        except PalpateError as e:
            _close_with(connection, encode_message(_refusal(request, e)))
            return
        client.begin(request, rest)
        self.nudge()

    def _check_token(self, request: Mapping[str, Any]) -> None:
        token = request.get("token")
        right = self.token.encode()
        if not isinstance(token, str) or not hmac.compare_digest(token.encode("utf-8", "replace"), right):
            raise ProtocolError(
                "say the token first, as in {'token': ...}; it is in the process's address file",
                code="rpc-token",
            )

    def _too_long(self, connection: socket.socket) -> None:
        error = ProtocolError(
            f"the first line has more than {MAX_TOKEN_BYTES} bytes; say the token first", code="rpc-token"
        )
        _close_with(connection, encode_message(_refusal({}, error)))

    def _tell(self) -> None:
        latest = -1
        while not self._closing.is_set():
            try:
                latest = self._tell_all(latest)
            except Exception as e:  # later statuses are sent all the same
                report_to_stderr(record_failure(e, f"the status of {self.name}"))
            self._news.wait(TOLD_S)
            self._news.clear()
            self._closing.wait(TOLD_S / 4)  # however often it is nudged

    def _tell_all(self, latest: int) -> int:
        """Push the status, and a picture where there is one newer than that number; the newest's number."""
        watching = [client.outbox for client in self._all()]
        if not watching:
            return latest
        self.serial += 1  # before it is looked at: what was done by then is in it
        status = encode_message({"push": "status", "serial": self.serial, **self._status()})
        picture = self._picture(latest if all(out.pictured for out in watching) else -1)
        for out in watching:
            out.push("status", status)
        if picture is None:
            return latest
        line = encode_message({"push": "picture", **picture})
        for out in watching:
            out.push("picture", line)
            out.pictured = True
        return int(picture["number"])


class _Connection:
    """One authenticated connection."""

    def __init__(self, server: RpcServer, connection: socket.socket) -> None:
        with contextlib.suppress(OSError):  # it has gone already, which the reading thread finds
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setblocking(True)
        self._server = server
        self._socket = connection
        self.outbox = Outbox(connection, self.drop)
        self.leaves = False
        self._waiting = threading.Semaphore(MAX_WAITING)
        self._turn = threading.Lock()

    def begin(self, request: Mapping[str, Any], rest: bytes) -> None:
        """Answer the request that held the token, then the lines in `rest` and those that follow."""
        self._reply(request, {"rig": self._server.name})
        work = threading.Thread(target=self._read, args=(rest,), name="palpate-rpc-client", daemon=True)
        work.start()

    def drop(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def hear_no_more(self) -> None:
        """Read nothing more; what was asked before is still answered."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RD)

    def _read(self, data: bytes) -> None:
        lines = Lines(ASKED_BYTES)
        try:
            while True:
                for line in lines.feed(data):
                    self._take(line)
                data = self._socket.recv(CHUNK)
                if not data:
                    return
        except OSError:
            return  # it has gone
        finally:
            self._server.forget(self)
            self.outbox.close()  # sends what waits, then lets go of the socket

    def _take(self, line: bytes | None) -> None:
        request: dict[str, Any] = {}
        try:
            if line is None:
                raise ProtocolError(f"a line longer than {ASKED_BYTES} bytes; send shorter ones")
            request = decode_message(line)
            self._do(request)
        except PalpateError as e:
            self._refuse(request, e)

    def _do(self, request: Mapping[str, Any]) -> None:
        name = request.get("do")
        if name == "leave":
            self._perform(request, lambda _: self._server.leave(self))
        elif isinstance(name, str) and name in self._server.quick:
            self._perform(request, self._server.quick[name])
        elif isinstance(name, str) and name in self._server.slow:
            if not self._waiting.acquire(blocking=False):
                raise InputError(f"{MAX_WAITING} requests wait already; wait for their replies")
            work = threading.Thread(target=self._later, args=(request, self._server.slow[name]), daemon=True)
            work.start()
        else:
            names = ", ".join(["leave", *self._server.quick, *self._server.slow])
            raise InputError(f"there is nothing called {str(name)[:50]!r} to do; there are {names}")

    def _later(self, request: Mapping[str, Any], ask: Request) -> None:
        try:
            with self._turn:
                self._perform(request, ask)
        finally:
            self._waiting.release()

    def _perform(self, request: Mapping[str, Any], ask: Request) -> None:
        try:
            self._reply(request, ask(request))
        except Exception as e:  # whatever a client sends, the process goes on, and the client is told
            self._refuse(request, e)
        finally:
            self._server.nudge()

    def _reply(self, request: Mapping[str, Any], result: Any) -> None:
        reply = {"id": _id(request), "ok": True, "serial": self._server.serial, "result": result}
        self.outbox.reply(reply)

    def _refuse(self, request: Mapping[str, Any], error: Exception) -> None:
        self.outbox.reply(_refusal(request, error))


def _refusal(request: Mapping[str, Any], error: Exception) -> dict[str, Any]:
    code = error.code if isinstance(error, PalpateError) else "internal"
    kind = type(error).__name__
    return {"id": _id(request), "ok": False, "kind": kind, "code": code, "error": str(error)}


def _close_with(connection: socket.socket, line: bytes) -> None:
    """Send one short line without waiting, and close the connection."""
    with connection, contextlib.suppress(OSError):
        connection.send(line)
        connection.shutdown(socket.SHUT_WR)


def _id(request: Mapping[str, Any]) -> int | None:
    number = request.get("id")
    return number if isinstance(number, int) and abs(number) < 1 << 53 else None


def request_field(request: Mapping[str, Any], name: str, kinds: tuple[type, ...]) -> Any:
    """A field of a request.

    Raises:
        InputError: it is missing, or of another kind.
    """
    value = request.get(name)
    if not isinstance(value, kinds):
        raise InputError(f"{name!r} is missing, or not {' or '.join(kind.__name__ for kind in kinds)}")
    return value
