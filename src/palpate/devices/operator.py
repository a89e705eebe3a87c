"""What the operator asks for, from any thread: pause, go on, stop after this press, abort, emergency stop."""

from __future__ import annotations

import threading
from enum import StrEnum


class OperatorCommand(StrEnum):
    """A wish that interrupts."""

    PAUSE = "pause"  # lift the probe, and wait to be resumed
    STOP = "stop"  # end after this press
    ABORT = "abort"  # stop moving at once, lift the probe, end
    ESTOP = "estop"  # stop moving at once, end; nothing moves any more


AT_ONCE = (OperatorCommand.PAUSE, OperatorCommand.ABORT, OperatorCommand.ESTOP)
_RANK = {
    OperatorCommand.PAUSE: 0,
    OperatorCommand.STOP: 1,
    OperatorCommand.ABORT: 2,
    OperatorCommand.ESTOP: 3,
}


class OperatorInterrupt(Exception):  # noqa: N818 - a wish, not an error; it never leaves the engine
    """Raised where a wish interrupts what was going on."""

    def __init__(self, ask: OperatorCommand) -> None:
        super().__init__(ask.value)
        self.ask = ask


class OperatorControl:
    """Between the operator and the engine. A stronger wish replaces a weaker one, never the other way."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._ask: OperatorCommand | None = None

    def ask(self, wish: OperatorCommand) -> None:
        """Ask for something; an emergency stop cannot be taken back."""
        with self._changed:
            if self._ask is None or _RANK[wish] >= _RANK[self._ask]:
                self._ask = wish
            self._changed.notify_all()

    def resume(self) -> None:
        """Take back a pause; nothing else can be."""
        with self._changed:
            if self._ask is OperatorCommand.PAUSE:
                self._ask = None
            self._changed.notify_all()

    @property
    def asked(self) -> OperatorCommand | None:
        """What is asked for now."""
        return self._ask

    def check(self, asks: tuple[OperatorCommand, ...] = AT_ONCE) -> None:
        """Raise `OperatorInterrupt` where one of these is asked for."""
        if self._ask in asks:
            raise OperatorInterrupt(self._ask)

    def wait_while_paused(self, seconds: float) -> bool:
        """Wait so long at most; whether the pause still holds."""
        with self._changed:
            return not self._changed.wait_for(lambda: self._ask is not OperatorCommand.PAUSE, seconds)
