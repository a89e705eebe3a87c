"""Client's end of a process that owns devices: its start, its two pipes, what it answers and what it tells.

Such a process outlives no client: where the pipes end it makes its devices safe. What is said where it dies
or hangs depends on what it owns, and is given.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from palpate.core import Closing, DeviceError, PalpateError
from palpate.devices.operator_control import OperatorCommand
from palpate.devices.rpc import encode_message
from palpate.devices.supervisor.guard_messages import error_of, read_messages, write_line

ANSWER_S = 60.0  # beyond what a slow stage may take to come to a stand
END_S = 60.0  # in which the process has made its devices safe and let go of them
OPEN_S = 900.0  # in which it has opened them: homing may take minutes
PROBE_S = 1.0  # of silence, after which it is asked whether it is there: its reader answers past any device
SILENT_S = 5.0  # of silence, after which the process hangs
HURRIED_S = 1.0  # instead, once an emergency stop was asked for
LEAVE_S = 1.0  # in which a process that hung lets go

Message = Mapping[str, Any]


class ProcessGoneError(DeviceError):
    """The process is gone, or silent."""


@dataclass(frozen=True, slots=True)
class GoneWords:
    """What a person is told where a process fails them.

    Attributes:
        gone: it has died.
        silent: it hangs.
        unfinished: it does not let go of its devices, followed by "in 5 s".
    """

    gone: str
    silent: str
    unfinished: str


class ProcessLink(Closing):
    """Link to a process that owns devices, which ends with it.

    Args:
        words: what the Python interpreter is called with, such as ("-m", "a.module").
        opens: the first message: what the process opens.
        told: what is said where it dies or hangs.

    Attributes:
        facts: what the process said of its devices.

    Raises:
        PalpateError: as the process raised it when it opened the devices.
    """

    def __init__(self, words: Sequence[str], opens: Message, told: GoneWords) -> None:
        self._told = told
        self._process = subprocess.Popen(  # noqa: S603 - our own module, by our own interpreter
            [sys.executable, *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # a terminal's Ctrl-C goes to the client, which says what is wished
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},  # its drivers too
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin.fileno(), self._process.stdout.fileno()
        self._numbers = itertools.count(1)
        self._waiting: dict[int, SimpleQueue[Message | None]] = {}
        self._events: SimpleQueue[Message | None] = SimpleQueue()
        self.gone = self._silent = False
        self._heard_s = self._probed_s = time.monotonic()
        self._patience_s = SILENT_S
        self._opened: SimpleQueue[Message | None] = SimpleQueue()
        self._reader = threading.Thread(target=self._read, name="palpate-process-reader", daemon=True)
        self._reader.start()
        try:
            _write_whole(self._to, encode_message(opens))
            self.facts = self.result_of(self._opened.get(timeout=OPEN_S))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let the process make its devices safe, let go of them and end."""
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(OSError):
            process.stdin.close()
        within_s = LEAVE_S if self._silent else END_S
        try:
            process.wait(within_s)
        except subprocess.TimeoutExpired:
            process.terminate()  # it makes its devices safe, where it ever wakes
            threading.Thread(target=self._bury, name="palpate-process-end", daemon=True).start()
            message = f"{self._told.unfinished} in {within_s:g} s; use the switch"
            raise DeviceError(message, code="process-not-ended") from None
        self._bury()

    def _bury(self) -> None:
        self._process.wait()
        self._reader.join(END_S)  # its pipe has ended with the process
        assert self._process.stdout is not None
        self._process.stdout.close()

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid

    def tell(self, do: str, **fields: Any) -> None:
        """Say something that has no answer; from any thread, also from a signal's handler.

        That it is gone is told by whatever waits for it.
        """
        if fields.get("command") == OperatorCommand.ESTOP:
            self._patience_s = HURRIED_S
        with suppress(OSError, ValueError):
            write_line(self._to, {"do": do, **fields})

    def order(self, do: str, **fields: Any) -> int:
        """Order something whose reply, of the number returned, comes among the events."""
        number = next(self._numbers)
        self._write({"id": number, "do": do, **fields})
        return number

    def next_event(self, timeout_s: float) -> Message:
        """The next that it tells: a look, or the reply to an order."""
        event = self._wait(self._events, timeout_s)
        if event is None:
            self._events.put(None)
            raise ProcessGoneError(self._told.gone)
        return event

    def ask(self, do: str, **fields: Any) -> Any:
        """Order something, from any thread, and wait for what comes of it."""
        number, answer = next(self._numbers), SimpleQueue[Message | None]()
        self._waiting[number] = answer
        try:
            self._write({"id": number, "do": do, **fields})
            return self.result_of(None if self.gone and answer.empty() else self._wait(answer, ANSWER_S))
        finally:
            self._waiting.pop(number, None)

    def _wait(self, queue: SimpleQueue[Message | None], timeout_s: float) -> Message | None:
        """The next of a queue, as long as the process is heard at all; a device of it may be slow."""
        begun_s = time.monotonic()
        while not self._silent:
            with suppress(Empty):
                return queue.get(timeout=PROBE_S / 4)
            now_s = time.monotonic()
            if now_s - max(self._heard_s, self._probed_s) > PROBE_S:
                self._probed_s = now_s
                self.tell("alive")
            quiet_s = now_s - max(self._heard_s, begun_s)
            self._silent = quiet_s > self._patience_s or now_s - begun_s > timeout_s
        raise ProcessGoneError(self._told.silent)

    def _write(self, message: Message) -> None:
        if self._silent:
            raise ProcessGoneError(self._told.silent)
        try:
            write_line(self._to, message)
        except (OSError, ValueError) as e:
            raise ProcessGoneError(self._told.gone) from e

    def _read(self) -> None:
        try:
            for message in read_messages(self._from):
                self._heard_s = time.monotonic()
                if "alive" in message:
                    continue
                if "opened" in message:
                    self._opened.put(message)
                elif (answer := self._waiting.get(message.get("id") or 0)) is not None:
                    answer.put(message)
                else:
                    self._events.put(message)
        except PalpateError:
            pass  # it writes nonsense: as good as gone
        finally:
            self.gone = True
            for answer in list(self._waiting.values()):
                answer.put(None)
            self._events.put(None)
            self._opened.put(None)

    def result_of(self, message: Message | None) -> Any:
        """What a reply says came of it; None where nobody replied."""
        if message is None:
            raise ProcessGoneError(self._told.gone)
        if not message["ok"]:
            raise error_of(message)
        return message["result"]


def _write_whole(to: int, data: bytes) -> None:
    """Write what may be more than a pipe takes at once, before anybody else writes."""
    while data:
        data = data[os.write(to, data) :]
