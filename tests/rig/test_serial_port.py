"""Writes to a serial port: late only if the port takes nothing, never by a stall of the host."""

import os
import time
from collections.abc import Iterator

import pytest

from palpate.rig.real import serial_port
from palpate.rig.real.serial_port import SerialPort, open_port


@pytest.fixture
def terminal() -> Iterator[tuple[int, SerialPort]]:
    pytest.importorskip("serial", reason="serial ports need pyserial")
    controller, device = os.openpty()
    port = open_port(os.ttyname(device), 115200)
    yield controller, port
    port.close()
    os.close(controller)
    os.close(device)


def test_a_stall_of_the_host_within_a_write_is_no_failure(terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    controller, port = terminal
    write = os.write

    def stalled(handle: int, data: bytes) -> int:
        taken = write(handle, data)
        time.sleep(0.3)
        return taken

    monkeypatch.setattr(serial_port, "WRITE_S", 0.1)
    monkeypatch.setattr(os, "write", stalled)
    port._port.write_timeout = 0.1
    with pytest.raises(Exception, match="Write timeout"):  # the control: pyserial alone
        port._port.write(b"?")
    assert port.write(b"\x85") == 1
    assert os.read(controller, 10) == b"?\x85"


def test_a_port_that_takes_nothing_is_late(terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    _, port = terminal
    monkeypatch.setattr(serial_port, "WRITE_S", 0.1)
    with pytest.raises(TimeoutError):
        port.write(bytes(1_000_000))
