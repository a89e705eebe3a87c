"""Check of this machine: what palpate needs and may use, what is missing, and how each is mended."""

from __future__ import annotations

import importlib
import os
import platform
import re
import shutil
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, distribution, metadata, requires
from pathlib import Path
from typing import Any, Literal

from palpate.core import PalpateError
from palpate.core.errors import MissingExtraError
from palpate.core.optional_imports import require
from palpate.devices.rpc import folder_of
from palpate.rig.real.camera_listing import ListedCamera, how_listed, list_cameras

Verdict = Literal["ok", "missing", "broken"]
PYTHON = (3, 11), (3, 14)  # from the first, up to and without the second
MIN_MEMORY_GB = 2.0
MIN_DISK_GB = 1.0
NEEDED_LIBRARIES = ("numpy", "cv2", "onnxruntime")
EXTRAS_FOR = {
    "cluster": "spread parameter sweeps over machines",
    "haptic-arm": "drive a Force Dimension arm",
    "parquet": "read and write Parquet tables",
    "picamera2": "film with a Raspberry Pi's camera",
    "rig": "talk to serial ports: scales, stages, force sensors",
    "studio": "serve the pages of `palpate studio`",
    "train": "train networks; kernel-ridge needs none",
    "ur": "drive a UR arm",
}


@dataclass(frozen=True, slots=True)
class MachinePart:
    """One inspected part of the installation.

    Attributes:
        state: "missing" is optional, "broken" is required.
        mend: remedy; empty for none.
    """

    name: str
    state: Verdict
    detail: str
    mend: str = ""

    def to_dict(self) -> dict[str, str]:
        return asdict(self)


def check_machine(folder: Path | None = None) -> tuple[MachinePart, ...]:
    """Inspect all that palpate needs or may use.

    Args:
        folder: working folder, for its free disk space; the current one by default.
    """
    return (
        _python(),
        *(_library(name) for name in NEEDED_LIBRARIES),
        _requirements(),
        _cores(),
        _memory(),
        _disk(folder or Path.cwd()),
        _runtime(),
        *_cameras(list_cameras()),
        *_ports(),
        *(_extra(name, sentence) for name, sentence in EXTRAS_FOR.items()),
    )


def _python() -> MachinePart:
    found, (first, beyond) = sys.version_info[:2], PYTHON
    told = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    if first <= found < beyond:
        return MachinePart("Python", "ok", told)
    span = f"{first[0]}.{first[1]} to {beyond[0]}.{beyond[1] - 1}"
    return MachinePart("Python", "broken", told, f"install Python {span} and palpate in it")


def _library(name: str) -> MachinePart:
    try:
        module = importlib.import_module(name)
    except Exception as e:  # a library may fail to load in any way
        return MachinePart(
            name,
            "broken",
            f"cannot be loaded: {type(e).__name__}: {e}",
            "pip install --force-reinstall palpate",
        )
    return MachinePart(name, "ok", str(getattr(module, "__version__", "loaded")))


def _requirements() -> MachinePart:
    try:
        wanted = [_package(text) for text in requires("palpate") or () if "extra ==" not in text]
    except PackageNotFoundError:
        return MachinePart("packages", "missing", "palpate is not installed, but run from its source")
    gone = [name for name in wanted if not _installed(name)]
    if gone:
        return MachinePart(
            "packages", "broken", f"missing: {', '.join(gone)}", f"pip install {' '.join(gone)}"
        )
    return MachinePart("packages", "ok", f"{len(wanted)} of {len(wanted)} that palpate needs")


