"""Bounded history that several threads append to and read."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

T = TypeVar("T")


class SharedHistory(Generic[T]):
    """First-in, first-out history with a lock; readers receive copies and never iterate the container.

    A collections.deque that one thread changes while another iterates raises RuntimeError.

    Args:
        max_length: Greatest number of items; the oldest are discarded. None for no limit.

    Example:
        >>> history = SharedHistory[int](max_length=3)
        >>> history.extend([1, 2, 3, 4])
        >>> history.items()
        [2, 3, 4]
        >>> history.discard_while(lambda item: item < 3)
        >>> history.items(), history.newest
        ([3, 4], 4)
    """

    def __init__(self, max_length: int | None = None) -> None:
        self._lock = threading.Lock()
        self._items: deque[T] = deque(maxlen=max_length)

    def append(self, item: T) -> None:
        """Append an item."""
        self.extend((item,))

    def extend(self, items: Iterable[T]) -> None:
        """Append several items."""
        added = list(items)  # evaluated before the lock is taken
        with self._lock:
            self._items.extend(added)

    def clear(self) -> None:
        """Remove all items."""
        with self._lock:
            self._items.clear()

    def discard_while(self, is_old: Callable[[T], bool]) -> None:
        """Remove the oldest items as long as the condition holds for the oldest one."""
        with self._lock:
            while self._items and is_old(self._items[0]):
                self._items.popleft()

    def items(self) -> list[T]:
        """Return a copy of all items, oldest first."""
        with self._lock:
            return list(self._items)

    @property
    def newest(self) -> T | None:
        """Newest item; None if there is none."""
        with self._lock:
            return self._items[-1] if self._items else None
