"""Client's end of a supervisor's process: its start, its two pipes, and the devices as seen through them."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any

from palpate.core import Closing, DeviceError, PalpateError, Position, Travel, Wrench
from palpate.devices.operator_control import OperatorCommand
from palpate.devices.rpc import encode_message
from palpate.devices.supervisor.guard_messages import (
    error_of,
    read_messages,
    sample_of,
    three,
    write_line,
)

ANSWER_S = 60.0  # beyond what a slow stage may take to come to a stand
END_S = 60.0  # in which the process has lifted the probe and let go of the devices
OPEN_S = 900.0  # in which it has opened them: homing may take minutes
PROBE_S = 1.0  # of silence, after which it is asked whether it is there: its reader answers past any device
SILENT_S = 5.0  # of silence, after which the process hangs
HURRIED_S = 1.0  # instead, once an emergency stop was asked for
LEAVE_S = 1.0  # in which a process that hung lets go

Message = Mapping[str, Any]


class SupervisorGoneError(DeviceError):
    """The supervisor is gone, or silent."""


class SupervisorLink(Closing):
    """Link to a supervisor's process, which ends with it.

    Args:
        words: what the Python interpreter is called with, such as ("-m", "a.module").
        opens: the first message: what the process opens.

    Attributes:
        facts: what the process said of its devices.
        stage, force: the devices, as far as a client may use them.

    Raises:
        PalpateError: as the process raised it when it opened the devices.
    """

    def __init__(self, words: Sequence[str], opens: Message) -> None:
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
        self.force = SupervisedForce(self)
        self.stage = SupervisedStage(self)
        self._opened: SimpleQueue[Message | None] = SimpleQueue()
        self._reader = threading.Thread(target=self._read, name="palpate-supervisor-reader", daemon=True)
        self._reader.start()
        try:
            os.write(self._to, encode_message(opens))
            self.facts = result_of(self._opened.get(timeout=OPEN_S))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let the process lift the probe where it has to, let go of the devices and end."""
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(OSError):
            process.stdin.close()
        within_s = LEAVE_S if self._silent else END_S
        try:
            process.wait(within_s)
        except subprocess.TimeoutExpired:
            process.terminate()  # it stops and lifts, where it ever wakes
            threading.Thread(target=self._bury, name="palpate-supervisor-end", daemon=True).start()
            raise DeviceError(
                f"the supervisor's process has not let go of the devices in {within_s:g} s; look at the rig, "
                "and use its switch"
            ) from None
        self._bury()

    def _bury(self) -> None:
        self._process.wait()
        self._reader.join(END_S)  # its pipe has ended with the process
        assert self._process.stdout is not None
        self._process.stdout.close()

    @property
    def pid(self) -> int:
        """Process id of the supervisor."""
        return self._process.pid

    def tell(self, do: str, **fields: Any) -> None:
        """Say something that has no answer; from any thread, also from a signal's handler.

        A supervisor that is gone is told by whatever waits for it.
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
        """The next that it tells: a look, or the reply to an order.

        Raises:
            SupervisorGoneError: it is gone, or silent.
        """
        event = self._wait(self._events, timeout_s)
        if event is None:
            self._events.put(None)
            raise gone()
        return event

    def ask(self, do: str, **fields: Any) -> Any:
        """Order something, from any thread, and wait for what comes of it.

        Raises:
            SupervisorGoneError: the supervisor is gone, or does not answer.
            PalpateError: as the supervisor raised it.
        """
        number, answer = next(self._numbers), SimpleQueue[Message | None]()
        self._waiting[number] = answer
        try:
            self._write({"id": number, "do": do, **fields})
            return result_of(None if self.gone and answer.empty() else self._wait(answer, ANSWER_S))
        finally:
            self._waiting.pop(number, None)

    def _wait(self, queue: SimpleQueue[Message | None], timeout_s: float) -> Message | None:
        """The next of a queue, as long as the process is heard at all; a device of it may be slow.

        After the first silence nothing is waited for any more.
        """
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
        raise silent()

    def _write(self, message: Message) -> None:
        if self._silent:
            raise silent()
        try:
            write_line(self._to, message)
        except (OSError, ValueError) as e:
            raise gone() from e

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


def result_of(message: Message | None) -> Any:
    """What a reply says came of it."""
    if message is None:
        raise gone()
    if not message["ok"]:
        raise error_of(message)
    return message["result"]


def gone() -> SupervisorGoneError:
    """What is raised where the supervisor has died."""
    return SupervisorGoneError(
        "the process that guards the motion is gone; a move that it had sent ends by itself. Look at the "
        "rig: the probe may stand in the skin"
    )


def silent() -> SupervisorGoneError:
    """What is raised where the supervisor does not answer."""
    return SupervisorGoneError(
        "the process that guards the motion does not answer: it hangs, and may not stop or lift the probe; "
        "use the rig's switch"
    )


class SupervisedStage:
    """A `palpate.core.Stage` that a supervisor owns: it says where it is, and stops; the guard moves it."""

    def __init__(self, link: SupervisorLink) -> None:
        self._link = link

    @property
    def travel(self) -> Travel:
        """Reach, speed and stopping, as the device states them."""
        facts = self._link.facts["travel"]
        return Travel(three(facts[0]), three(facts[1]), *(float(value) for value in facts[2:]))

    @property
    def health(self) -> str:
        """What was lost on the wire, of a driver that counts it; empty where nothing was."""
        return str(self._link.ask("health"))

    def position_m(self) -> Position:
        """Place now [m]."""
        return three(self._link.ask("position"))

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        """Refuse: the supervisor's guard alone moves it."""
        raise DeviceError("a supervisor owns the stage; only its guarded moves move it")

    def moving(self) -> bool:
        """Whether it is under way."""
        return bool(self._link.ask("moving"))

    def stop(self) -> None:
        """Bring it to a stand, past whatever the supervisor is doing."""
        self._link.ask("stop")

    def release(self) -> None:
        """Let it move again after an emergency stop."""
        self._link.ask("release")

    def close(self) -> None:
        """Nothing: the supervisor closes it as it ends."""


class SupervisedForce:
    """A `palpate.core.ForceSensor` that a supervisor owns.

    During a run the supervisor drains it, and what it tells is handed out here; at rest it is asked.
    """

    def __init__(self, link: SupervisorLink) -> None:
        self._link = link
        self._told: list[Wrench] = []
        self.guarded = False

    @property
    def rate_hz(self) -> float:
        """Samples a second, as the device states them [Hz]."""
        return float(self._link.facts["rate_hz"])

    @property
    def delay_s(self) -> float:
        """Delay of its samples, where it states one [s]."""
        return float(self._link.facts["delay_s"])

    @property
    def range_n(self) -> tuple[float, float, float]:
        """Greatest force along each axis, as the device states it [N]."""
        return three(self._link.facts["range_n"])

    def latest(self) -> Wrench:
        """The newest sample; during a run refused as the guard refuses it."""
        return sample_of(self._link.ask("newest", judged=self.guarded))

    def drain(self) -> list[Wrench]:
        """All since the last call."""
        if not self.guarded:
            return [sample_of(row) for row in self._link.ask("drain")]
        told, self._told = self._told, []
        return told

    def tell(self, samples: Sequence[Wrench]) -> None:
        """What the supervisor told of it."""
        self._told += samples

    def close(self) -> None:
        """Nothing: the supervisor closes it as it ends."""
