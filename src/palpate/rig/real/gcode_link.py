"""The line transport to a controller that reads G-code: a port, a reading thread, and stops that overtake.

One line is in flight at a time. Nothing here knows of positions or of a dialect. Waiting is in real time: it
bounds what the wire may take.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

from palpate.core import DeviceError
from palpate.rig.real.heard_lines import HeardTail
from palpate.rig.real.serial_port import SerialPort

KEPT = 512  # lines between a line and its answer; the longest list of settings has below 300
MAX_READ_BYTES = 4096
GONE = "the stage's port is gone ({}); it may still be moving: check it, then open it anew"


class CutOffError(DeviceError):
    """A stop came, or the controller started anew, before a line was answered."""


class SilenceError(DeviceError):
    """No answer in time."""


class GcodeLink(ABC):
    """Sends bytes, and passes on the lines that are heard.

    Args:
        port: an open serial port; this object closes it.
        reply_s: how long an answer to a line may take [s].
        name: of its threads.

    Attributes:
        dead: why nothing can be sent any more; empty while it can.
        halts: calls of `halt`; a line asked for before the last one is not sent any more.
        garbage: lines that could not be read.
        restless: a line that can move something went out since it was seen to stand.
    """

    def __init__(self, port: SerialPort, reply_s: float, name: str) -> None:
        self._port, self._reply_s, self._name = port, reply_s, name
        self._writing = threading.RLock()  # held for the bytes of one line, never while waiting
        self._turn = threading.RLock()
        self._news = threading.Condition()
        self._closing = False
        self.dead = ""
        self.halts = self.garbage = 0
        self.restless = False
        self.tail = HeardTail()
        self._threads: list[threading.Thread] = []

    @abstractmethod
    def _split(self, data: bytes) -> Iterator[bytes]: ...  # the lines that `data` completes

    @abstractmethod
    def _take(self, raw: bytes) -> None: ...  # a line that was heard

    def _start(self, **work: Callable[[], None]) -> None:
        """Start the reading thread and others, by name."""
        for what, run in {"reader": self._read, **work}.items():
            self._threads.append(threading.Thread(target=run, name=f"{self._name} {what}", daemon=True))
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End the threads and let go of the port. Closing again does nothing."""
        self._closing = True
        self._bury("the stage's port was closed")
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(timeout=5.0)
        self._port.close()

    def _write(self, data: bytes) -> None:
        with self._writing:
            if self.dead:
                raise DeviceError(self.dead, code="port-gone")
            try:
                sent = self._port.write(data)
                self.tail.send(data)
            except Exception as error:  # each system and adapter has its own kinds
                self._bury(GONE.format(error))
                raise DeviceError(self.dead, code="port-failed") from error
            if sent != len(data):
                self._bury(f"the stage's port took {sent} of {len(data)} bytes; check cable and power")
                raise DeviceError(self.dead, code="port-failed")

    def _bury(self, why: str) -> None:
        with self._news:
            self.dead = self.dead or why
            self._news.notify_all()

    def _read(self) -> None:
        try:
            while not self._closing and not self.dead:
                data = self._port.read(min(max(self._port.in_waiting, 1), MAX_READ_BYTES))
                self.tail.hear(data)
                for line in self._split(data):
                    self._take(line)
        except Exception as error:  # each system and adapter has its own kinds; none is swallowed
            self._bury(GONE.format(error))
