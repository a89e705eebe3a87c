"""ATI's raw data transfer (RDT): requests to a Net F/T box, its records, and what their numbers say.

Only bytes and integers; no socket, no unit, no clock. All numbers are big-endian.

    request   header 0x1234 | command u16 | count u32 (0: without end)                              8 bytes
    record    rdt sequence u32 | F/T sequence u32 | status u32 | Fx Fy Fz Tx Ty Tz i32 counts      36 bytes

The RDT sequence numbers the records that were sent, from each start anew; the F/T sequence numbers the
measurements of the device. Both count modulo 2^32.

Source: the published client programs for this protocol; see decision 0006.
"""

from __future__ import annotations

import socket
import struct
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum, IntEnum

from palpate.core import NS_PER_S, Clock, DeviceError, ProtocolError, RangeError

PORT = 49152
HEADER = 0x1234
MAX_RECORDS = 40  # that the box puts in one datagram, in buffered mode
MAX_JUMP = 2**20  # measurements; 150 s at 7 kHz, far longer than any silence that is borne

_REQUEST = struct.Struct(">HHI")
_RECORD = struct.Struct(">III6i")
RECORD_BYTES = _RECORD.size
MAX_BYTES = MAX_RECORDS * RECORD_BYTES

HEALTHY = 0x00000000
MONITOR_WARNING = 0x80010000  # a threshold that the user set in the box was crossed; the force is good
_SUMMARY, _MONITOR, _SATURATION = 1 << 31, 1 << 16, 1 << 17

STATUS_BITS = {
    30: "processor or memory",
    29: "digital board",
    28: "analog board",
    27: "serial link",
    26: "program memory",
    25: "halted, configuration",
    24: "settings",
    23: "configuration and calibration do not match",
    22: "network",
    21: "CAN",
    20: "RDT",
    19: "EtherNet/IP",
    18: "DeviceNet",
    17: "saturated",
    16: "monitor condition",
    14: "watchdog",
    13: "stack",
    12: "EEPROM",
    11: "flash",
    10: "analog watchdog",
    9: "excitation high",
    8: "excitation low",
    7: "analog ground",
    6: "supply high",
    5: "supply low",
    4: "serial data missing",
    3: "reference",
    2: "temperature",
    1: "HTTP",
}
"""Meaning of each status bit; bit 31 only says that another is set, 15 and 0 mean nothing."""


class RdtCommand(IntEnum):
    """Commands of RDT."""

    STOP = 0x0000
    START = 0x0002  # one record a datagram, as it is measured
    START_BUFFERED = 0x0003
    RESET_LATCH = 0x0041
    BIAS = 0x0042  # takes the present load as zero, inside the box, unanswered; palpate never sends it


Counts = tuple[int, int, int, int, int, int]


@dataclass(frozen=True, slots=True)
class RdtRecord:
    """Measurement as sent: sequences, status, and Fx Fy Fz Tx Ty Tz in counts."""

    rdt_sequence: int
    ft_sequence: int
    status: int
    counts: Counts


def request(command: RdtCommand, count: int = 0) -> bytes:
    """The eight bytes that ask for something.

    Example:
        >>> request(RdtCommand.START).hex(" ")
        '12 34 00 02 00 00 00 00'
    """
    if not 0 <= count < 2**32:
        raise RangeError(f"cannot ask for {count} records; give 0 (without end) to {2**32 - 1}")
    return _REQUEST.pack(HEADER, command, count)


def records(datagram: bytes) -> list[RdtRecord]:
    """The records of one datagram, oldest first."""
    size = len(datagram)
    if size == 0 or size % RECORD_BYTES or size > MAX_BYTES:
        raise ProtocolError(
            f"a datagram of {size} bytes is not RDT: it holds 1 to {MAX_RECORDS} records of {RECORD_BYTES} "
            "bytes each; does another program send to this port?"
        )
    return [RdtRecord(r, f, s, tuple(c)) for r, f, s, *c in _RECORD.iter_unpack(datagram)]


def is_healthy(status: int) -> bool:
    """Whether the force of a record with this status holds: nothing, or only the user's own threshold."""
    return status in (HEALTHY, MONITOR_WARNING)


def is_only_saturated(status: int) -> bool:
    """Whether the load is beyond what can be measured and nothing else is wrong: it ends with the load."""
    return status & ~(_SUMMARY | _MONITOR) == _SATURATION


def status_text(status: int) -> str:
    """Status in words; empty where it is healthy.

    Example:
        >>> status_text(0x80020000)
        'saturated'
        >>> status_text(0x80000005)
        'temperature, undefined bit 0'
    """
    if status == HEALTHY:
        return ""
    bits = [bit for bit in range(30, -1, -1) if status >> bit & 1]
    named = [STATUS_BITS.get(bit, f"undefined bit {bit}") for bit in bits]
    return ", ".join(named) or "an error without a name"


