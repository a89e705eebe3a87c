"""A programme that is told to end still stops its devices."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def ends_in_order() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the programme as Ctrl-C does: through every `with` on the way out.

    By default they end it at once, and a stage goes on moving. For the main thread of a programme; put it
    around the `with` of the stage.

    Raises:
        SystemExit: within, when such a signal came; its code is 128 and the signal's number.
    """

    def leave(number: int, _: FrameType | None) -> None:
        raise SystemExit(128 + number)

    wanted = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.signal(number, leave) for number in wanted}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
