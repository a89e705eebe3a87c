"""Sources that a page may open: devices, virtual sensors, and what lies in the workspace."""

from __future__ import annotations

import re
import stat
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from palpate.core import InputError
from palpate.studio.library.workspace import OutsideError, Workspace

VIRTUAL = {
    "virtual:palm": "virtual palm",
    "virtual:tactip": "virtual TacTip",
    "virtual:nusense": "virtual NUSense",
    "virtual:tactip/S1=7.6": "virtual TacTip on a body of 7.6 N/mm",
}
PREFIX = "virtual:"
MAX_DIGITS = 2  # of a camera's number
CAMERA_FILE = re.compile(r"/dev/video\d+")
PORT_FILE = re.compile(r"/dev/(tty|cu|pts/|rfcomm).*")

Cameras = Callable[[], Mapping[str, str]]


def plugged_in() -> Mapping[str, str]:
    """Cameras of this machine by address: their serial number where they have one, in words."""
    from palpate.rig.real.camera_listing import list_cameras

    found = {}
    for one in list_cameras():
        used = f", in use by {one.used_by}" if one.used_by else ""
        found[one.serial or one.path] = f"{one.name} ({one.serial or one.path}{used})"
    return found


def is_device(source: str, cameras: Cameras = plugged_in) -> bool:
    """Whether an address is a virtual sensor, or a camera of this machine and no other file."""
    if source.startswith(PREFIX) or source == "picamera2":
        return True
    if source.isascii() and source.isdecimal():
        return len(source) <= MAX_DIGITS
    return _is_device_file(source, CAMERA_FILE) or source in cameras()


def source_options(workspace: Workspace, source: str, cameras: Cameras = plugged_in) -> dict[str, Any]:
    """Options of a live process for a source that was chosen or typed on a page."""
    if is_device(source, cameras):
        return {"camera": source}
    path = workspace.resolve(source)
    if not path.exists():
        raise OutsideError(
            f"{source[:80]!r} is no camera, virtual sensor, or path in the workspace. Choose one of the list."
        )
    played = {"paced": True, "repeat": True} if source in workspace.found("run") else {}
    return {"camera": str(path), **played}


def check_devices(camera: str, scale: str, cameras: Cameras = plugged_in) -> None:
    """Refuse what a first session must not open: a camera or a scale that is a file or a network address."""
    if not is_device(camera, cameras):
        raise InputError(f"{camera[:80]!r} is no camera. Choose one from the list, or type its number.")
    if re.search(r"[/\\]", scale) and not _is_device_file(scale, PORT_FILE):  # else a word, name, or number
        raise InputError(f"{scale[:80]!r} is no serial port. Choose one from the list, or type its path.")


def _is_device_file(text: str, kind: re.Pattern[str]) -> bool:
    """Whether a path leads to a device file of a kind, through links as well."""
    if not text.startswith("/dev/"):
        return False
    try:
        path = Path(text).resolve(strict=True)
        return bool(kind.fullmatch(str(path))) and stat.S_ISCHR(path.stat().st_mode)
    except (OSError, ValueError, RuntimeError):
        return False
