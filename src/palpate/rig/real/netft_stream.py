"""One stream of RDT records on a socket of its own. It can ask a box to start and stop, and nothing else."""

from __future__ import annotations

import socket
import struct
import sys
import time
from contextlib import suppress

from palpate.core.clock import NS_PER_S, Clock
from palpate.core.errors import DeviceError
from palpate.rig.real.rdt import MOST_BYTES, Command, request

STOP_TRIES = 5
_RECEIVE_BUFFER = 1 << 20
_OLDEST_NS = 10 * NS_PER_S  # a datagram that seems to have waited longer shows that the wall clock was set
_STAMP = struct.Struct("@ll")  # the kernel's struct timespec
_STAMP_OPTION = 35 if sys.platform == "linux" else None  # SO_TIMESTAMPNS, which Python does not name


class Stream:
    """A connected UDP socket: the kernel drops what other addresses and other ports send to it."""

    def __init__(self, host: str, port: int, clock: Clock) -> None:
        """Open the socket; nothing is sent yet.

        Raises:
            DeviceError: no such address.
        """
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
            self._socket.send(request(Command.START))

    def stop(self, quiet_s: float) -> None:
        """Ask to stop, again while records still come, and at most five times.

        Args:
            quiet_s: how long nothing has to come until it counts as stopped [s].
        """
        for _ in range(STOP_TRIES):
            with suppress(OSError):
                self._socket.send(request(Command.STOP))
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

        Raises:
            DeviceError: the network refused.
        """
        self._socket.settimeout(timeout_s)
        try:
            datagram, told, _, _ = self._socket.recvmsg(MOST_BYTES + 1, 64)
        except (TimeoutError, BlockingIOError):
            return None
        except OSError as error:
            raise DeviceError(
                f"the network gave up ({error}); check the box's power and the cable"
            ) from error
        self._last_ns = max(self._last_ns, self._clock.now_ns() - _waited_ns(told))
        return datagram, self._last_ns

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


def _waited_ns(told: list[tuple[int, int, bytes]]) -> int:
    """How long a datagram lay in the kernel: between two readings of the wall clock, both taken now [ns]."""
    for level, kind, data in told:
        if (level, kind, len(data)) == (socket.SOL_SOCKET, _STAMP_OPTION, _STAMP.size):
            seconds, ns = _STAMP.unpack(data)
            waited = time.time_ns() - seconds * NS_PER_S - ns
            return waited if 0 <= waited < _OLDEST_NS else 0
    return 0
