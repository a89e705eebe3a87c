"""What waits to be sent to one client: every reply, and of what is pushed the newest of each kind."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from socket import socket
from typing import Any

from palpate.rig.service.wire import encode

MOST_REPLIES = 1000  # that a client may leave unread


class Outbox:
    """Sends from a thread of its own, so that a client that does not read holds nobody up."""

    def __init__(self, to: socket, give_up: Callable[[], None]) -> None:
        self._socket = to
        self._give_up = give_up
        self._changed = threading.Condition()
        self._replies: deque[bytes] = deque()
        self._pushes: dict[str, bytes] = {}
        self._closed = False
        self.pictured = False
        threading.Thread(target=self._send, name="palpate-rig-outbox", daemon=True).start()

    def reply(self, message: Mapping[str, Any]) -> None:
        """To be sent in order; a client that lets too many lie is dropped."""
        line = encode(message)
        with self._changed:
            self._replies.append(line)
            full = len(self._replies) > MOST_REPLIES
            self._changed.notify()
        if full:
            self._give_up()

    def push(self, kind: str, line: bytes) -> None:
        """In place of the last of its kind, if that still waits."""
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
            while (line := self._next()) is not None:
                try:
                    self._socket.sendall(line)
                except OSError:
                    return self._give_up()
            return self._give_up()

    def _next(self) -> bytes | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._replies or self._pushes)
            if self._replies:
                return self._replies.popleft()
            if self._closed:
                return None
            return self._pushes.pop(next(iter(self._pushes)))
