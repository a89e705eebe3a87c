"""A LabJack T7 that is not there, with a regulator, a chamber and a Hall sensor on its terminals.

A real Modbus TCP server on this computer, and every fault on demand. Written from the protocol and LabJack's
map of registers, not from the driver: it packs its own bytes and shares no code with it.
"""

from __future__ import annotations

import math
import socket
import struct
import time
from contextlib import suppress
from threading import Event, Lock, Thread
from typing import Literal

from palpate.core import Closing

Fault = Literal[
    "", "silent", "half", "transaction", "unit", "protocol", "function", "length", "exception", "drop", "slow"
]
_DAC0, _PRODUCT = 1000, 60000
_ENABLE, _TIMEOUT, _STRICT, _KEY, _CLEAR = 61600, 61604, 61610, 61612, 61614
_DAC_ENABLE, _DAC_VALUE = 61640, 61642
_SETTINGS = {61602, _TIMEOUT, 61606, _STRICT, _KEY, 61620, *range(61630, 61637, 2), _DAC_ENABLE, _DAC_VALUE}
_MAX_CONNECTIONS = 2
_TICK_S = 2e-3


class FakeLabJack(Closing):
    """A board that measures a chamber. Change its attributes while it runs to make it fail.

    Attributes:
        fault: done with every answer from now on; empty for none.
        faults_left: answers after which the fault ends by itself; below 0 for never.
        fault_at: register whose requests alone meet the fault; None for all.
        slow_s: by which a slow answer is late [s].
        exception: code of an answer that is an exception.
        product: number that it says it is.
        inputs_v: voltages in place of the sensors', by input [V].
        pushed_m: displacement of the tip [m].
        regulator_pa: pressure of the regulator at 5 V [Pa].
        lag_s: time constant of chamber and regulator; 0 for none [s].
        forgets: it does not keep what is written to these registers.
        seconds: of the board's watchdog that pass in one second.
        flash_writes: writes to settings that are kept in flash.
        watchdog_fired: how often it has.
        written: address and bytes of all that was written, oldest first.

    Example:
        >>> with FakeLabJack() as board:
        ...     board.host, board.dac0_v
        ('127.0.0.1', 0.0)
    """

    def __init__(self) -> None:
        self.fault: Fault = ""
        self.faults_left = -1
        self.fault_at: int | None = None
        self.slow_s, self.exception, self.product = 0.1, 2, 7.0
        self.inputs_v: dict[int, float] = {}
        self.pushed_m, self.regulator_pa, self.lag_s = 0.0, 100e3, 0.0
        self.forgets: set[int] = set()
        self.seconds = 1.0
        self.flash_writes = self.watchdog_fired = 0
        self.written: list[tuple[int, bytes]] = []
        self.host = "127.0.0.1"
        self._words: dict[int, bytes] = {}
        self._lock = Lock()
        self._closing = Event()
        self._pressure_pa, self._at = 0.0, time.monotonic()
        self._fed = self._at
        self._connections: set[socket.socket] = set()
        self._listening = socket.create_server((self.host, 0))
        self._listening.settimeout(0.01)
        self.port = int(self._listening.getsockname()[1])
        self._threads = [
            Thread(target=self._listen, name="fake LabJack", daemon=True),
            Thread(target=self._tick, name="fake LabJack's watchdog", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def dac0_v(self) -> float:
        """Voltage at the regulator's set-point [V]."""
        return float(struct.unpack(">f", self._kept(_DAC0, 2))[0])

    @property
    def pressure_pa(self) -> float:
        """Gauge pressure of the chamber now [Pa]."""
        with self._lock:
            return self._breathe()

    @property
    def connections(self) -> int:
        """Number of clients that are connected."""
        return len(self._connections)

    def register(self, address: int) -> int:
        """What an unsigned register of two words holds."""
        return int.from_bytes(self._kept(address, 2))

    def restart(self) -> None:
        """Drop every client and the set-point, as without power for a moment; what is in flash stays."""
        with self._lock:
            self._words = {at: word for at, word in self._words.items() if at >= _ENABLE}
            self._fed = time.monotonic()
        self._hang_up()

    def close(self) -> None:
        """Let go of the port. Closing again does nothing."""
        if not self._closing.is_set():
            self._closing.set()
            self._listening.close()
            self._hang_up()
            for thread in self._threads:
                thread.join()

    def _hang_up(self) -> None:
        for connection in list(self._connections):
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _listen(self) -> None:
        while not self._closing.is_set():
            with suppress(OSError):
                connection, _ = self._listening.accept()
                if len(self._connections) >= _MAX_CONNECTIONS:
                    connection.close()
                    continue
                connection.settimeout(None)
                self._connections.add(connection)
                thread = Thread(target=self._serve, args=(connection,), daemon=True)
                self._threads.append(thread)
                thread.start()

    def _serve(self, connection: socket.socket) -> None:
        with suppress(OSError), connection:
            try:
                while not self._closing.is_set():
                    number, _, size, unit = struct.unpack(">HHHB", _all(connection, 7))
                    request = _all(connection, size - 1)
                    fault = self._fault_now(int.from_bytes(request[1:3]))
                    if fault == "slow":
                        self._closing.wait(self.slow_s)
                    answer = bytes([request[0] | 0x80, self.exception])
                    if fault != "exception":
                        with self._lock:
                            answer = self._answer(request)
                    self._send(connection, fault, (number, unit), answer)
            finally:
                self._connections.discard(connection)

    def _fault_now(self, address: int) -> Fault:
        if self.faults_left == 0 or self.fault_at not in (None, address):
            return ""
        if self.fault:
            self.faults_left -= 1
        return self.fault

    def _send(self, connection: socket.socket, fault: Fault, who: tuple[int, int], answer: bytes) -> None:
        number, unit = who
        if fault == "function":
            answer = bytes([answer[0] ^ 7]) + answer[1:]
        packet = struct.pack(
            ">HHHB",
            (number + (fault == "transaction")) % 65536,
            int(fault == "protocol"),
            len(answer) + 1 + 2 * (fault == "length"),
            (unit + (fault == "unit")) % 256,
        )
        packet += answer
        if fault == "drop":
            connection.shutdown(socket.SHUT_RDWR)
        elif fault != "silent":
            connection.sendall(packet[: len(packet) // 2] if fault == "half" else packet)

    def _answer(self, request: bytes) -> bytes:
        function, address, n = struct.unpack(">BHH", request[:5])
        if function in (3, 4):
            return bytes([function, 2 * n]) + self._kept(address, n)
        if function != 16 or request[5] != 2 * n or len(request) != 6 + 2 * n:
            return bytes([function | 0x80, 1])
        watching = bool(int.from_bytes(self._kept(_ENABLE, 2)))
        if address in _SETTINGS and watching:  # a watchdog that runs does not let itself be changed
            return bytes([function | 0x80, 4])
        self._write(address, request[6:])
        return request[:5]

    def _write(self, address: int, data: bytes) -> None:
        self._breathe()
        self.written.append((address, data))
        self.flash_writes += address in _SETTINGS or address == _ENABLE
        if address == _CLEAR:
            if data == self._kept(_KEY, 2):
                self._fed = time.monotonic()
            return
        if address not in self.forgets:
            for i in range(0, len(data), 2):
                self._words[address + i // 2] = data[i : i + 2]
        if address == _ENABLE:
            self._fed = time.monotonic()

    def _kept(self, address: int, n: int) -> bytes:
        words = dict(self._words)
        if address < 508 and n:
            first = address // 2
            volts = [self._input_v(i) for i in range(first, first + (n + 1) // 2)]
            return struct.pack(f">{len(volts)}f", *volts)[: 2 * n]
        if address == _PRODUCT:
            return struct.pack(">f", self.product)
        return b"".join(words.get(address + i, b"\0\0") for i in range(n))

    def _input_v(self, i: int) -> float:
        sensors = {0: 4.5 - 400 * self.pushed_m, 1: 1.0 + 4 * self._breathe() / 100e3}
        return self.inputs_v.get(i, sensors.get(i, 0.0))

    def _breathe(self) -> float:
        now = time.monotonic()
        target = self.regulator_pa * struct.unpack(">f", self._kept(_DAC0, 2))[0] / 5
        left = math.exp(-(now - self._at) / self.lag_s) if self.lag_s else 0.0
        self._pressure_pa, self._at = target + (self._pressure_pa - target) * left, now
        return self._pressure_pa

    def _tick(self) -> None:
        while not self._closing.wait(_TICK_S):
            with self._lock:
                timeout_s = int.from_bytes(self._kept(_TIMEOUT, 2))
                waited_s = (time.monotonic() - self._fed) * self.seconds
                if not int.from_bytes(self._kept(_ENABLE, 2)) or waited_s < timeout_s:
                    continue
                self._fed = time.monotonic()
                self.watchdog_fired += 1
                if int.from_bytes(self._kept(_DAC_ENABLE, 2)):
                    self._breathe()
                    value = self._kept(_DAC_VALUE, 2)
                    self._words[_DAC0], self._words[_DAC0 + 1] = value[:2], value[2:]


def _all(connection: socket.socket, n: int) -> bytes:
    data = b""
    while len(data) < n:
        part = connection.recv(n - len(data))
        if not part:
            raise ConnectionResetError
        data += part
    return data
