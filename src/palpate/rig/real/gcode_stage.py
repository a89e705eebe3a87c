"""What stages that read G-code share: opening, moves before a place is known, and closing."""

from __future__ import annotations

import math
import threading
from abc import abstractmethod
from contextlib import suppress
from typing import Any, TypeVar

from palpate.core import Clock, Closing, DeviceError, MonotonicClock, Position, RangeError, Travel
from palpate.rig.real.gcode_link import GcodeLink
from palpate.rig.real.gcode_spec import check_range
from palpate.rig.real.position_evidence import MAX_APPROACH_M
from palpate.rig.real.serial_port import SerialPort, open_port

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

    @abstractmethod  # with the lock held; `halts` is the link's count when this was asked for
    def _go(self, position_m: Position, speed_m_s: float, halts: int) -> None: ...

    @abstractmethod  # the same along z, also before its place is known
    def _go_by(self, by_m: float, speed_m_s: float, halts: int) -> None: ...
