"""A bounded queue between those who record and the one thread that writes."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from threading import Condition
from typing import Literal

from palpate.core.shapes import Image
from palpate.recordings.schema import RECORDED, Channel

Overflow = Literal["drop", "wait"]

MAX_FRAME_BYTES = 32 << 20  # about half a second of encoding, so that what was accepted is soon on disk
MAX_SIGNALS = 1 << 16  # nine seconds of a 7 kHz force sensor


@dataclass(frozen=True, slots=True)
class Item:
    """What was recorded, and when [ns since 1970].

    Attributes:
        data: a message's bytes, or a frame's image.
        about: a frame's exposure and labels; None where it has neither.
    """

    channel: Channel
    time_ns: int
    data: bytes | Image
    about: dict[str, object] | None = None


class Buffer:
    """A first-in, first-out queue with room for so many frames, so many bytes of them, and so many signals.

    Signals have room of their own, so that a thousand force samples do not push out an image.
    """

    def __init__(self, frames: int, overflow: Overflow) -> None:
        self._items: deque[Item] = deque()
        self._changed = Condition()
        self._max_frames = frames
        self._overflow = overflow
        self._frames = 0
        self._frame_bytes = 0
        self._closed = False
        self.dropped: dict[str, int] = {channel.name: 0 for channel in RECORDED}

    def put(self, item: Item) -> bool:
        """Queue an item; False when there was no room and it was counted as dropped, or after closing."""
        with self._changed:
            if self._overflow == "wait":
                self._changed.wait_for(lambda: self._closed or self._has_room(item))
            if self._closed:
                return False
            if not self._has_room(item):
                self.dropped[item.channel.name] += 1
                return False
            self._items.append(item)
            self._count(item, 1)
            self._changed.notify_all()
            return True

    def take(self, timeout_s: float) -> Item | None:
        """The oldest item; None when none came in time [s] or none can come."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._items, timeout_s)
            if not self._items:
                return None
            item = self._items.popleft()
            self._count(item, -1)
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Let nothing in any more; what is inside can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def drained(self) -> bool:
        """Whether nothing is inside and nothing can come."""
        with self._changed:
            return self._closed and not self._items

    def _has_room(self, item: Item) -> bool:
        if isinstance(item.data, bytes):
            return len(self._items) - self._frames < MAX_SIGNALS
        fits = self._frame_bytes + item.data.nbytes <= MAX_FRAME_BYTES
        return self._frames < self._max_frames and (fits or self._frames == 0)

    def _count(self, item: Item, step: int) -> None:
        if not isinstance(item.data, bytes):
            self._frames += step
            self._frame_bytes += step * item.data.nbytes
