"""Modbus TCP client with a time limit on every exchange.

An answer with another transaction, unit, function, or length closes the connection; the next call reconnects.

Reference: Modbus Organization, Modbus application protocol specification V1.1b3 (functions 3 and 16) and
Modbus messaging on TCP/IP implementation guide V1.0b.
"""

from __future__ import annotations

import math
import socket
import struct
import time
from threading import Lock

from palpate.core import Closing, DeviceError, ProtocolError, RangeError

READ, WRITE = 3, 16
ERROR = 0x80  # set in the function of an answer that is an exception
EXCEPTIONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledged, and not done yet",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not respond",
}
MAX_REGISTERS = 120  # of one request; the protocol allows 125 to read and 123 to write


class ModbusError(DeviceError):
    """Exception response of the device; `exception_code` is 1 to 255."""

    def __init__(self, message: str, exception_code: int) -> None:
        super().__init__(message, code=f"modbus-exception-{exception_code}")
        self.exception_code = exception_code


class UnreachedError(DeviceError):
    """There is no connection to the device."""


class ModbusTcp(Closing):
    """One connection to a Modbus TCP server. Calls from several threads take turns."""

    def __init__(self, host: str, port: int = 502, unit: int = 1, timeout_s: float = 0.5) -> None:
        """Connect; `timeout_s` limits connecting and every exchange, reconnection included."""
        if not (0 < timeout_s < math.inf and 0 <= unit <= 255 and 0 < port < 65536):
            raise RangeError(
                f"Modbus TCP port {port}, unit {unit}, time-out {timeout_s} s; give a port of 1 to 65535, a "
                "unit of 0 to 255 and a time above 0 s"
            )
        self.where = f"{host}:{port}"
        try:  # once: what has to be told in a hurry must not wait for a name to be looked up
            self._address = (socket.gethostbyname(host), port)
        except (OSError, ValueError) as error:  # the latter of a name that cannot be written as one
            raise UnreachedError(f"there is no {host} in this network ({error}); give its address") from error
        self._unit, self._timeout_s = unit, timeout_s
        self._turn = Lock()
        self._number = 0
        self._closed = False
        self._socket: socket.socket | None = None
        with self._turn:
            self._connect(time.monotonic() + timeout_s)

    def read(self, address: int, registers: int) -> bytes:
        """The bytes of so many registers, two each, the most significant first."""
        _check(address, registers)
        head = bytes([READ, 2 * registers])
        return self._exchange(struct.pack(">BHH", READ, address, registers), head, 2 * registers)

    def write(self, address: int, data: bytes) -> None:
        """Write registers, two bytes each, and wait until the device says that it has."""
        registers = len(data) // 2
        _check(address, registers if 2 * registers == len(data) else 0)
        head = struct.pack(">BHH", WRITE, address, registers)
        self._exchange(head + bytes([len(data)]) + data, head, 0)

    def close(self) -> None:
        """Let go of the connection. Closing again does nothing."""
        self._closed = True
        self._drop()

    def _exchange(self, request: bytes, head: bytes, more: int) -> bytes:
        """The bytes that follow the head of the answer to a request, `more` of them."""
        if not self._turn.acquire(timeout=2 * self._timeout_s):
            raise DeviceError(f"{self.where} is still being asked something else; ask it from fewer threads")
        try:
            return self._one_exchange(request, head, more)
        except TimeoutError as error:
            self._drop()
            raise DeviceError(
                f"{self.where} did not answer whole within {self._timeout_s:g} s; is it switched on, is the "
                "cable in, does another program ask it for much?",
                code="no-answer",
            ) from error
        except OSError as error:
            self._drop()
            raise DeviceError(
                f"the connection to {self.where} broke ({error}); check its power and the cable"
            ) from error
        except ProtocolError:
            self._drop()
            raise
        finally:
            self._turn.release()

    def _one_exchange(self, request: bytes, head: bytes, more: int) -> bytes:
        end = time.monotonic() + self._timeout_s
        connected = self._socket or self._connect(end)
        self._number = self._number % 0xFFFF + 1
        _wait(connected, end)
        connected.sendall(struct.pack(">HHHB", self._number, 0, len(request) + 1, self._unit) + request)
        answer = self._answer(connected, end, len(head) + more)
        if answer[0] == request[0] | ERROR and len(answer) == 2:
            raise self._refusal(request, answer[1])
        if not answer.startswith(head) or len(answer) != len(head) + more:
            raise ProtocolError(
                f"{self.where} answered {answer[:8].hex(' ')} where {head.hex(' ')} is due; restart it"
            )
        return answer[len(head) :]

    def _answer(self, connected: socket.socket, end: float, length: int) -> bytes:
        """The function and what follows it, of an answer that is so long or an exception."""
        number, protocol, size, unit = struct.unpack(">HHHB", _exactly(connected, 7, end))
        if (number, protocol, unit) != (self._number, 0, self._unit):
            raise ProtocolError(
                f"{self.where} answered transaction {number}, protocol {protocol}, unit {unit}; asked was "
                f"{self._number}, 0, {self._unit}: check the unit's number, and that this is a Modbus device"
            )
        if size not in (length + 1, 3):  # the unit counts as one; an exception has two bytes more
            raise ProtocolError(f"{self.where} announces {size} bytes where {length + 1} are due; restart it")
        return _exactly(connected, size - 1, end)

    def _refusal(self, request: bytes, code: int) -> ModbusError:
        meaning = EXCEPTIONS.get(code, "which the protocol does not name")
        (register,) = struct.unpack(">H", request[1:3])
        return ModbusError(
            f"{self.where} refuses function {request[0]} at register {register}: exception {code}, "
            f"{meaning}; check that it is the board that the settings name, and its firmware",
            code,
        )

    def _connect(self, end: float) -> socket.socket:
        if self._closed:
            raise UnreachedError(f"the connection to {self.where} is closed; open the device anew")
        try:
            self._socket = socket.create_connection(self._address, max(end - time.monotonic(), 1e-3))
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            self._drop()
            raise UnreachedError(
                f"{self.where} cannot be reached ({error}); check its address, power and cable, and end "
                "every other program that is connected to it"
            ) from error
        return self._socket

    def _drop(self) -> None:
        connected, self._socket = self._socket, None
        if connected is not None:
            connected.close()


def _check(address: int, registers: int) -> None:
    if not (1 <= registers <= MAX_REGISTERS and 0 <= address <= 65536 - registers):
        raise RangeError(
            f"{registers} registers from {address} on; give 1 to {MAX_REGISTERS} whole ones, within 0 to "
            "65535"
        )


def _wait(connected: socket.socket, end: float) -> None:
    """Let the next call of a socket last until `end` at most."""
    left = end - time.monotonic()
    if left <= 0:
        raise TimeoutError
    connected.settimeout(left)


def _exactly(connected: socket.socket, n: int, end: float) -> bytes:
    data = b""
    while len(data) < n:
        _wait(connected, end)
        part = connected.recv(n - len(data))
        if not part:
            raise ConnectionResetError("closed by the device")
        data += part
    return data
