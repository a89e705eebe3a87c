"""Emergency stop listener: a process of its own that needs the page server for nothing.

It uses the standard library only and runs as a script, so that it starts in milliseconds. One thread serves
the pages' requests and keeps a connection to each process that moves something. It stays until the page
server and all of these processes have ended.

A request is ``POST /`` with a JSON body ``{"token": ..., "do": ...}``, sent as text so that a browser sends
it without a preflight request. `do` is one of

* ``state``: which targets are active, and which of them move;
* ``stop``: stop all active targets;
* ``stop-moving``: the same if anything moves or its state is unknown, else nothing.

The answer to a stop names each target that stopped, with the time that it took [ms], and each that failed.
"""

from __future__ import annotations

import hmac
import json
import os
import selectors
import signal
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

MAX_CONNECTIONS = 512
MAX_REQUEST = 4096  # bytes of a request, headers included
MAX_LINE = 16 << 20  # bytes of a line from a process: a large picture
ACCEPTS = 32  # connections accepted between two looks at the others
REQUEST_S = 5.0  # within which a request is complete
IDLE_S = 300.0  # without a request, of a connection that has proven the token
STOP_S = 2.0  # within which each target confirms a stop
ASK_S = 0.15  # within which a process answers whether it moves; otherwise it is assumed to move
FRESH_S = 1.0  # age of a status above which it is unknown whether a process moves
AGAIN_S = 0.25  # between two attempts to reach a process
LINGER_S = 5.0  # without any process, after the page server has ended
NICENESS = -10
RESTS = ("waits", "ended", "paused")
"""States of a process in which nothing moves."""
CHUNK = 1 << 18


def is_moving(status: Mapping[str, Any]) -> bool:
    """Whether a process that reports this status moves something."""
    if status.get("held"):
        return False
    if "recording" in status and not status["recording"]:
        return False
    return status.get("state") not in RESTS


class Link:
    """Connection to one process that moves something, found by its address file.

    Args:
        path: address file, as `palpate.devices.rpc.publish` writes it.
    """

    def __init__(self, path: str, selector: selectors.BaseSelector) -> None:
        self._path, self._selector = path, selector
        self._socket: socket.socket | None = None
        self._buffer = bytearray()
        self._admitted = self._alive = False
        self._number = 0
        self._waiting: dict[int, Callable[[Mapping[str, Any] | None], None]] = {}
        self._unsent: list[bytes] = []
        self._status: Mapping[str, Any] = {}
        self._heard_s = self._tried_s = -1e9

    @property
    def up(self) -> bool:
        """Whether the process has admitted this connection."""
        return self._admitted

    @property
    def moves(self) -> bool | None:
        """Whether the process moves something; None where it is unknown."""
        if not self._admitted or time.monotonic() - self._heard_s > FRESH_S:
            return None
        return is_moving(self._status)

    def connect(self, *, now: bool = False) -> bool:
        """Connect if the process is alive; whether it is."""
        if self._socket is None and (now or time.monotonic() - self._tried_s > AGAIN_S):
            self._tried_s = time.monotonic()
            self._alive = self._try()
        return self._alive

    def _try(self) -> bool:
        address = self._address()
        if address is None:
            return False
        connection = socket.socket()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.connect_ex(("127.0.0.1", address[0]))
        if connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):  # refused: nothing listens any more
            connection.close()
            return False
        self._socket = connection
        self._selector.register(connection, selectors.EVENT_READ | selectors.EVENT_WRITE, self)
        self._write({"token": address[1], "id": 0})
        return True

    def ask(self, do: str, then: Callable[[Mapping[str, Any] | None], None]) -> None:
        """Send a request; `then` receives the reply, or None if the connection is lost."""
        if self._socket is None:
            then(None)
            return
        self._number += 1
        self._waiting[self._number] = then
        self._write({"id": self._number, "do": do})

    def on_event(self, mask: int) -> None:
        """Read or write what is possible without waiting."""
        try:
            if mask & selectors.EVENT_WRITE:
                self._flush()
            if mask & selectors.EVENT_READ and self._socket is not None:
                data = self._socket.recv(CHUNK)
                if not data or not self._feed(data):
                    self._lose()
        except BlockingIOError:
            return
        except OSError:
            self._lose()

    def _address(self) -> tuple[int, str] | None:
        try:
            with open(self._path, "rb") as file:
                fields = json.loads(file.read(4096))
            if os.name == "posix":  # elsewhere a signal ends the process
                os.kill(int(fields["pid"]), 0)
            return int(fields["port"]), str(fields["token"])
        except PermissionError:
            return None
        except (OSError, ValueError, KeyError, TypeError, OverflowError):
            return None

    def _write(self, message: Mapping[str, Any]) -> None:
        self._unsent.append(json.dumps(message).encode() + b"\n")
        try:
            self._flush()
        except OSError:
            self._lose()

    def _flush(self) -> None:
        """Send what waits: the token first, all else once it was accepted."""
        if self._socket is None:
            return
        mask = selectors.EVENT_READ
        while self._unsent and (self._admitted or b'"token"' in self._unsent[0]):
            try:
                sent = self._socket.send(self._unsent[0])
            except BlockingIOError:
                mask |= selectors.EVENT_WRITE
                break
            self._unsent[0] = self._unsent[0][sent:]
            if not self._unsent[0]:
                del self._unsent[0]
        self._selector.modify(self._socket, mask, self)

    def _feed(self, data: bytes) -> bool:
        """Take in what came; False where it is not the process's language."""
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\n")
        for line in lines:
            if not line.startswith(b'{"push":"picture"') and not self._take(bytes(line)):
                return False
        return len(self._buffer) < MAX_LINE

    def _take(self, line: bytes) -> bool:
        try:
            message = json.loads(line)
        except (ValueError, RecursionError):
            return False
        if not isinstance(message, dict) or not (self._admitted or message.get("ok")):
            return False
        if not self._admitted:
            self._admitted = True
            self.ask("leave", lambda _: None)  # not counted among those that use the process
        elif message.get("push") == "status":
            self._status, self._heard_s = message, time.monotonic()
        elif (then := self._waiting.pop(message.get("id", 0), None)) is not None:
            then(message)
        return True

    def _lose(self) -> None:
        if self._socket is not None:
            self._selector.unregister(self._socket)
            self._socket.close()
        self._socket, self._admitted, self._status = None, False, {}
        self._buffer.clear()
        self._unsent.clear()
        waiting, self._waiting = self._waiting, {}
        for then in waiting.values():
            then(None)


