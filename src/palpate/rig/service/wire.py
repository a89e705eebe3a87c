"""The language of the socket: one JSON object a line, of bounded length, in both directions.

A request is ``{"id": 7, "do": "pause"}``; its reply carries the same id, ``"ok"``, and what came of it or
``"error"`` and ``"kind"``. What is pushed carries ``"push"`` instead of an id. Whoever connects says
``{"token": ...}`` first.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from palpate.core.errors import ProtocolError

ASKED_BYTES = 256 * 1024
"""Longest line that a service reads: a plan of many thousand places by hand."""
SAID_BYTES = 16 * 1024 * 1024
"""Longest line that a client reads: a large picture."""


def encode(message: Mapping[str, Any]) -> bytes:
    """A message as a line.

    Raises:
        ValueError: a number in it is not finite.
    """
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def decode(line: bytes) -> dict[str, Any]:
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
        self._held = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[bytes | None]:
        """Each line that is whole now, without its end; None for one that was too long."""
        for i, part in enumerate(data.split(b"\n")):
            if i:
                yield self._ended()
            if not self._skipping:
                self._held += part
                if len(self._held) > self._most:
                    self._held.clear()
                    self._skipping = True

    def _ended(self) -> bytes | None:
        if self._skipping:
            self._skipping = False
            return None
        line = bytes(self._held)
        self._held.clear()
        return line
