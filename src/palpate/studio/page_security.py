"""Security of the pages: no framing, and requests only from the pages themselves.

Every page open in the operator's browser can reach 127.0.0.1: it could frame these pages, open their socket,
post to it, or point its own name here (DNS rebinding). One layer around the application therefore checks
Host, Origin, and Sec-Fetch-Site of each request and forbids frames in every answer, including errors.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
import socket
from collections.abc import Callable, Iterable, Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode

from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse
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

POLICY = b"content-security-policy"
_HOST = r"(?P<name>\[[0-9a-f:.]+\]|[a-z0-9](?:[a-z0-9.-]*[a-z0-9])?)(?::(?P<port>\d{1,5}))?"
HOST = re.compile(_HOST, re.IGNORECASE)
ORIGIN = re.compile(rf"(?P<scheme>https?)://{_HOST}", re.IGNORECASE)
LOCAL = ("localhost", "127.0.0.1", "[::1]")
"""The names of this machine, which are one: a page's own name is equal to any of them, at its port."""
EVERY_ADDRESS = ("0.0.0.0", "::")  # noqa: S104 - compared with, not bound to
PORTS = {"http": 80, "https": 443}
OTHER_SITES = ("cross-site", "same-site")  # the latter is another port of this machine

Headers = Iterable[tuple[bytes, bytes]]


class PageSecurity:
    """Layer around an application: checks who asks, and adds `HEADERS` to every answer.

    Args:
        stop_port: of the emergency stop listener, which pages may send requests to; 0 for none.
    """

    def __init__(
        self, app: ASGIApp, names: Callable[[str], bool] = LOCAL.__contains__, stop_port: int = 0
    ) -> None:
        self._app, self._names, self._stop_port = app, names, stop_port

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or open one socket."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        told = _Answer(scope, send, self._stop_port)
        refused = refusal(scope, self._names)
        if refused is None:
            await self._app(scope, receive, told.send)
            await told.end()
        elif scope["type"] == "http":
            await PlainTextResponse(refused[1], refused[0])(scope, receive, told.send)
        else:
            await told.refuse(*refused)


def names_of_server(host: str) -> Callable[[str], bool]:
    """Return the names by which a server at an address may be requested.

    For all addresses (0.0.0.0): any numeric address and this machine's own name, so a foreign name that
    resolves to this machine is rejected.
    """
    bound = host.strip("[]").lower()
    if bound not in EVERY_ADDRESS:
        return {*LOCAL, f"[{bound}]" if ":" in bound else bound}.__contains__
    own = socket.gethostname().lower()
    machine = {*LOCAL, own, f"{own}.local", socket.getfqdn().lower()}

    def holds(name: str) -> bool:
        try:
            return name in machine or bool(ipaddress.ip_address(name.strip("[]")))
        except ValueError:
            return False

    return holds


def refusal(scope: Scope, names: Callable[[str], bool] = LOCAL.__contains__) -> tuple[int, str] | None:
    """Return the HTTP status and reason of a rejection; None for an accepted request.

    A request without Origin comes from a local program or a browser's read: browsers send it with every post
    and socket (RFC 6455, 10.2).
    """
    if scope["type"] == "http" and scope["path"] == ESTOP_PATH:
        # A stop only makes safer, and none may be refused by mistake: for a header that an extension or a
        # forwarded port has changed. What other pages cannot do is send its own header, which its route asks
        # for, without being allowed to; one whose name points here can, and what it gets is a stop.
        return None
    hosts = _all(scope, b"host")
    host = HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
    if host is None or not names(host["name"].lower()):
        return 400, "ask at the address that `palpate studio` printed; this page has no other name"
    scheme = "https" if scope["scheme"] in ("https", "wss") else "http"
    # As it was asked at: a forwarded port is as good.
    own = (scheme, _one_name(host["name"]), int(host["port"] or PORTS[scheme]))
    if any(_origin(one) != own for one in _all(scope, b"origin")):
        return 403, "asked for by a page from elsewhere; open this one at its own address"
    if _is_embedded(scope):
        return 403, "asked for from within another page; open this one in a tab of its own"
    return None


def _origin(text: str) -> tuple[str, str, int] | None:
    """Scheme, name and port of an origin; None of one that is hidden."""
    found = ORIGIN.fullmatch(text)
    if found is None:
        return None
    scheme = found["scheme"].lower()
    return scheme, _one_name(found["name"]), int(found["port"] or PORTS[scheme])


def _one_name(name: str) -> str:
    return LOCAL[0] if name.lower() in LOCAL else name.lower()


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