class Target:
    """What is stopped under one name, by any of several processes: one of them may hang."""

    def __init__(self, name: str, paths: list[str], selector: selectors.BaseSelector) -> None:
        self.name = name
        self.links = [Link(path, selector) for path in paths]

    def reach(self, *, now: bool = False) -> list[Link]:
        """Connect to all processes that are alive, and return their links."""
        return [link for link in self.links if link.connect(now=now)]

    @property
    def moves(self) -> bool | None:
        """Whether it moves; None where it is unknown, False where no process is alive."""
        found = [link.moves for link in self.reach()]
        return True if True in found else (None if None in found else False)


class Stop:
    """One stop that waits for the confirmation of each target."""

    def __init__(self, targets: list[Target], done: Callable[[dict[str, Any]], None]) -> None:
        self._begun_s, self._done = time.monotonic(), done
        self.due_s = self._begun_s + STOP_S
        self._stopped: list[dict[str, Any]] = []
        self._failed: dict[str, str] = {}
        self.ended = False
        links = [(target.name, link) for target in targets for link in target.reach(now=True)]
        self._open = dict(Counter(name for name, _ in links))
        for name, link in links:
            link.ask("estop", partial(self._take, name))
        self._end_if_complete()

    def _take(self, name: str, reply: Mapping[str, Any] | None) -> None:
        if self.ended or name not in self._open:
            return
        if reply is not None and reply.get("ok"):
            del self._open[name]
            self._failed.pop(name, None)
            took_ms = 1e3 * (time.monotonic() - self._begun_s)
            self._stopped.append({"name": name, "ms": round(took_ms, 1)})
        else:
            self._failed[name] = "process-lost" if reply is None else str(reply.get("error"))[:300]
            self._open[name] -= 1
            if not self._open[name]:
                del self._open[name]
        self._end_if_complete()

    def expire(self) -> None:
        """Answer without the targets that have not confirmed in time."""
        self._failed |= dict.fromkeys(self._open, "no-answer")
        self._open = {}
        self._end_if_complete()

    def _end_if_complete(self) -> None:
        if self._open or self.ended:
            return
        self.ended = True
        failed = [{"name": name, "error": error} for name, error in self._failed.items()]
        reached = bool(failed or self._stopped)
        failed += [] if reached else [{"name": "", "error": "not-reached"}]
        self._done({"ok": not failed, "moving": True, "stopped": self._stopped, "failed": failed})


