"""What the studio's server keeps of live sensors: who is asked, and the last seconds of what each told.

The sensors belong to processes of their own: this desk only listens, and passes on what a page asks for.

Sources that a page may open: devices, virtual sensors, and what lies in the workspace.
"""

from __future__ import annotations

import math
import re
import stat
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from palpate.core import Closing, DeviceError, InputError, PalpateError
from palpate.core.shared_history import SharedHistory
from palpate.studio.library.workspace import OutsideError, Workspace
from palpate.studio.live.reading_rows import force_beside

SPAN_S = 20.0
"""Length of what is plotted [s]."""
MAX_SAMPLES = 1200
PREFIX = "live "  # of the names of their processes
MAX_SENSORS = 8
MAX_NAME = 200
LISTEN_S = 0.04  # between two looks at what was told


@runtime_checkable
class LiveConnection(Protocol):
    """Connection to the process of one live sensor, as `LiveClient` is."""

    status: dict[str, Any] | None
    picture: tuple[int, bytes, tuple[int, int]] | None
    told_s: float | None

    def ask(self, do: str, **fields: Any) -> Any:
        """Ask for something, and wait for what came of it."""

    def close(self) -> None:
        """Go away; the process goes on."""


class NoConnection:
    """Stands for the connection to a live sensor whose process does not run."""

    status: dict[str, Any] | None = None
    picture: tuple[int, bytes, tuple[int, int]] | None = None
    told_s: float | None = None

    def ask(self, do: str, **fields: Any) -> Any:
        """Refuse."""
        raise DeviceError("This sensor is not being read. Begin it on the page Live.")

    def close(self) -> None:
        """Do nothing."""


@dataclass(frozen=True, slots=True)
class LiveSample:
    """Sample of a sensor's status.

    Attributes:
        at_s: Arrival, monotonic [s].
        frame_s: Frame time by the source's clock [s].
        readings: Plain values by column; empty for a frame that was sampled before.
        force_n: Force of a force sensor next to the camera; None without one [N].
    """

    at_s: float
    frame_s: float
    readings: Mapping[str, Mapping[str, Any]]
    force_n: float | None


EDGES = {"m": ("mm", 1e3), "rad": ("degrees", 180 / math.pi)}
"""Units in which lengths and angles are shown."""


