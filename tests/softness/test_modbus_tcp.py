"""The Modbus TCP client, byte by byte, against a socket that answers what it is told to."""

import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from threading import Thread

import pytest
from tests.refusals import refused

from palpate.core import DeviceError, ProtocolError
from palpate.softness.real import ModbusError, ModbusTcp, UnreachedError


class Scripted:
    """A server that gives each answer in turn, whatever is asked, and keeps the requests."""

    def __init__(self, *answers: str, pause_s: float = 0.0) -> None:
        self.requests: list[str] = []
        self._answers, self._pause_s = [bytes.fromhex(answer) for answer in answers], pause_s
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self._thread = Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        with suppress(OSError):
            connection, _ = self._server.accept()
            with connection:
                for answer in self._answers:
                    self.requests.append(connection.recv(300).hex(" "))
                    for i in range(len(answer)):
                        connection.sendall(answer[i : i + 1])
                        time.sleep(self._pause_s)
                connection.recv(300)

    def close(self) -> None:
        self._server.close()
        self._thread.join(5.0)


def client(server: Scripted, timeout_s: float = 5.0) -> ModbusTcp:
    return ModbusTcp("127.0.0.1", server.port, timeout_s=timeout_s)


@pytest.fixture
def closed_port() -> Iterator[int]:
    with socket.socket() as held:  # bound and not listening: nobody else gets it
        held.bind(("127.0.0.1", 0))
        yield int(held.getsockname()[1])


def test_a_read_is_these_bytes_and_returns_the_registers() -> None:
    server = Scripted("00 01 00 00 00 07 01 03 04 40 20 00 00")
    with client(server) as modbus:
        assert modbus.read(1000, 2) == bytes.fromhex("40 20 00 00")
    server.close()
    assert server.requests == ["00 01 00 00 00 06 01 03 03 e8 00 02"]


def test_a_write_is_these_bytes_and_transactions_are_numbered() -> None:
    answer = "00 00 00 06 01 10 03 e8 00 02"
    server = Scripted(f"00 01 {answer}", f"00 02 {answer}")
    with client(server) as modbus:
        for _ in range(2):
            modbus.write(1000, bytes.fromhex("40 20 00 00"))
    server.close()
    assert server.requests == [f"00 0{i} 00 00 00 0b 01 10 03 e8 00 02 04 40 20 00 00" for i in (1, 2)]


@pytest.mark.parametrize("code", [1, 2, 77])
def test_an_exception_is_named_and_the_connection_goes_on(code: int) -> None:
    server = Scripted(f"00 01 00 00 00 03 01 83 {code:02x}", "00 02 00 00 00 05 01 03 02 00 07")
    with client(server) as modbus:
        with refused(f"modbus-exception-{code}", ModbusError, match="61600") as raised:
            modbus.read(61600, 2)
        assert raised.value.exception_code == code
        assert modbus.read(5, 1) == b"\0\7"
    server.close()


@pytest.mark.parametrize(
    "answer",
    [
        "00 02 00 00 00 07 01 03 04 40 20 00 00",  # another transaction
        "00 01 00 01 00 07 01 03 04 40 20 00 00",  # another protocol
        "00 01 00 00 00 07 02 03 04 40 20 00 00",  # another unit
        "00 01 00 00 00 06 01 03 04 40 20 00 00",  # a length that is too small by one
        "00 01 00 00 ff ff 01 03 04 40 20 00 00",  # and one that would be waited for
        "00 01 00 00 00 07 01 04 04 40 20 00 00",  # another function
        "00 01 00 00 00 07 01 83 02 ff ff ff ff",  # an exception that is too long
        "00 01 00 00 00 07 01 03 05 40 20 00 00",  # another count of bytes
        "00 01 00 00 00 03 01 03 04",  # as long as an exception, and none
    ],
)
def test_an_answer_to_something_else_is_refused(answer: str) -> None:
    server = Scripted(answer)
    with client(server) as modbus, pytest.raises(ProtocolError):
        modbus.read(1000, 2)
    server.close()


def test_an_answer_that_drips_ends_at_the_time_out() -> None:
    server = Scripted("00 01 00 00 00 07 01 03 04 40 20 00 00", pause_s=0.1)
    with client(server, timeout_s=0.3) as modbus:
        began = time.monotonic()
        with refused("no-answer", DeviceError, match=r"0\.3 s"):
            modbus.read(1000, 2)
        assert time.monotonic() - began < 1.0
    server.close()


def test_a_port_where_nobody_listens_says_what_to_do(closed_port: int) -> None:
    with refused("unreached", UnreachedError):
        ModbusTcp("127.0.0.1", closed_port)
