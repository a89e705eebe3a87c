"""Cameras of the machine: what each tells by Video4Linux, who uses it, and what keeps palpate from it."""

import errno
import os
import struct
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from tests.refusals import refused

from palpate.core.errors import DeviceError
from palpate.devices.rpc import path_of
from palpate.rig.real import camera_listing
from palpate.rig.real.camera_listing import VideoSystem, list_cameras
from palpate.rig.real.device_hold import camera_named, hold_device
from palpate.rig.real.uvc_camera import refuse_absent

MJPG = int.from_bytes(b"MJPG", "little")
YUYV = int.from_bytes(b"YUYV", "little")
SIZES = {MJPG: [(1280, 720), (640, 480)], YUYV: [(640, 480)]}
INTERVALS = {(1280, 720): [(1, 30)], (640, 480): [(1, 60), (1, 30), (1001, 30000)]}


def camera_says(handle: int, number: int, data: bytearray) -> int:
    """A camera's driver, written after the kernel's own header."""
    kind, size = number & 0xFFFF, number >> 16 & 0x3FFF
    assert size == len(data)
    if kind == 0x5600:
        can = struct.pack("<II", 0x84A00001, 0x04200001)
        data[:] = (
            b"uvcvideo".ljust(16, b"\0")
            + b"Tip camera".ljust(32, b"\0")
            + bytes(32)
            + bytes(4)
            + can
            + bytes(12)
        )
        return 0
    index, code = struct.unpack_from("<II", data)
    if kind == 0x5602:
        formats = [MJPG, YUYV]
        if index >= len(formats):
            raise OSError(errno.EINVAL, "no more")
        struct.pack_into("<I", data, 44, formats[index])
    elif kind == 0x564A:
        if index >= len(SIZES[code]):
            raise OSError(errno.EINVAL, "no more")
        struct.pack_into("<III", data, 8, 1, *SIZES[code][index])
    elif kind == 0x564B:
        intervals = INTERVALS[struct.unpack_from("<II", data, 8)]
        if index >= len(intervals):
            raise OSError(errno.EINVAL, "no more")
        struct.pack_into("<III", data, 16, 1, *intervals[index])
    return 0


@pytest.fixture
def system(tmp_path, monkeypatch) -> VideoSystem:
    """One USB camera, as the system's folders show it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    (tmp_path / "run").mkdir()
    usb = tmp_path / "usb" / "1-2"
    (usb / "1-2:1.0").mkdir(parents=True)
    for name, text in (("idVendor", "046d"), ("idProduct", "0825"), ("serial", "4B2D")):
        (usb / name).write_text(text + "\n")
    for name in ("video0", "video10", "video2"):
        folder = tmp_path / "class" / name
        folder.mkdir(parents=True)
        (folder / "name").write_text(f"the {name}\n")
        (folder / "device").symlink_to(usb / "1-2:1.0")
        (tmp_path / "dev").mkdir(exist_ok=True)
        (tmp_path / "dev" / name).touch()
    (tmp_path / "class" / "v4l-subdev0").mkdir()
    (tmp_path / "proc").mkdir()
    return VideoSystem(tmp_path / "class", tmp_path / "dev", tmp_path / "proc", camera_says)


def test_a_camera_tells_name_serial_sizes_and_rates(system) -> None:
    first, second, third = list_cameras(system)
    assert [Path(one.path).name for one in (first, second, third)] == ["video0", "video2", "video10"]
    assert (first.name, first.serial, first.usb_id) == ("Tip camera", "4B2D", "046d:0825")
    assert (first.driver, first.used_by, first.advice) == ("uvcvideo", "", "")
    assert [(mode.pixels, mode.size_px, mode.rates_hz) for mode in first.modes] == [
        ("MJPG", (1280, 720), (30.0,)),
        ("MJPG", (640, 480), (60.0, 30.0, 29.97)),
        ("YUYV", (640, 480), (60.0, 30.0, 29.97)),
    ]
    assert 'ATTRS{serial}=="4B2D"' in first.udev
    assert 'SYMLINK+="palpate-4B2D"' in first.udev


def test_the_requests_are_those_of_the_kernel_s_header() -> None:
    numbers = ("QUERY_CAPABILITIES", "LIST_FORMATS", "LIST_SIZES", "LIST_INTERVALS")
    assert [hex(getattr(camera_listing, name)) for name in numbers] == [
        "0x80685600",
        "0xc0405602",
        "0xc02c564a",
        "0xc034564b",
    ]


@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone has files of cameras")
def test_a_camera_that_is_not_there_is_refused_with_those_that_are(system, tmp_path) -> None:
    with refused("camera-not-found", DeviceError, match="video0"):
        refuse_absent(7, system)
    refuse_absent(2, system)
    refuse_absent(str(system.devices / "video10"), system)
    bare = replace(system, classes=tmp_path / "none")
    with refused("camera-not-found", DeviceError):
        refuse_absent(str(tmp_path / "video2"), bare)


def test_whoever_uses_a_camera_is_named(system) -> None:
    path = system.devices / "video2"
    folder = system.processes / "4321" / "fd"
    folder.mkdir(parents=True)
    (folder / "7").symlink_to(path)
    (system.processes / "4321" / "comm").write_text("cheese\n")
    assert ["4321" in one.used_by for one in list_cameras(system)] == [False, True, False]
    held = hold_device(camera_named(str(path)))
    assert str(os.getpid()) in list_cameras(system)[1].used_by
    held.release()
    assert "4321" in list_cameras(system)[1].used_by
    assert path_of(f"held {camera_named(str(path))}", None, "lock").is_file()
