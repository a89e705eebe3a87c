"""What stages that read G-code share: opening, moves before a place is known, and closing.

The line transport to a controller that reads G-code: a port, a reading thread, and stops that overtake.

One line is in flight at a time. Nothing here knows of positions or of a dialect. Waiting is in real time: it
bounds what the wire may take.
"""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, TypeVar

from palpate.core import Clock, Closing, DeviceError, MonotonicClock, Position, RangeError, Travel
from palpate.rig.real.gcode_spec import check_range
from palpate.rig.real.position_evidence import MAX_APPROACH_M
from palpate.rig.real.serial_port import HeardTail, SerialPort, open_port

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


Opened = TypeVar("Opened", bound="GcodeStage")


class PositionLostError(DeviceError):
    """The stage stands, and where is not known any more."""


class GcodeStage(Closing):
    """Base of a `palpate.core.Stage`; a context manager that stops it on the way out, also on Ctrl-C.

    After opening, its position is not known until `home` or `reference`: opening a port resets many boards.

    Args:
        spec: how it is reached, mounted and limited.
        port: an open serial port; `open` opens the spec's.
        clock: times the motion.
    """

    _link: GcodeLink

    def __init__(self, spec: Any, port: SerialPort, clock: Clock | None = None) -> None:
        self._spec, self._clock = spec, clock or MonotonicClock()
        self._lock = threading.RLock()
        self._closed = False

    @classmethod
    def open(cls: type[Opened], spec: Any, clock: Clock | None = None) -> Opened:
        """Open the spec's port and get into step with what is there; a motion found under way is stopped."""
        return cls(spec, open_port(spec.port, spec.baud, dtr=spec.dtr), clock)

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        """Start moving in a straight line, and return at once. See `palpate.core.Stage`."""
        halts = self._link.halts
        check_range(self.travel, position_m, speed_m_s)
        with self._lock:
            self._go(position_m, speed_m_s, halts)

    def retreat(self, distance_m: float, speed_m_s: float) -> None:
        """Start moving away from the skin by so far, and return at once, also before its place is known.

        It is what a lift before homing needs. The controller itself may refuse, where its count says that the
        travel ends, or before it is homed.

        Raises:
            RangeError: the distance is not above 0 m, or the speed is none that it can run at.
            DeviceError: it is moving or locked, or the controller refuses.
        """
        if not 0.0 < distance_m < math.inf:
            raise RangeError(f"a retreat by {distance_m} m; give a distance above 0 m")
        self._shift(-distance_m, speed_m_s)

    def approach(self, distance_m: float, speed_m_s: float) -> None:
        """Start one step of a search for the skin, and return at once, also before its place is known."""
        if not 0.0 < distance_m <= MAX_APPROACH_M:
            raise RangeError(f"an approach by {distance_m} m; above 0 m and at most {MAX_APPROACH_M} m")
        self._shift(distance_m, speed_m_s)

    def _shift(self, by_m: float, speed_m_s: float) -> None:
        halts, travel = self._link.halts, self.travel
        check_range(travel, travel.least_m, speed_m_s)
        with self._lock:
            self._go_by(by_m, speed_m_s, halts)

    def forget_position(self, why: str) -> None:
        """Forget its position, also for later sessions: homing, touch-off, or confirmation gives it anew."""
        with self._lock:
            self._lose(why)

    def close(self) -> None:
        """Stop, and let go of the port. Closing again does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            if self._link.restless or not self._link.dead:
                with suppress(PositionLostError):  # it stands, which is what is asked for here
                    self.stop()
        finally:
            self._link.close()

    @property
    @abstractmethod
    def travel(self) -> Travel: ...

    @abstractmethod
    def stop(self) -> None: ...

    @abstractmethod  # with the lock held
    def _lose(self, why: str) -> None: ...

    @abstractmethod  # with the lock held; `halts` is the link's count when this was asked for
    def _go(self, position_m: Position, speed_m_s: float, halts: int) -> None: ...

    @abstractmethod  # the same along z, also before its place is known
    def _go_by(self, by_m: float, speed_m_s: float, halts: int) -> None: ...
