"""A fake device on a real pseudo-terminal, served by a thread of its own.

The device goes on living when its terminal is unplugged, as a real one does.
"""

from __future__ import annotations

import os
import select
import threading
import tty
from contextlib import suppress
from typing import Protocol, runtime_checkable

from palpate.core import NS_PER_S, Clock, MonotonicClock

_TURN_S = 0.002
_MAX_BYTES = 4096
_MAX_UNSENT = 1 << 20  # bytes, for a host that does not read


@runtime_checkable
class SerialDevice(Protocol):
    """Device at the other end of the wire; times are in seconds of the terminal's clock."""

    def receive(self, data: bytes) -> None: ...  # from the host, now
    def take(self) -> bytes: ...  # for the host
    def run_to(self, now_s: float) -> None: ...  # let time go by until then


class FakeTerminal:
    """Serves one device, within a `with` block; POSIX only.

    Hold `lock` to look at the device or to change it. `path` is the port to open; a new one after `plug`.
    """

    def __init__(self, device: SerialDevice, clock: Clock | None = None) -> None:
        self.device, self._clock = device, clock or MonotonicClock()
        self.lock = threading.RLock()
        self._ends: tuple[int, int] | None = None
        self._ended = threading.Event()
        self.plug()
        self._thread = threading.Thread(target=self._serve, name="fake device", daemon=True)
        self._thread.start()

    def __enter__(self) -> FakeTerminal:
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self.unplug()

    def now_s(self) -> float:
        """The device's time [s]."""
        return self._clock.now_ns() / NS_PER_S

    def plug(self) -> None:
        """Give it a terminal."""
        with self.lock:
            ours, theirs = os.openpty()
            tty.setraw(theirs)  # else it echoes to the device what the device says
            os.set_blocking(ours, False)
            self.path = os.ttyname(theirs)
            self._ends = ours, theirs  # theirs stays open, or it would fall back to echoing

    def unplug(self) -> None:
        """Take its terminal away; the device goes on."""
        with self.lock:
            ends, self._ends = self._ends, None
            for end in ends or ():
                os.close(end)

    def catch_up(self) -> None:
        """Bring the device to now."""
        with self.lock:
            self.device.run_to(self.now_s())

    def _serve(self) -> None:
        unsent = b""
        while not self._ended.is_set():
            with self.lock:
                ends = self._ends
            if ends is None:
                unsent = b""
                self._ended.wait(_TURN_S)
            else:
                with suppress(OSError, ValueError):  # unplugged between two looks
                    select.select([ends[0]], [], [], _TURN_S)
            with self.lock:
                self.device.run_to(self.now_s())
                if self._ends is not None and self._ends == ends:
                    self._hear(ends[0])
                    unsent = self._say(ends[0], unsent + self.device.take())
                else:
                    self.device.take()

    def _hear(self, end: int) -> None:
        with suppress(OSError):  # nothing to hear, or nobody there
            self.device.receive(os.read(end, _MAX_BYTES))

    def _say(self, end: int, data: bytes) -> bytes:
        try:
            return data[os.write(end, data) :] if data else b""
        except OSError:  # the host does not read
            return data[-_MAX_UNSENT:]
