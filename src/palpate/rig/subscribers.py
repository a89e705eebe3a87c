"""Callbacks that hear what passes: several at once, in a stated order, and none of their failures is lost."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, ParamSpec

P = ParamSpec("P")


class Subscribers(Generic[P]):
    """Callbacks for one kind of event, called in the order in which they subscribed.

    Example:
        >>> force: Subscribers[[float]] = Subscribers()
        >>> force.subscribe(lambda newtons: print("recorded", newtons))
        >>> with force.subscribed(lambda newtons: print("plotted", newtons)):
        ...     force.publish(1.5)
        recorded 1.5
        plotted 1.5
        >>> force.publish(2.0)
        recorded 2.0
    """

    def __init__(self) -> None:
        self._callbacks: list[Callable[P, None]] = []

    def subscribe(self, callback: Callable[P, None]) -> None:
        """Call it at each event from now on, after those that subscribed before."""
        self._callbacks.append(callback)

    def unsubscribe(self, callback: Callable[P, None]) -> None:
        """Call it no more.

        Raises:
            ValueError: it has not subscribed.
        """
        self._callbacks.remove(callback)

    @contextmanager
    def subscribed(self, callback: Callable[P, None]) -> Iterator[None]:
        """Call it at each event within a ``with`` block, and then no more, however the block ends."""
        self.subscribe(callback)
        try:
            yield
        finally:
            self.unsubscribe(callback)

    def publish(self, *args: P.args, **kwargs: P.kwargs) -> None:
        """Call all of them, also where one raises.

        Raises:
            Exception: the first that a callback raised; the others are noted on it.
        """
        errors: list[Exception] = []
        for callback in tuple(self._callbacks):
            try:
                callback(*args, **kwargs)
            except Exception as e:
                errors.append(e)
        if errors:
            for other in errors[1:]:
                errors[0].add_note(f"another subscriber raised {type(other).__name__}: {other}")
            raise errors[0]