class Inquiry:
    """Question whether anything moves now, asked before a stop that depends on it."""

    def __init__(self, links: list[Link], done: Callable[[bool], None]) -> None:
        self._open, self._done = len(links), done
        self.due_s = time.monotonic() + ASK_S
        self.ended = False
        for link in links:
            link.ask("status", self._take)
        if not links:
            self._end(moving=False)

    def expire(self) -> None:
        """Assume that a process that does not answer moves."""
        self._end(moving=True)

    def _take(self, reply: Mapping[str, Any] | None) -> None:
        self._open -= 1
        if reply is None or not isinstance(reply.get("result"), dict) or is_moving(reply["result"]):
            self._end(moving=True)
        elif not self._open:
            self._end(moving=False)

    def _end(self, *, moving: bool) -> None:
        if not self.ended:
            self.ended = True
            self._done(moving)


class Visitor:
    """HTTP connection of a page: one request at a time, each small, complete in time, and with the token."""

    def __init__(self, connection: socket.socket, listener: StopLoop) -> None:
        self.socket, self._listener = connection, listener
        self._buffer = bytearray()
        self._origin = ""
        self._busy = self.trusted = False
        self.due_s = time.monotonic() + REQUEST_S

    def on_event(self, mask: int) -> None:
        """Read what has come, and answer a request that is complete."""
        try:
            data = self.socket.recv(MAX_REQUEST)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data or len(self._buffer) + len(data) > 2 * MAX_REQUEST:
            self._listener.drop(self)
            return
        if not self._buffer and not self._busy:
            self.due_s = min(self.due_s, time.monotonic() + REQUEST_S)
        self._buffer += data
        self._serve()

    def _serve(self) -> None:
        if self._busy:
            return
        head, found, rest = bytes(self._buffer).partition(b"\r\n\r\n")
        if not found:
            if len(head) > MAX_REQUEST:
                self._answer(431, {"error": "too-long"})
            return
        lines = head.decode("latin-1").split("\r\n")
        headers = {k.strip().lower(): v.strip() for k, _, v in (one.partition(":") for one in lines[1:])}
        size = headers.get("content-length", "0")
        if not (size.isascii() and size.isdigit() and len(size) < 5 and int(size) <= MAX_REQUEST):
            self._answer(413, {"error": "too-long"})
            return
        if len(rest) < int(size):
            return
        self._busy, self._origin = True, headers.get("origin", "")
        self._buffer = bytearray(rest[int(size) :])
        self._take(lines[0], rest[: int(size)])

    def _take(self, first: str, body: bytes) -> None:
        try:
            asked = json.loads(body) if first.startswith("POST ") else {}
            token, do = str(asked["token"]), str(asked["do"])
        except (ValueError, TypeError, KeyError, RecursionError):
            token = do = ""
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self._listener.token):
            self._answer(403, {"error": "no-token"})
            return
        self.trusted = True
        self._listener.promote(self)
        self._listener.do(do, lambda answer: self._answer(200, answer))

    def _answer(self, status: int, answer: Mapping[str, Any]) -> None:
        body = json.dumps(answer).encode()
        lines = [
            f"HTTP/1.1 {status} {'OK' if status == 200 else 'Refused'}",
            "Content-Type: application/json",
            "Cache-Control: no-store",
            "X-Content-Type-Options: nosniff",
            f"Content-Length: {len(body)}",
        ]
        if self.trusted and self._origin.isprintable() and self._origin:
            lines += [f"Access-Control-Allow-Origin: {self._origin}", "Vary: Origin"]
        if not self.trusted:
            lines.append("Connection: close")
        data = ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1") + body
        try:
            sent = self.socket.send(data)
        except OSError:
            sent = 0
        self._busy = False
        if sent < len(data) or not self.trusted:  # a client that does not read is not waited for
            self._listener.drop(self)
            return
        self.due_s = time.monotonic() + IDLE_S
        if self._buffer:
            self._serve()


