"""List of the cameras of this machine: name, USB serial number, path, sizes and rates, and who uses each.

On Linux it asks the system's own files and each camera by Video4Linux 2 (videodev2.h of the kernel's
user-space API, https://docs.kernel.org/userspace-api/media/v4l/videodev.html). Asking needs the right to open
the camera, and does not disturb whoever films with it.
"""

from __future__ import annotations

import importlib
import os
import re
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from palpate.core import RecordingError, lock
from palpate.devices.rpc import path_of
from palpate.rig.real.device_hold import MAX_HOLDER, camera_named

MAX_ENTRIES = 64  # of formats, sizes and rates each, that are asked for
CAN_CAPTURE = 0x00000001
HAS_DEVICE_CAPS = 0x80000000
CAPTURE = 1  # type of buffer
DISCRETE = 1  # kind of size or interval; others are ranges

Ioctl = Callable[[int, int, bytearray], Any]


@dataclass(frozen=True, slots=True)
class CameraMode:
    """One size of one format, and the rates that it comes at.

    Attributes:
        pixels: how they travel, as four letters: "MJPG", "YUYV".
        size_px: (width, height) [px]; the greatest where the camera offers a range.
        rates_hz: frames a second, the fastest first [Hz]; empty where the camera does not tell.
    """

    pixels: str
    size_px: tuple[int, int]
    rates_hz: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ListedCamera:
    """A camera of this machine.

    Attributes:
        path: such as ``/dev/video0``.
        name: that it tells of itself.
        serial: USB serial number, by which palpate finds it whatever port it is in; "" where it has none.
        usb_id: vendor and product, such as "046d:0825"; "" where it is not on USB.
        driver: of the system.
        modes: sizes and rates; empty where it could not be asked.
        used_by: who films with it, in words; "" where nobody is known to.
        advice: what keeps palpate from using it and what to do; "" where nothing does.
        udev: rule that lets everybody in group video use it under a name of its own; "" without a USB id.
    """

    path: str
    name: str
    serial: str = ""
    usb_id: str = ""
    driver: str = ""
    modes: tuple[CameraMode, ...] = ()
    used_by: str = ""
    advice: str = ""
    udev: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def _ioctl(handle: int, number: int, data: bytearray) -> Any:
    import fcntl

    return fcntl.ioctl(handle, number, data)


@dataclass(frozen=True)
class VideoSystem:
    """Folders in which Linux lists its cameras, and how one is asked; tests give others.

    Attributes:
        classes: a folder for each video device.
        devices: folder of the devices' files.
        processes: a folder for each process.
        ioctl: asks an open device.
    """

    classes: Path = Path("/sys/class/video4linux")
    devices: Path = Path("/dev")
    processes: Path = Path("/proc")
    ioctl: Ioctl = field(default=_ioctl)


def list_cameras(system: VideoSystem | None = None) -> tuple[ListedCamera, ...]:
    """Cameras of this machine, by their paths; none on a system that does not list them."""
    at = system or VideoSystem()
    if not at.classes.is_dir():
        return ()
    names = [path.name for path in at.classes.iterdir() if re.fullmatch(r"video\d+", path.name)]
    listed = (_listed(at, name) for name in sorted(names, key=lambda name: int(name[5:])))
    return tuple(one for one in listed if one is not None)


def how_listed() -> str:
    """What a system that lists no cameras leaves to do, in words; "" on Linux."""
    if sys.platform == "linux":
        return ""
    return (
        f"on {sys.platform} cameras are not listed: they are opened by their number, so try --camera 0, "
        "then 1; their serial numbers are known on Linux alone"
    )


def _listed(at: VideoSystem, name: str) -> ListedCamera | None:
    """One device; None where it is no camera, as the second device of most is not."""
    path, about = at.devices / name, _usb_facts(at.classes / name)
    told = _text(at.classes / name / "name") or name
    vendor, product, serial = (about.get(key, "") for key in ("idVendor", "idProduct", "serial"))
    usb_id = f"{vendor}:{product}" if vendor else ""
    common: dict[str, Any] = {"serial": serial, "usb_id": usb_id, "udev": _udev_rule(vendor, product, serial)}
    common["used_by"] = _used_by(at, path)
    try:
        handle = os.open(path, os.O_RDWR | getattr(os, "O_NONBLOCK", 0))
    except PermissionError:
        return ListedCamera(str(path), told, **common, advice=_rights(path))
    except OSError as e:
        return ListedCamera(str(path), told, **common, advice=f"it cannot be opened: {e.strerror or e}")
    try:
        driver, card, can = _capabilities(at.ioctl, handle)
        if not can & CAN_CAPTURE:
            return None
        return ListedCamera(str(path), card or told, **common, driver=driver, modes=_modes(at.ioctl, handle))
    except OSError as e:
        return ListedCamera(str(path), told, **common, advice=f"it does not answer: {e.strerror or e}")
    finally:
        os.close(handle)


def _usb_facts(device: Path) -> dict[str, str]:
    """Vendor, product and serial number of the USB device that a video device belongs to."""
    with suppress(OSError):
        folder = (device / "device").resolve()
        for parent in (folder, *folder.parents):
            if (parent / "idVendor").is_file():
                return {key: _text(parent / key) for key in ("idVendor", "idProduct", "serial")}
    return {}


