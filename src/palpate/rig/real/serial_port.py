"""Serial ports: found by path or by the adapter's serial number, and opened for this programme alone.

What a port said, in words, where it was not what its driver knows: which other device speaks so.

Recognises what palpate itself can drive, and a modem or cable that sends back what it is sent.
"""

from __future__ import annotations

import os
import re
import select
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from palpate.core import DeviceError
from palpate.core.optional_imports import require
from palpate.rig.real.device_hold import DeviceHold, hold_device, port_named

READ_S = 0.05  # how long one read waits, and so how soon its thread sees that it must end
WRITE_S = 1.0  # longest time in which a port takes no byte


@runtime_checkable
class SerialPort(Protocol):
    """Serial port, as far as a driver needs it; `serial.Serial` is one."""

    @property
    def in_waiting(self) -> int: ...
    def read(self, size: int = 1, /) -> bytes: ...  # none after a short wait
    def write(self, data: bytes, /) -> int | None: ...
    def close(self) -> None: ...


class HeldPort:
    """A port that is given back, for others to open, as it is closed."""

    def __init__(self, port: SerialPort, held: DeviceHold) -> None:
        self._port, self._held = port, held
        self.read = port.read

    def write(self, data: bytes) -> int | None:
        """Write all of some bytes, and return how many were taken.

        A write counts as late only if the port takes nothing for `WRITE_S`. pyserial also raises where this
        computer stood still for as long, although all bytes have gone.
        """
        handle = getattr(self._port, "fd", None)
        if os.name != "posix" or handle is None:
            return self._port.write(data)
        left = memoryview(data)
        while left:
            try:
                left = left[os.write(handle, left) :]
            except BlockingIOError:
                if not select.select([], [handle], [], WRITE_S)[1]:
                    raise TimeoutError(f"no byte was taken for {WRITE_S:g} s") from None
        return len(data)

    @property
    def in_waiting(self) -> int:
        """Bytes that have come and were not read."""
        return self._port.in_waiting

    def close(self) -> None:
        """Close the port. Closing again does nothing."""
        try:
            self._port.close()
        finally:
            self._held.release()


def open_port(name: str, baud: int, *, dtr: bool = False, frame: str = "8N1") -> SerialPort:
    """Open a port for this programme alone.

    Args:
        name: a path, or the serial number of a USB adapter.
        baud: bits a second.
        dtr: raise the DTR line, which resets many boards.
        frame: data bits, parity (N, E or O) and stop bits.

    Raises:
        DeviceError: there is no such port, or another process has it; says which.
    """
    serial = _serial("serial")
    path = find_port(name)
    held = hold_device(port_named(path))
    try:
        return HeldPort(_opened(serial, path, baud, dtr=dtr, frame=frame), held)
    except BaseException:
        held.release()
        raise


def _opened(serial: Any, path: str, baud: int, *, dtr: bool, frame: str) -> SerialPort:
    port = serial.Serial(
        port=None,
        baudrate=baud,
        bytesize=int(frame[0]),
        parity=frame[1],
        stopbits=int(frame[2]),
        timeout=READ_S,
        write_timeout=WRITE_S,
        exclusive=True if os.name == "posix" else None,
        dsrdtr=False,
    )
    port.dtr = dtr  # before it is opened: afterwards the edge has been seen
    port.port = path
    try:
        port.open()
    except (serial.SerialException, OSError, ValueError) as error:
        if "lock" in str(error) or "PermissionError" in str(error):
            raise DeviceError(f"port {path} is in use by another programme; close that one first") from error
        raise DeviceError(f"port {path} could not be opened ({error}); {_listed()}") from error
    return port