def _package(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    return found[0] if found else requirement


def _installed(name: str) -> bool:
    with suppress(PackageNotFoundError):
        distribution(name)
        return True
    return False


def _cores() -> MachinePart:
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    told = f"{allowed} of {os.cpu_count()}"
    if allowed >= 2:
        return MachinePart("cores", "ok", told)
    return MachinePart("cores", "ok", told, "one core reads one sensor; for a page beside it, allow two")


def _memory() -> MachinePart:
    total_gb, free_gb = memory_gb()
    if total_gb is None:
        return MachinePart("memory", "ok", "not told by this system")
    told = f"{total_gb:.1f} GB" + ("" if free_gb is None else f", {free_gb:.1f} GB free")
    if total_gb >= MIN_MEMORY_GB:
        return MachinePart("memory", "ok", told)
    return MachinePart("memory", "ok", told, f"{MIN_MEMORY_GB:g} GB or more are needed to calibrate")


def memory_gb() -> tuple[float | None, float | None]:
    """Return total and free memory of the machine [GB]; None where the system does not report it."""
    with suppress(OSError, ValueError):
        text = Path("/proc/meminfo").read_text()
        kb = {key: int(value) for key, value in re.findall(r"^(\w+):\s+(\d+) kB", text, re.MULTILINE)}
        return kb["MemTotal"] / 1e6, kb.get("MemAvailable", 0) / 1e6
    with suppress(AttributeError, OSError, ValueError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, None
    return None, None


def _disk(folder: Path) -> MachinePart:
    free_gb = shutil.disk_usage(folder).free / 1e9
    told = f"{free_gb:.1f} GB free here"
    if free_gb >= MIN_DISK_GB:
        return MachinePart("disk", "ok", told)
    return MachinePart("disk", "missing", told, "make room: an hour of a small camera is about 10 GB")


def _runtime() -> MachinePart:
    try:
        home = folder_of()
    except PalpateError as e:
        return MachinePart(
            "own folder", "broken", str(e), "set XDG_RUNTIME_DIR to a folder that you may write"
        )
    if os.access(home, os.W_OK):
        return MachinePart("own folder", "ok", str(home))
    return MachinePart("own folder", "broken", f"{home} cannot be written", f"sudo chown $USER {home}")


def _cameras(listed: tuple[ListedCamera, ...]) -> list[MachinePart]:
    if not listed:
        mend = how_listed() or "plug one in, or begin without one: palpate live --camera virtual:palm"
        return [MachinePart("cameras", "missing", "none is to be seen", mend)]
    return [_camera(one) for one in listed]


def _camera(one: ListedCamera) -> MachinePart:
    name = f"camera {one.path}"
    serial = f"serial number {one.serial}" if one.serial else "without a serial number: give its path"
    if one.advice:
        return MachinePart(name, "missing", f"{one.name}, {serial}", one.advice)
    used = f", in use by {one.used_by}" if one.used_by else ""
    return MachinePart(name, "ok", f"{one.name}, {serial}{used}")


def _ports() -> list[MachinePart]:
    found = _port_names()
    parts = [_port(path, about) for path, about in found]
    return parts or [
        MachinePart("serial ports", "missing", "none is to be seen", "needed by a rig or a scale alone")
    ]


def _port_names() -> list[tuple[str, str]]:
    try:
        listed = require("serial.tools.list_ports", "The list of serial ports").comports()
    except MissingExtraError:
        patterns = ("ttyACM*", "ttyUSB*", "cu.usb*")
        return [(str(path), "") for pattern in patterns for path in sorted(Path("/dev").glob(pattern))]
    return sorted((port.device, port.serial_number or "") for port in listed if port.hwid != "n/a")


def _port(path: str, serial: str) -> MachinePart:
    told = f"serial number {serial}" if serial else "no serial number"
    if os.name == "nt" or os.access(path, os.R_OK | os.W_OK):
        return MachinePart(f"port {path}", "ok", told)
    return MachinePart(
        f"port {path}",
        "missing",
        f"{told}; you may not open it",
        f"sudo usermod -aG {_group(path)} $USER, then log in",
    )


def _group(path: str) -> str:
    with suppress(ImportError, OSError, KeyError):
        return str(importlib.import_module("grp").getgrgid(Path(path).stat().st_gid).gr_name)
    return "dialout"


def _extra(name: str, sentence: str) -> MachinePart:
    try:
        texts = requires("palpate") or ()
        known = metadata("palpate").get_all("Provides-Extra") or ()
    except PackageNotFoundError:
        texts, known = (), ()
    wanted = [_package(text) for text in texts if re.search(rf"extra == ['\"]{re.escape(name)}['\"]", text)]
    gone = [one for one in wanted if not _installed(one)]
    if name in known and not gone:
        return MachinePart(f"extra {name}", "ok", sentence)
    return MachinePart(f"extra {name}", "missing", sentence, f"pip install 'palpate[{name}]'")


def machine_text(parts: tuple[MachinePart, ...]) -> str:
    """Return the parts as lines, each with its remedy."""
    width = max(len(part.name) for part in parts)
    lines: list[Any] = []
    for part in parts:
        lines.append(f"{part.state:8}{part.name:{width}}  {part.detail}")
        if part.mend:
            lines.append(f"{'':8}{'':{width}}  -> {part.mend}")
    return "\n".join(lines)