def _text(path: Path) -> str:
    with suppress(OSError):
        return path.read_text(errors="replace").strip()
    return ""


def _udev_rule(vendor: str, product: str, serial: str) -> str:
    if not vendor:
        return ""
    of_serial = f', ATTRS{{serial}}=="{serial}"' if serial else ""
    link = re.sub("[^A-Za-z0-9]+", "-", serial or f"{vendor}-{product}")
    return (
        f'SUBSYSTEM=="video4linux", ATTR{{index}}=="0", ATTRS{{idVendor}}=="{vendor}", '
        f'ATTRS{{idProduct}}=="{product}"{of_serial}, GROUP="video", MODE="0660", SYMLINK+="palpate-{link}"'
    )


def _rights(path: Path) -> str:
    group = "video"
    with suppress(ImportError, OSError, KeyError):
        group = importlib.import_module("grp").getgrgid(path.stat().st_gid).gr_name
    return f"you may not open it: sudo usermod -aG {group} $USER, then log in anew"


def _used_by(at: VideoSystem, path: Path) -> str:
    """Whoever films with it: a process of palpate by its hold, any other by its open files."""
    held = _held_by(path)
    if held:
        return held
    names = [*at.processes.glob("[0-9]*/fd/*")] if at.processes.is_dir() else []
    for link in names:
        with suppress(OSError):
            if os.readlink(link) == str(path) and link.parts[-3] != str(os.getpid()):
                return f"process {link.parts[-3]} ({_text(link.parents[1] / 'comm')})"
    return ""


def _held_by(path: Path) -> str:
    file = path_of(f"held {camera_named(str(path))}", None, "lock")
    if not file.is_file():
        return ""
    try:
        lock(file).close()
    except RecordingError:
        return _text(file)[:MAX_HOLDER]
    return ""


def _number(nr: int, size: int, *, both: bool) -> int:
    """Number of a request of Video4Linux, of type "V": direction, size, type, number."""
    return ((3 if both else 2) << 30) | (size << 16) | (ord("V") << 8) | nr


CAPABILITY = struct.Struct("<16s32s32s6I")  # driver, card, bus, version, capabilities, of this device, 3 free
FORMAT = struct.Struct("<3I32s5I")  # index, type, flags, description, pixels, bus code, 3 free
SIZE = struct.Struct("<11I")  # index, pixels, kind; width, height, or least, greatest, step of both; 2 free
INTERVAL = struct.Struct("<13I")  # index, pixels, width, height, kind; fraction, or three of them; 2 free
QUERY_CAPABILITIES = _number(0, CAPABILITY.size, both=False)
LIST_FORMATS = _number(2, FORMAT.size, both=True)
LIST_SIZES = _number(74, SIZE.size, both=True)
LIST_INTERVALS = _number(75, INTERVAL.size, both=True)


def _capabilities(ioctl: Ioctl, handle: int) -> tuple[str, str, int]:
    """Driver, name and what the device can do."""
    data = bytearray(CAPABILITY.size)
    ioctl(handle, QUERY_CAPABILITIES, data)
    driver, card, _, _, all_can, device_can, *_ = CAPABILITY.unpack(data)
    can = device_can if all_can & HAS_DEVICE_CAPS else all_can
    return _words(driver), _words(card), can


def _modes(ioctl: Ioctl, handle: int) -> tuple[CameraMode, ...]:
    modes = []
    for asked in _each(ioctl, handle, LIST_FORMATS, FORMAT, lambda i: (i, CAPTURE, 0, b"", *[0] * 5)):
        code = asked[4]
        pixels = code.to_bytes(4, "little").decode("ascii", "replace").strip()
        for size in _each(ioctl, handle, LIST_SIZES, SIZE, partial(_size_asked, code)):
            width, height = (size[3], size[4]) if size[2] == DISCRETE else (size[4], size[7])
            modes.append(CameraMode(pixels, (width, height), _rates(ioctl, handle, code, width, height)))
            if size[2] != DISCRETE:
                break
    return tuple(modes)


def _size_asked(code: int, index: int) -> tuple[int, ...]:
    return (index, code, *[0] * 9)


def _rates(ioctl: Ioctl, handle: int, code: int, width: int, height: int) -> tuple[float, ...]:
    rates = []
    first = (code, width, height)
    for found in _each(ioctl, handle, LIST_INTERVALS, INTERVAL, lambda i: (i, *first, *[0] * 9)):
        over, under = found[5], found[6]  # of an interval [s]: the shortest, where it is a range
        if over:
            rates.append(round(under / over, 3))
        if found[4] != DISCRETE:
            break
    return tuple(sorted(set(rates), reverse=True))


def _each(
    ioctl: Ioctl, handle: int, number: int, layout: struct.Struct, asked: Callable[[int], tuple[Any, ...]]
) -> Iterator[tuple[Any, ...]]:
    """Entries of a list of the camera's, until it says that there are no more."""
    for index in range(MAX_ENTRIES):
        data = bytearray(layout.pack(*asked(index)))
        try:
            ioctl(handle, number, data)
        except OSError:
            return
        yield layout.unpack(data)


def _words(data: bytes) -> str:
    return data.split(b"\0", 1)[0].decode("utf-8", "replace").strip()