def find_port(name: str) -> str:
    """The path of a port.

    Args:
        name: a path, or the serial number of a USB adapter.
    """
    if os.sep in name and Path(name).exists():
        return name
    ports = _ports()
    matching = [port.device for port in ports if name in (port.device, port.serial_number)]
    if len(matching) == 1:
        return matching[0]
    if matching:
        raise DeviceError(f"{name!r} fits {', '.join(matching)}; name one by its path", code="port-ambiguous")
    raise DeviceError(
        f"there is no port {name!r}, by path or by serial number; {_listed()}", code="port-not-found"
    )


def _listed() -> str:
    ports = _ports()
    if not ports:
        return "no serial port is to be seen; is it plugged in, and may you use it?"
    known = ", ".join(f"{port.device} (serial number {port.serial_number or 'none'})" for port in ports)
    return f"the ports are {known}"


def _ports() -> list[Any]:
    return sorted(
        _serial("serial.tools.list_ports").comports(),
        key=lambda port: port.device,
    )


def _serial(module: str) -> Any:
    return require(module, "A device on a serial port")


KEPT_BYTES = 400  # of what was heard last
SHOWN = 60  # characters
_GRBL = re.compile(rb"grbl(?:hal)? \d|<(?:Idle|Alarm|Run|Jog|Hold|Door|Check|Home|Sleep)\b", re.IGNORECASE)
_GRBL_ERROR = re.compile(rb"^error:\d{1,3}\r?$", re.MULTILINE)
_MARLIN = re.compile(rb"marlin|echo:|FIRMWARE_NAME|^start\r?$| Count X:", re.IGNORECASE | re.MULTILINE)
_WEIGHT = re.compile(rb"[A-Z, ]*[-+]? *\d+(?:\.\d+)? *[A-Za-z]{0,3} *")


class HeardTail:
    """The last bytes that were heard, and the last that were sent."""

    def __init__(self) -> None:
        self.heard, self.sent = b"", b""

    def hear(self, data: bytes) -> None:
        """Keep what came."""
        self.heard = (self.heard + data)[-KEPT_BYTES:]

    def send(self, data: bytes) -> None:
        """Keep what went out."""
        self.sent = (self.sent + data)[-KEPT_BYTES:]

    def in_words(self) -> str:
        """Words for what it said, and for who speaks so."""
        return describe_heard(self.heard, self.sent)


def describe_heard(heard: bytes, sent: bytes = b"") -> str:
    r"""Say what was heard, and who speaks so.

    Args:
        heard: the last bytes that came.
        sent: the last that were sent before.

    Example:
        >>> print(describe_heard(b"Grbl 1.1h ['$' for help]\r\n"))
        it said "Grbl 1.1h ['$' for help]": that is a GRBL controller
        >>> describe_heard(b"")
        'it said nothing'
    """
    if not heard.strip(b"\0\r\n \t"):
        return "it said nothing"
    who = _speaker(heard, sent)
    lines = [line for line in heard.replace(b"\r", b"\n").split(b"\n") if line.strip()]
    text = lines[-1].decode("ascii", "backslashreplace").strip()
    shown = text if len(text) <= SHOWN else text[:SHOWN] + "..."
    return f"it said {shown!r}{f': that is {who}' if who else ''}"


def _speaker(heard: bytes, sent: bytes) -> str:
    if _GRBL.search(heard) or _GRBL_ERROR.search(heard):
        return "a GRBL controller"
    if _MARLIN.search(heard):
        return "a Marlin controller"
    if sent and _without_ends(heard) in _without_ends(sent):
        return "what it was sent: a modem or a bridged cable sends it back"
    lines = [
        line for line in heard.replace(b"\r", b"\n").split(b"\n")[1:] if line.strip()
    ]  # the first is cut
    if any(_WEIGHT.fullmatch(line) for line in lines[-3:]):
        return "a scale, or another device that prints numbers"
    if any(byte >= 0x80 for byte in heard):
        return "no plain text: another baud rate, or another device"
    return ""


def _without_ends(data: bytes) -> bytes:
    return data.replace(b"\r", b"").replace(b"\n", b"")