def edge_readings(readings: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Readings with lengths in mm and angles in degrees, by columns of these units."""
    found: dict[str, Mapping[str, Any]] = {}
    for name, one in readings.items():
        unit = str(one.get("unit", ""))
        if unit not in EDGES:
            found[name] = one
            continue
        shown, times = EDGES[unit]
        scaled: dict[str, Any] = {k: _times(one.get(k), times) for k in ("value", "low", "high")}
        limits = one.get("range")
        scaled["range"] = None if limits is None else [_times(k, times) for k in limits]
        found[f"{name.removesuffix(f'_{unit}')}_{shown}"] = {**one, **scaled, "unit": shown}
    return found


def _times(value: float | None, times: float) -> float | None:
    return None if value is None else value * times


class LiveSensor:
    """A sensor that is listened to."""

    def __init__(self, name: str, connection: LiveConnection) -> None:
        self.name, self.connection = name, connection
        self._samples = SharedHistory[LiveSample](MAX_SAMPLES)
        self._serial = -1

    def listen(self, now_s: float) -> None:
        """Keep what was told since, and forget what is older than is plotted."""
        status = self.connection.status
        if status is not None and status.get("serial") != self._serial:
            self._serial = status.get("serial", -1)
            reading, force_n = status.get("reading"), force_beside(status)
            newest = self._samples.newest
            frame_s = float(reading["time_s"]) if reading else (newest.frame_s if newest else 0.0)
            read_anew = bool(reading) and (newest is None or frame_s != newest.frame_s)
            if read_anew or force_n is not None:
                # A frame that was read before is not read again: its curve ends until the next one.
                readings = edge_readings(reading["readings"]) if reading and read_anew else {}
                self._samples.append(LiveSample(now_s, frame_s, readings, force_n))
        self._samples.discard_while(lambda one: now_s - one.at_s > SPAN_S)

    @property
    def samples(self) -> list[LiveSample]:
        """Samples of the last `SPAN_S`, oldest first."""
        return self._samples.items()

    def age_s(self, now_s: float) -> float | None:
        """Since when nothing was told [s]; None where nothing ever was."""
        told_s = self.connection.told_s
        return None if told_s is None else max(now_s - told_s, 0.0)


def check_name(name: str) -> None:
    """Refuse what is no name of a live sensor's process: pages address no other process."""
    if not (name.startswith(PREFIX) and len(name) <= MAX_NAME and name.isprintable()):
        raise InputError(f"{name[:60]!r} is no live sensor. Begin one on the page Live.", code="unknown-name")


class LiveProcesses:
    """Processes of a workspace's live sensors.

    Args:
        folder: of their address files; None for the user's own.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder

    def connect(self, name: str) -> LiveConnection:
        """Connect to a process by its name, whether it runs or not."""
        from palpate.sensing.live_client import LiveClient

        return LiveClient(name, self._folder)

    def running(self) -> list[str]:
        """Names of the live sensors that run, by whichever page they were begun."""
        from palpate.devices.rpc import running

        return running(PREFIX, self._folder)

    def launch(self, name: str, options: Mapping[str, Any]) -> None:
        """Launch a process, and wait until it can be reached."""
        from palpate.sensing.live_client import launch_live

        launch_live(name, options, folder=self._folder)


class LiveDesk(Closing):
    """Live sensors of one server, shared by all tabs."""

    def __init__(self, processes: LiveProcesses | None = None) -> None:
        self._processes = processes or LiveProcesses()
        self._turn = threading.Lock()
        self._launching = threading.Lock()
        self._begins: Counter[str] = Counter()
        self._sensors: dict[str, LiveSensor] = {}
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def running(self) -> list[str]:
        """Names of the live sensors that run, as many as are shown."""
        return self._processes.running()[:MAX_SENSORS]

    def listened(self, name: str) -> LiveSensor | None:
        """The sensor of this name if it is listened to already; asking changes nothing."""
        with self._turn:
            return self._sensors.get(name)

    def sensor(self, name: str) -> LiveSensor | None:
        """The sensor of a process that runs, listened to from now on; None if no such process runs."""
        check_name(name)
        if (known := self.listened(name)) is not None:
            return known
        return self._listen_to(name) if name in self._processes.running() else None

    def _listen_to(self, name: str) -> LiveSensor:
        with self._turn:
            if name not in self._sensors:
                if len(self._sensors) >= MAX_SENSORS:
                    self._forget_ended()
                self._sensors[name] = LiveSensor(name, self._processes.connect(name))
            if self._thread is None:
                self._thread = threading.Thread(target=self._listen, name="palpate-live-desk", daemon=True)
                self._thread.start()
            return self._sensors[name]

    def _forget_ended(self) -> None:
        """Make room: a sensor whose process has ended takes no place."""
        running = self._processes.running()
        for name in [one for one in self._sensors if one not in running and one not in self._begins]:
            self._sensors.pop(name).connection.close()
        if len(self._sensors) >= MAX_SENSORS:
            raise InputError(f"{MAX_SENSORS} sensors are being read, which is the maximum. End one first.")

    @property
    def names(self) -> list[str]:
        """Names of the sensors that are listened to."""
        with self._turn:
            return list(self._sensors)

    def begin(self, name: str, options: Mapping[str, Any]) -> LiveSensor:
        """Launch a sensor's process, unless it runs, and listen to it."""
        check_name(name)
        with self._turn:
            self._begins[name] += 1
        try:
            sensor = self._listen_to(name)
            with self._launching:
                if sensor.connection.status is None:
                    self._processes.launch(name, options)
        finally:
            with self._turn:
                self._begins[name] -= 1
                self._begins += Counter()  # drops those at 0
        return sensor

    def end(self, name: str) -> None:
        """End a sensor's process, and forget it; of no consequence where it has gone."""
        with self._turn:
            sensor = self._sensors.pop(name, None)
        if sensor is None:
            return
        try:
            if sensor.connection.status is not None:
                sensor.connection.ask("shutdown")
        except PalpateError:
            pass  # it has gone, which was asked
        finally:
            sensor.connection.close()

    def close(self) -> None:
        """Listen no more; the sensors' processes go on."""
        self._closing.set()
        with self._turn:
            sensors, self._sensors = list(self._sensors.values()), {}
        for sensor in sensors:
            sensor.connection.close()

    def _listen(self) -> None:
        while not self._closing.wait(LISTEN_S):
            now_s = time.monotonic()
            with self._turn:
                sensors = list(self._sensors.values())
            for sensor in sensors:
                sensor.listen(now_s)


VIRTUAL = {
    "virtual:palm": "virtual palm",
    "virtual:tactip": "virtual TacTip",
    "virtual:nusense": "virtual NUSense",
    "virtual:tactip/S1=7.6": "virtual TacTip on a body of 7.6 N/mm",
}
VIRTUAL_PREFIX = "virtual:"
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
    if source.startswith(VIRTUAL_PREFIX) or source == "picamera2":
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
