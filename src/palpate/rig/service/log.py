"""What happened, in the order it did, for whoever opens the page later."""

from __future__ import annotations

import threading
from collections import deque
from datetime import UTC, datetime
from typing import Literal

KEPT = 500
Kind = Literal["rig", "operator", "place", "fault"]


class Log:
    """The last few hundred things."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lines: deque[dict[str, str]] = deque(maxlen=KEPT)
        self.count = 0

    def add(self, kind: Kind, text: str) -> None:
        """It happened now."""
        at = datetime.now(UTC).isoformat(timespec="milliseconds")
        with self._lock:
            self._lines.append({"utc": at, "kind": kind, "text": text[:500]})
            self.count += 1

    def tail(self, lines: int) -> list[dict[str, str]]:
        """The newest, oldest first."""
        with self._lock:
            return list(self._lines)[-lines:]
