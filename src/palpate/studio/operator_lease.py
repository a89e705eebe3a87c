"""Lease of the rig: one operator at a time moves it; everybody else watches, and may stop it in an emergency.

An operator is a browser, known by a cookie: two of its tabs are one. Whoever acts first holds the rig, until
they let go, close their last tab, or have done nothing for long while nothing is recorded.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from palpate.core import SafetyError
from palpate.studio.page_security import cookies_of

COOKIE = "palpate-operator"
MAX_SILENT_S = 15.0
"""From when on an operator counts as gone whose tabs are all closed or cannot be reached [s]."""
MAX_IDLE_S = 600.0
"""From when on one counts as gone who has asked for nothing, unless something is recorded [s]."""


@dataclass(frozen=True, slots=True)
class Operator:
    """Browser that may hold the rig.

    Attributes:
        where: the address it asks from, for others to be told.
    """

    key: str
    where: str = "this machine"


class RigLease:
    """Lease of the rig among the browsers of one server.

    Args:
        now_s: monotonic time [s].
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s, self._turn = now_s, threading.Lock()
        self._holder: Operator | None = None
        self._seen_s = self._acted_s = 0.0

    def take(self, operator: Operator) -> None:
        """Take the rig, or keep it: to be called before each thing that is asked of it."""
        with self._turn:
            holder = self._current()
            if holder is not None and holder.key != operator.key:
                raise SafetyError(
                    f"the rig is held by another browser, at {holder.where}; it can be taken once that lets "
                    f"go or is closed for {MAX_SILENT_S:g} s. The emergency stop works for everybody",
                    code="rig-held",
                )
            self._holder = operator
            self._seen_s = self._acted_s = self._now_s()

    def see(self, operator: Operator, *, recording: bool) -> None:
        """Note that one of an operator's tabs is there; while something is recorded, that is an act."""
        with self._turn:
            holder = self._current()
            if holder is not None and holder.key == operator.key:
                self._seen_s = self._now_s()
                self._acted_s = self._seen_s if recording else self._acted_s

    def release(self, operator: Operator) -> None:
        """Let go of the rig; of no consequence where another holds it."""
        with self._turn:
            if self._holder is not None and self._holder.key == operator.key:
                self._holder = None

    def may_act(self, operator: Operator) -> bool:
        """True where the operator holds the rig, or nobody does."""
        holder = self.holder
        return holder is None or holder.key == operator.key

    def words(self, operator: Operator) -> str:
        """Who holds the rig, as one operator is told."""
        holder = self.holder
        if holder is None:
            return "Nobody holds the rig; who acts first does."
        if holder.key == operator.key:
            return "You hold the rig."
        return (
            f"Another browser holds the rig, at {holder.where}. You can watch, and stop it in an emergency."
        )

    @property
    def holder(self) -> Operator | None:
        """Who holds the rig now."""
        with self._turn:
            return self._current()

    def _current(self) -> Operator | None:
        now_s = self._now_s()
        if now_s - self._seen_s > MAX_SILENT_S or now_s - self._acted_s > MAX_IDLE_S:
            self._holder = None
        return self._holder


class OperatorCookie:
    """Layer around an application that gives each browser a cookie of its own.

    Args:
        app: what is served; it finds the cookie in the very first request as well.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, with a cookie where it had none."""
        if scope["type"] != "http" or COOKIE in cookies_of(scope):
            await self._app(scope, receive, send)
            return
        key = secrets.token_urlsafe(16)
        told = {**scope, "headers": [*scope["headers"], (b"cookie", f"{COOKIE}={key}".encode())]}

        async def with_cookie(message: Message) -> None:
            if message["type"] == "http.response.start":
                line = f"{COOKIE}={key}; Path=/; HttpOnly; SameSite=Strict".encode()
                message = {**message, "headers": [*message.get("headers", ()), (b"set-cookie", line)]}
            await send(message)

        await self._app(told, receive, with_cookie)


def operator_of(cookies: dict[str, str], where: str | None) -> Operator:
    """The operator of a request; one without a cookie is known to nobody, and shares with nobody."""
    return Operator(cookies.get(COOKIE) or secrets.token_urlsafe(16), where or "this machine")