def ahead(current: int, previous: int) -> int:
    """Lead of one sequence number over another, -2^31 to 2^31 - 1.

    Example:
        >>> ahead(0, 0xFFFFFFFF)
        1
    """
    return (current - previous + 2**31) % 2**32 - 2**31


@dataclass(slots=True)
class RdtSequence:
    """Follows the RDT sequence of a stream. A stale record moves nothing, so what follows it is not lost."""

    last: int | None = None
    lost: int = 0
    duplicate: int = 0
    out_of_order: int = 0

    def accept(self, current: int) -> bool:
        """Whether a record is newer than all before; counts those between as lost, and drops the others."""
        step = 1 if self.last is None else ahead(current, self.last)
        if step == 0:
            self.duplicate += 1
        elif step < 0:
            self.out_of_order += 1
        else:
            self.lost += step - 1
            self.last = current
        return step > 0


class Advance(Enum):
    """Progress of the measurement, by the F/T sequence of a new record."""

    NEW = "new"
    STALLED = "stalled"
    BACK = "counter-jumped"
    RESTARTED = "restarted"


@dataclass(slots=True)
class RdtMeasurement:
    """Follows the F/T sequence. A jump, back or far ahead, is a restart once a second record confirms it."""

    last: int | None = None
    jumped: bool = False

    def progress(self, current: int) -> Advance:
        """Advance by this record's number, after those before."""
        step = 1 if self.last is None else ahead(current, self.last)
        if step == 0:
            return Advance.STALLED
        if not 0 < step <= MAX_JUMP:  # a counter past 2^31 that restarts seems to go far ahead
            confirmed, self.jumped = self.jumped, True
            return Advance.RESTARTED if confirmed else Advance.BACK
        self.last, self.jumped = current, False
        return Advance.NEW


MAX_STOP_TRIES = 5
_RECEIVE_BUFFER = 1 << 20
_OLDEST_NS = 10 * NS_PER_S  # a datagram that seems to have waited longer shows that the wall clock was set
_STAMP = struct.Struct("@ll")  # the kernel's struct timespec
_STAMP_OPTION = 35 if sys.platform == "linux" else None  # SO_TIMESTAMPNS, which Python does not name


class RdtStream:
    """A connected UDP socket: the kernel drops what other addresses and other ports send to it."""

    def __init__(self, host: str, port: int, clock: Clock) -> None:
        """Open the socket; nothing is sent yet."""
        self._clock, self._last_ns = clock, clock.now_ns()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            if _STAMP_OPTION is not None:
                self._socket.setsockopt(socket.SOL_SOCKET, _STAMP_OPTION, 1)
            self._socket.connect((host, port))
        except OSError as error:
            self._socket.close()
            raise DeviceError(
                f"{host}:{port} cannot be reached ({error}); check address and network"
            ) from error

    def start(self) -> None:
        """Ask for records without end. The request can be lost, like any datagram."""
        with suppress(ConnectionError):  # a refusal of an earlier request, told late
            self._socket.send(request(RdtCommand.START))

    def stop(self, quiet_s: float) -> None:
        """Ask to stop, again while records still come, and at most five times.

        Args:
            quiet_s: how long nothing has to come until it counts as stopped [s].
        """
        for _ in range(MAX_STOP_TRIES):
            with suppress(OSError):
                self._socket.send(request(RdtCommand.STOP))
            until_ns = self._clock.now_ns() + round(quiet_s * NS_PER_S)
            while self._clock.now_ns() < until_ns:  # what was under way still comes
                with suppress(DeviceError):
                    self.receive(quiet_s)
            with suppress(DeviceError):
                if self.receive(quiet_s) is None:
                    return

    def receive(self, timeout_s: float) -> tuple[bytes, int] | None:
        """The next datagram and when it reached this computer [ns]; None where none comes in time [s].

        The time is the kernel's where it tells it, so a program that is late does not take an old sample for
        a fresh one.
        """
        self._socket.settimeout(timeout_s)
        try:
            datagram, ancillary, _, _ = self._socket.recvmsg(MAX_BYTES + 1, 64)
        except (TimeoutError, BlockingIOError):
            return None
        except OSError as error:
            raise DeviceError(
                f"the network gave up ({error}); check the box's power and the cable"
            ) from error
        self._last_ns = max(self._last_ns, self._clock.now_ns() - _waited_ns(ancillary))
        return datagram, self._last_ns

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


def _waited_ns(ancillary: list[tuple[int, int, bytes]]) -> int:
    """Time that a datagram lay in the kernel: between two readings of the wall clock, both taken now [ns]."""
    for level, kind, data in ancillary:
        if (level, kind, len(data)) == (socket.SOL_SOCKET, _STAMP_OPTION, _STAMP.size):
            seconds, ns = _STAMP.unpack(data)
            waited = time.time_ns() - seconds * NS_PER_S - ns
            return waited if 0 <= waited < _OLDEST_NS else 0
    return 0