def _headers_for(scope: Scope, stop_port: int) -> Mapping[str, str]:
    """Headers of an answer: a page may also send requests to the emergency stop listener of this machine."""
    hosts = _all(scope, b"host")
    host = HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
    if not stop_port or host is None:
        return HEADERS
    policy = f"{HEADERS['content-security-policy']}; connect-src 'self' http://{host['name']}:{stop_port}"
    return {**HEADERS, "content-security-policy": policy}


def _with_ours(headers: Headers, ours: Mapping[str, str] = HEADERS) -> list[tuple[bytes, bytes]]:
    """Headers with ours in place of others of their name; a policy of its own counts beside ours."""
    kept = [
        (key, value)
        for key, value in headers
        if key.decode("latin-1").lower() not in HEADERS or key.lower() == POLICY
    ]
    return kept + [(key.encode(), value.encode()) for key, value in ours.items()]


def cookies_of(scope: Scope) -> dict[str, str]:
    """The cookies that a request carries; none where they cannot be read."""
    try:
        jar = SimpleCookie("; ".join(_all(scope, b"cookie")))
    except CookieError:
        return {}
    return {name: one.value for name, one in jar.items()}


REFUSED_PAGE = """<!doctype html><html lang="en"><title>Token required · palpate</title>
<body style="font: 16px/1.5 system-ui, sans-serif; max-width: 36em; margin: 4em auto; padding: 0 1em">
<h1>Token required</h1><p>This address needs the token of the studio. Open the address with
<code>token=…</code> in it, which <code>palpate studio</code> or <code>palpate start</code> printed in its
terminal.</p><p>If the terminal is closed, end that command and start it again for a new address.</p>"""
"""Answer to a request without the token."""


class TokenGate:
    """Layer inside `PageSecurity` that requires a token everywhere, including the emergency stop and sockets.

    A page opened with ``?token=...`` receives it as an HttpOnly, same-site cookie and is redirected to the
    address without it. Programs may send ``Authorization: Bearer ...``.

    Args:
        port: Port of the server, part of the cookie's name because browsers keep cookies by machine only.
    """

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self._app, self._token, self._cookie = app, token, f"palpate-token-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer who has the token, and tell everybody else where it is to be had."""
        if scope["type"] not in ("http", "websocket") or self._has_token(scope):
            if scope["type"] == "http" and b"token=" in scope["query_string"]:
                await self._enter(scope, receive, send)
                return
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": "no token"})
        else:
            await self._enter(scope, receive, send)

    async def _enter(self, scope: Scope, receive: Receive, send: Send) -> None:
        asked = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        given = [value for name, value in asked if name == "token"]
        if scope["method"] != "GET" or len(given) != 1 or not self._is_right(given[0]):
            await HTMLResponse(REFUSED_PAGE, 401)(scope, receive, send)
            return
        rest = urlencode([(name, value) for name, value in asked if name != "token"])
        path = "/" + scope["path"].lstrip("/\\")  # and never another machine's
        answer = RedirectResponse(f"{path}?{rest}" if rest else path, 303)
        answer.set_cookie(self._cookie, self._token, httponly=True, samesite="strict")
        await answer(scope, receive, send)

    def _has_token(self, scope: Scope) -> bool:
        bearer = [one.removeprefix("Bearer ") for one in _all(scope, b"authorization")]
        return any(map(self._is_right, [cookies_of(scope).get(self._cookie, ""), *bearer]))

    def _is_right(self, given: str) -> bool:
        return hmac.compare_digest(given.encode("utf-8", "replace"), self._token.encode())


class _Answer:
    """Passes an answer on with our headers; a socket that is turned away gets a whole answer of its own."""

    STARTS = ("http.response.start", "websocket.http.response.start", "websocket.accept")

    def __init__(self, scope: Scope, send: Send, stop_port: int) -> None:
        self._send = send
        self._headers = _headers_for(scope, stop_port)
        self._may_answer = "websocket.http.response" in (scope.get("extensions") or {})
        self._begun = scope["type"] == "http"

    async def send(self, message: Message) -> None:
        if message["type"] == "websocket.close" and not self._begun:
            await self.refuse(403, "this socket is not opened")
            return
        if message["type"] in self.STARTS:
            self._begun = True
            message = {**message, "headers": _with_ours(message.get("headers") or (), self._headers)}
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
        headers = _with_ours([(b"content-type", b"text/plain; charset=utf-8")], self._headers)
        await self._send({"type": "websocket.http.response.start", "status": status, "headers": headers})
        await self._send({"type": "websocket.http.response.body", "body": text.encode()})
