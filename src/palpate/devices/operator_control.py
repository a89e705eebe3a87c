"""Commands of the operator, from any thread: pause, go on, stop after this press, abort, emergency stop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from enum import StrEnum


class OperatorCommand(StrEnum):
    """A command that interrupts; a later one is stronger."""

    PAUSE = "pause"  # lift the probe, and wait to be resumed
    STOP = "stop"  # end after this press
    ABORT = "abort"  # stop moving at once, lift the probe, end
    ESTOP = "estop"  # stop moving at once, end; nothing moves any more


AT_ONCE = (OperatorCommand.PAUSE, OperatorCommand.ABORT, OperatorCommand.ESTOP)
_RANK = {command: rank for rank, command in enumerate(OperatorCommand)}  # the strongest last


class OperatorInterrupt(Exception):  # noqa: N818 - a command, not an error; it never leaves the engine
    """Raised where a command interrupts what was going on."""

    def __init__(self, command: OperatorCommand) -> None:
        super().__init__(command.value)
        self.command = command


class OperatorControl:
    """Passes the operator's commands to whoever moves; a stronger one replaces a weaker one."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._command: OperatorCommand | None = None
        self._listener: Callable[[OperatorCommand | None], None] | None = None

    def listen(self, listener: Callable[[OperatorCommand | None], None] | None) -> None:
        """Tell somebody of every change at once, in the thread or signal handler that asks; None for nobody.

        It must not wait. What is asked for already is told now.
        """
        self._listener = listener
        if listener is not None and self._command is not None:
            listener(self._command)

    def ask(self, command: OperatorCommand) -> None:
        """Ask for something; an emergency stop cannot be taken back."""
        with self._changed:
            if self._command is None or _RANK[command] >= _RANK[self._command]:
                self._command = command
            self._changed.notify_all()
        self._tell(command)

    def resume(self) -> None:
        """Take back a pause; nothing else can be."""
        with self._changed:
            if self._command is OperatorCommand.PAUSE:
                self._command = None
            self._changed.notify_all()
        self._tell(None)

    def _tell(self, command: OperatorCommand | None) -> None:
        if self._listener is not None:
            self._listener(command)

    @property
    def command(self) -> OperatorCommand | None:
        """The command that is asked for now."""
        return self._command

    def check(self, asks: tuple[OperatorCommand, ...] = AT_ONCE) -> None:
        """Raise `OperatorInterrupt` where one of these is asked for."""
        if self._command in asks:
            raise OperatorInterrupt(self._command)

    def wait_while_paused(self, seconds: float) -> bool:
        """Wait so long at most; whether the pause still holds."""
        with self._changed:
            return not self._changed.wait_for(lambda: self._command is not OperatorCommand.PAUSE, seconds)