class StopLoop:
    """Event loop of the listener.

    Args:
        config: host, port, token, and targets with their names and address files.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        self.token = str(config["token"]).encode()
        self._selector = selectors.DefaultSelector()
        self._targets = [Target(one["name"], one["paths"], self._selector) for one in config["targets"]]
        self._visitors: dict[Visitor, None] = {}  # those without the token first, each the oldest first
        self._trusted: dict[Visitor, None] = {}
        self._pending: list[Stop | Inquiry] = []
        self._server_gone = False
        self._alone_s = 0.0
        self._socket = _listen(str(config["host"]), int(config["port"]))
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self._selector.register(self._socket, selectors.EVENT_READ, None)
        threading.Thread(target=self._hear_server, daemon=True).start()

    def run(self) -> None:
        """Serve until the page server and all processes that move something have ended."""
        self._alone_s = time.monotonic()
        while not self._server_gone or time.monotonic() - self._alone_s < LINGER_S:
            self._turn()

    def do(self, what: str, then: Callable[[dict[str, Any]], None]) -> None:
        """Do what a page with the token asks."""
        if what == "state":
            then(self._state())
        elif what == "stop" or (what == "stop-moving" and any(one.moves for one in self._targets)):
            self._wait_for(Stop(self._targets, then))
        elif what == "stop-moving":
            self._stop_if_moving(then)
        else:
            then({"ok": False, "error": "not-known"})

    def promote(self, visitor: Visitor) -> None:
        """Keep a visitor that has proven the token when connections have to be dropped."""
        self._visitors.pop(visitor, None)
        self._trusted.pop(visitor, None)
        self._trusted[visitor] = None

    def drop(self, visitor: Visitor) -> None:
        """Close a visitor's connection."""
        self._visitors.pop(visitor, None)
        self._trusted.pop(visitor, None)
        with suppress(KeyError, ValueError):
            self._selector.unregister(visitor.socket)
        visitor.socket.close()

    def _stop_if_moving(self, then: Callable[[dict[str, Any]], None]) -> None:
        def decide(moving: bool) -> None:
            if moving:
                self._wait_for(Stop(self._targets, then))
            else:
                then({"ok": True, "moving": False, "stopped": [], "failed": []})

        links = [link for target in self._targets for link in target.reach(now=True)]
        self._wait_for(Inquiry(links, decide))

    def _state(self) -> dict[str, Any]:
        active = [one for one in self._targets if any(link.up for link in one.links)]
        lost = [one.name for one in self._targets if one not in active and one.reach()]
        moving = [one.name for one in self._targets if one.moves]
        return {"ok": True, "active": [one.name for one in active], "moving": moving, "lost": lost}

    def _wait_for(self, one: Stop | Inquiry) -> None:
        if not one.ended:
            self._pending.append(one)

    def _turn(self) -> None:
        events = self._selector.select(self._timeout_s())
        for key, mask in events:  # what may be a stop before who is new
            if key.data is not None:
                key.data.on_event(mask)
        if any(key.data is None for key, _ in events):
            self._accept()
        self._keep_time()

    def _timeout_s(self) -> float:
        due_s = min((one.due_s for one in self._pending), default=float("inf"))
        return max(0.0, min(AGAIN_S, due_s - time.monotonic()))

    def _hear_server(self) -> None:
        while os.read(0, MAX_REQUEST):
            pass
        self._server_gone = True
        # Whoever waits for the end of what the studio says must not wait for this process.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)

    def _keep_time(self) -> None:
        now_s = time.monotonic()
        for one in [one for one in self._pending if not one.ended and now_s > one.due_s]:
            one.expire()
        self._pending = [one for one in self._pending if not one.ended]
        for visitor in self._late(now_s):
            self.drop(visitor)
        reached = [one for target in self._targets for one in target.reach()]
        if reached:
            self._alone_s = now_s

    def _late(self, now_s: float) -> list[Visitor]:
        return [one for group in (self._visitors, self._trusted) for one in group if now_s > one.due_s]

    def _accept(self) -> None:
        for connection in self._newcomers():
            while len(self._visitors) + len(self._trusted) >= MAX_CONNECTIONS:
                self.drop(next(iter(self._visitors or self._trusted)))
            visitor = Visitor(connection, self)
            self._visitors[visitor] = None
            self._selector.register(connection, selectors.EVENT_READ, visitor)
            visitor.on_event(selectors.EVENT_READ)  # a request that came with it is not waited for

    def _newcomers(self) -> Iterator[socket.socket]:
        for _ in range(ACCEPTS):
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            yield connection


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=4096)
    except OSError:
        return socket.create_server((host, 0), family=family, backlog=4096)


def main() -> None:
    """Read the configuration, say the port, and listen."""
    for name in ("SIGINT", "SIGHUP"):  # of the terminal: the page server decides what they mean
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    line = bytearray()
    while not line.endswith(b"\n"):
        line += os.read(0, 1) or b"\n"
    listener = StopLoop(json.loads(line))
    print(json.dumps({"port": listener.port}), flush=True)
    sys.stdout.close()
    listener.run()


if __name__ == "__main__":
    main()
