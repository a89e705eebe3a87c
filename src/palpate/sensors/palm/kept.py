"""Pictures that are marched once: a cache bound by bytes, for presets differ a hundredfold in size."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import ParamSpec, Protocol, TypeVar, runtime_checkable

from cachetools import LRUCache, cached


@runtime_checkable
class Sized(Protocol):
    """What says how much memory it takes."""

    @property
    def nbytes(self) -> int:
        """Bytes."""
        ...


P = ParamSpec("P")
T = TypeVar("T", bound=Sized)


def kept(most_bytes: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Keep what a function returned, the least recently used going first; arguments must be hashable.

    What takes more than the bound by itself displaces all others and is kept alone.
    """

    def size(made: Sized) -> int:
        return min(made.nbytes, most_bytes)

    return cached(LRUCache(most_bytes, getsizeof=size), lock=threading.Lock())
