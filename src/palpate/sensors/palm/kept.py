"""Pictures that are marched once: a cache bound by bytes, for presets differ a hundredfold in size."""

from __future__ import annotations

import functools
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import ParamSpec, Protocol, TypeVar, runtime_checkable


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
    """Keep what a function returned, the least recently used going first; arguments must be hashable."""

    def keeping(make: Callable[P, T]) -> Callable[P, T]:
        held: OrderedDict[Hashable, T] = OrderedDict()
        lock = threading.Lock()

        @functools.wraps(make)
        def wrapped(*args: P.args, **kwargs: P.kwargs) -> T:
            key = (args, tuple(kwargs.items()))
            with lock:
                if key in held:
                    held.move_to_end(key)
                    return held[key]
            made = make(*args, **kwargs)
            with lock:
                held[key] = made
                while len(held) > 1 and sum(one.nbytes for one in held.values()) > most_bytes:
                    held.popitem(last=False)
            return made

        return wrapped

    return keeping
