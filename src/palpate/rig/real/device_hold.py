"""Holds on devices: one process at a time has a serial port, a Net F/T box or a camera, by whatever name.

Two names of one port, such as its path and its adapter's serial number, end in one device; the hold is on
that. The system drops it when its process ends, also when that was killed.
"""

from __future__ import annotations

import os
import re
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from palpate.core import DeviceError, RecordingError, StorageError, lock, storage_errors
from palpate.devices.rpc import path_of

MAX_HOLDER = 200  # bytes that the holder says of itself


class DeviceHeldError(DeviceError):
    """Another process holds the device.

    Attributes:
        pid: of that process; None where it is not known, or is this one.
    """

    def __init__(self, message: str, pid: int | None = None) -> None:
        super().__init__(message)
        self.pid = pid


class DeviceHold:
    """The right to be the only process that has a device, until it is released or the process ends."""

    def __init__(self, file: BinaryIO | None) -> None:
        self._file = file

    def release(self) -> None:
        """Give the right back. Doing it again does nothing."""
        file, self._file = self._file, None
        if file is not None:
            with suppress(OSError):
                file.truncate(0)
            file.close()


def hold_device(device: str, folder: Path | None = None) -> DeviceHold:
    """Hold a device.

    Args:
        device: what it is, in words that are the same in every process, such as "port /dev/ttyACM0".
        folder: of the lock's file; left out, the user's own.

    Raises:
        DeviceHeldError: another process, or this one, holds it; says which.
    """
    path = None
    try:
        path = path_of(f"held {device}", folder, "lock")
        with storage_errors(path):
            path.touch(mode=0o600)
        file = lock(path)
    except RecordingError as e:
        assert path is not None  # as lock() found it
        holder = _holder(path)
        said = re.match(r"process (\d+) ", holder)
        pid = int(said[1]) if said else None
        raise DeviceHeldError(f"{device} is in use by {holder}; end that one first", pid) from e
    except StorageError:  # a full disk must not keep anybody from stopping a stage
        return DeviceHold(None)
    with suppress(OSError):
        file.truncate(0)
        file.write(_myself().encode())
        file.flush()
    return DeviceHold(file)


def port_named(path: str) -> str:
    """A serial port, by its path without links."""
    return f"port {path.upper() if os.name == 'nt' else os.path.realpath(path)}"


def box_named(host: str, port: int) -> str:
    """A box in the network, by its number and not its name."""
    with suppress(OSError, ValueError):  # also of a name that cannot be written as one
        host = socket.gethostbyname(host)
    return f"Net F/T box {host}, UDP port {port}"


def arm_named(host: str) -> str:
    """An arm in the network, by its number and not its name."""
    with suppress(OSError, ValueError):
        host = socket.gethostbyname(host)
    return f"arm {host}"


def camera_named(where: str | int) -> str:
    """A camera, by its path without links."""
    path = f"/dev/video{where}" if isinstance(where, int) and sys.platform == "linux" else str(where)
    return f"camera {os.path.realpath(path) if os.sep in path else path}"


def _myself() -> str:
    words = [Path(sys.argv[0] or "python").name, *sys.argv[1:3]]
    return f"process {os.getpid()} ({' '.join(words)})"[:MAX_HOLDER]


def _holder(path: Path) -> str:
    with suppress(OSError):
        text = path.read_bytes()[:MAX_HOLDER].decode("utf-8", "replace")
        if text.startswith(f"process {os.getpid()} "):
            return "this programme itself: two devices of the rig name it"
        if text:
            return text
    return "another process"
