"""Limits of the page server: connections, half-open requests, clients that never read, page builds."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from typing import TYPE_CHECKING, Any, ClassVar

from nicegui import Client
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

if TYPE_CHECKING:
    from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol as Http
else:
    from uvicorn.protocols.http.auto import AutoHTTPProtocol as Http

MAX_CONNECTIONS = 256
"""Connections, sockets of pages included. Beyond it, the oldest that waits for a request is closed."""
BACKLOG = 256
REQUEST_S = 10.0
"""Time within which a request is complete, headers and body [s]."""
WRITE_S = 10.0
"""Time within which a client reads `WRITE_BYTES` of what is sent to it [s]."""
WRITE_BYTES = 8192
MAX_PIPELINED = 8
"""Requests of one connection that wait for the answer to another."""
MAX_PAGES = 12
"""Pages that are made, or wait to be made, at the same time; further requests receive status 503."""
MAX_UNJOINED = 32
"""Pages that were sent and have not opened their socket; beyond it, the oldest is forgotten."""


class LimitedHttp(Http):
    """HTTP connection with limits in time and in number.

    Attributes:
        waiting: connections of the server that wait for a request, the oldest first; see `limited_http`.
    """

    waiting: ClassVar[dict[LimitedHttp, None]]

    def connection_made(self, transport: Any) -> None:
        """Accept a connection, in place of the oldest that waits for a request if there are too many."""
        super().connection_made(transport)
        self._cycles: list[Any] = []  # requests without a complete answer
        self._late: asyncio.TimerHandle | None = None
        self._stuck: asyncio.TimerHandle | None = None
        while len(self.connections) > MAX_CONNECTIONS:
            oldest = next(iter(self.waiting), self)
            oldest.abort()
            oldest.connections.discard(oldest)
        self._note_waiting()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._end_waiting()
        self._end_writing()
        self._disconnect()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take in data; a request that it leaves incomplete has to end in time."""
        super().data_received(data)
        if self.transport.is_closing() or self.transport.get_protocol() is not self:
            self._end_waiting()
        elif self.cycle is None or self.cycle.response_complete or self.cycle.more_body:
            self._note_waiting()
        else:
            self._end_waiting()

    def on_response_complete(self) -> None:
        """Keep a connection whose request was answered as the first to go."""
        super().on_response_complete()
        if not self.transport.is_closing() and not getattr(self, "pipeline", ()):
            self.waiting[self] = None

    def on_headers_complete(self) -> None:
        """Begin a request, unless too many of this connection wait."""
        if self.transport.is_closing():
            return
        super().on_headers_complete()
        asked = (*self._cycles, self.cycle)  # none for an upgrade to a socket
        self._cycles = [one for one in asked if one is not None and not one.response_complete]
        if len(getattr(self, "pipeline", ())) > MAX_PIPELINED:
            self.abort()

    def pause_writing(self) -> None:
        """Begin to wait for a client that does not read."""
        super().pause_writing()
        self._check_writing(self.transport.get_write_buffer_size() + WRITE_BYTES)

    def resume_writing(self) -> None:
        """The client has read."""
        super().resume_writing()
        self._end_writing()

    def abort(self) -> None:
        """Close the connection at once; what is being answered is told that the client has gone."""
        self._end_waiting()
        self._disconnect()
        super().resume_writing()
        self.transport.abort()

    def _disconnect(self) -> None:
        """Let all requests know that the client has gone; uvicorn tells only the last of a pipeline."""
        for one in self._cycles:
            one.disconnected = True
            one.message_event.set()

    def _note_waiting(self) -> None:
        if self._late is None and not self.transport.is_closing():
            self.waiting[self] = None
            self._late = self.loop.call_later(REQUEST_S, self.abort)

    def _end_waiting(self) -> None:
        self.waiting.pop(self, None)
        if self._late is not None:
            self._late.cancel()
            self._late = None

    def _check_writing(self, before: int) -> None:
        left = self.transport.get_write_buffer_size()
        if left > before - WRITE_BYTES:
            self.abort()
        else:
            self._stuck = self.loop.call_later(WRITE_S, self._check_writing, left)

    def _end_writing(self) -> None:
        if self._stuck is not None:
            self._stuck.cancel()
            self._stuck = None


def limited_http() -> type[LimitedHttp]:
    """Return the protocol of one server, with connections of its own to count."""

    class OwnHttp(LimitedHttp):
        waiting: ClassVar[dict[LimitedHttp, None]] = {}

    return OwnHttp


class PageQueue:
    """Layer that limits how many pages are made at the same time."""

    def __init__(self, app: ASGIApp, paths: Collection[str]) -> None:
        self._app, self._paths, self._count = app, frozenset(paths), 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Make a page, or answer that too many are being made."""
        if scope["type"] != "http" or scope["path"] not in self._paths:
            await self._app(scope, receive, send)
            return
        if self._count >= MAX_PAGES:
            again = {"Retry-After": "1"}
            refused = PlainTextResponse("Too many pages are loading. Reload in a moment.", 503, again)
            await refused(scope, receive, send)
            return
        self._count += 1
        try:
            forget_unjoined()
            await self._app(scope, receive, send)
        finally:
            self._count -= 1


def forget_unjoined(most: int = MAX_UNJOINED) -> None:
    """Delete the oldest pages that never opened their socket, beyond a number."""
    unjoined = sorted(
        (one for one in Client.instances.values() if one.environ is None),
        key=lambda one: one.created,
    )
    for client in unjoined[: max(len(unjoined) - most, 0)]:
        client.delete()
