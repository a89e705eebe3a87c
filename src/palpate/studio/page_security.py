"""Security of the pages: nobody frames them, and nobody but they themselves asks for anything.

What listens on 127.0.0.1 is in reach of every page that is open in the operator's browser. Such a page can
show ours in a frame and have it clicked, open its socket, or post to it; one whose name is made to point here
is even of one origin with us. The browser says in each request which name it asked for (Host), for which page
it asks (Origin, Sec-Fetch-Site; no script can set them), and obeys what an answer says of frames. So one
layer around the whole application checks the first two, and adds the third to every answer, errors too.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

ESTOP_PATH = "/estop"
HEADERS = {
    "content-security-policy": (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; frame-ancestors 'none'; "
        "object-src 'none'; base-uri 'none'; form-action 'self'"
    ),
    "x-frame-options": "DENY",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}
"""Of every answer. Inline scripts and `eval` are how the pages are made; what comes from elsewhere is not."""

_HOST = r"(?:localhost|127\.0\.0\.1|\[::1\])(?::(?P<port>\d{1,5}))?"
HOST = re.compile(_HOST, re.IGNORECASE)
"""The names of this machine, which are one: a page's own name is equal to any of them, at its port."""
ORIGIN = re.compile(rf"(?P<scheme>https?)://{_HOST}", re.IGNORECASE)
PORTS = {"http": 80, "https": 443}
OTHER_SITES = ("cross-site", "same-site")  # the latter is another port of this machine

Headers = Iterable[tuple[bytes, bytes]]


class PageSecurity:
    """Layer around an application: checks who asks, and adds `HEADERS` to every answer.

    Args:
        app: what is served.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or open one socket."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        told = _Answer(scope, send)
        refused = refusal(scope)
        if refused is None:
            await self._app(scope, receive, told.send)
            await told.end()
        elif scope["type"] == "http":
            await PlainTextResponse(refused[1], refused[0])(scope, receive, told.send)
        else:
            await told.refuse(*refused)


def refusal(scope: Scope) -> tuple[int, str] | None:
    """Reason not to answer, with its HTTP status; None where nothing speaks against it.

    A request without Origin is a program's on this machine, or a browser's that reads: browsers name the page
    with every post and every socket (RFC 6455, 10.2).
    """
    if scope["type"] == "http" and scope["path"] == ESTOP_PATH:
        # A stop only makes safer, and none may be refused by mistake: for a header that an extension or a
        # forwarded port has changed. What other pages cannot do is send its own header, which its route asks
        # for, without being allowed to; one whose name points here can, and what it gets is a stop.
        return None
    hosts = _all(scope, b"host")
    host = HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
    if host is None:
        return 400, "ask at localhost or 127.0.0.1; this page has no other name"
    scheme = "https" if scope["scheme"] in ("https", "wss") else "http"
    own = (scheme, int(host["port"] or PORTS[scheme]))  # as it was asked at: a forwarded port is as good
    if any(_origin(one) != own for one in _all(scope, b"origin")):
        return 403, "asked for by a page from elsewhere; open this one at its own address"
    if _is_embedded(scope):
        return 403, "asked for from within another page; open this one in a tab of its own"
    return None


def _origin(text: str) -> tuple[str, int] | None:
    """Scheme and port of an origin on this machine; None of any other, and of one that is hidden."""
    found = ORIGIN.fullmatch(text)
    if found is None:
        return None
    scheme = found["scheme"].lower()
    return scheme, int(found["port"] or PORTS[scheme])


def _is_embedded(scope: Scope) -> bool:
    """Whether another site's page asks, unless it is a link that was followed in a tab."""
    if not set(_all(scope, b"sec-fetch-site")) & set(OTHER_SITES):
        return False
    followed = _all(scope, b"sec-fetch-mode") == ["navigate"] and _all(scope, b"sec-fetch-dest") == [
        "document"
    ]
    return not (followed and scope["type"] == "http" and scope["method"] in ("GET", "HEAD"))


def _all(scope: Scope, name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in scope["headers"] if key.lower() == name]


def _with_ours(headers: Headers) -> list[tuple[bytes, bytes]]:
    kept = [(key, value) for key, value in headers if key.decode("latin-1").lower() not in HEADERS]
    return kept + [(key.encode(), value.encode()) for key, value in HEADERS.items()]


class _Answer:
    """Passes an answer on with our headers; a socket that is turned away gets a whole answer of its own."""

    STARTS = ("http.response.start", "websocket.http.response.start", "websocket.accept")

    def __init__(self, scope: Scope, send: Send) -> None:
        self._send = send
        self._may_answer = "websocket.http.response" in (scope.get("extensions") or {})
        self._begun = scope["type"] == "http"

    async def send(self, message: Message) -> None:
        if message["type"] == "websocket.close" and not self._begun:
            await self.refuse(403, "this socket is not opened")
            return
        if message["type"] in self.STARTS:
            self._begun = True
            message = {**message, "headers": _with_ours(message.get("headers") or ())}
        await self._send(message)

    async def end(self) -> None:
        """Turn away a socket that the application has left unanswered, as at an address without one."""
        if not self._begun:
            await self.refuse(404, "there is no socket at this address")

    async def refuse(self, status: int, text: str) -> None:
        """Turn a socket away before it is opened."""
        self._begun = True
        if not self._may_answer:
            await self._send({"type": "websocket.close", "code": 1008, "reason": text})
            return
        headers = _with_ours([(b"content-type", b"text/plain; charset=utf-8")])
        await self._send({"type": "websocket.http.response.start", "status": status, "headers": headers})
        await self._send({"type": "websocket.http.response.body", "body": text.encode()})
