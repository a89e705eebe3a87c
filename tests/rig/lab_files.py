"""Fakes of a stage, a force box and a camera at real ports and sockets, and their rig.toml."""

import os
import random
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

from tests.fakes.grbl_firmware import GrblFirmware
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.fakes.netft_box import FakeNetFT, FakePage
from tests.fakes.video_capture import FakeVideoCapture
from tests.rig.serial_terminal import FakeTerminal, SerialDevice

from palpate.core import Clock, ForceSensor, MonotonicClock
from palpate.core.clock import NS_PER_S
from palpate.devices.force_bias import Force
from palpate.rig.commissioning import first_touch, hand_motion
from palpate.rig.commissioning.setup_answers import toml_text
from palpate.rig.mean_force import await_push
from palpate.rig.real.position_evidence import PositionStore
from palpate.rig.real.uvc_camera import UvcCamera, UvcSettings

START_MM = (-50.0, -50.0, -20.0)  # of the machine; the probe hangs 10 mm above the expected surface
SOURCES: dict[str, FakeVideoCapture] = {}
SURFACE_MM, STIFFNESS_N_MM = 30.0, 4.0
CAMERA = "tests.rig.lab_files:lab_camera"


def lab_camera(clock: Clock | None = None, *, lab: str = "", rate_hz: float = 20.0) -> UvcCamera:
    """palpate's own camera driver on a source that a test may spoil."""
    source = SOURCES.get(lab) or FakeVideoCapture(rate_hz=rate_hz)
    settings = UvcSettings(size_px=(64, 48), rate_hz=rate_hz, exposure_s=5e-3, freeze_s=5.0)
    return UvcCamera("/dev/video7", settings, clock, opener=lambda where: source)


class EchoModem:
    """A modem, or a cable whose lines touch: it sends back each byte that it is sent."""

    def __init__(self) -> None:
        self._out = b""

    def receive(self, data: bytes) -> None:
        self._out += data

    def take(self) -> bytes:
        sent, self._out = self._out, b""
        return sent

    def run_to(self, now_s: float) -> None:
        pass


@dataclass
class LabFile:
    """The fakes, and the fields of their rig's file; tests change both.

    Attributes:
        fields: of the file, by table.
    """

    path: Path
    stage: GrblFirmware
    terminal: FakeTerminal
    box: FakeNetFT
    fields: dict[str, Any] = field(default_factory=dict)
    hand_n: float = 0.0  # force of a hand on the force sensor

    def write(self, **tables: dict[str, Any]) -> str:
        """Write the file with these tables changed, or left out where None; its path."""
        fields = {**self.fields, **{n: {**self.fields.get(n, {}), **t} for n, t in tables.items()}}
        self.path.write_text(toml_text(fields))
        return str(self.path)

    @property
    def jogged(self) -> bool:
        """Whether anything that moves was ever sent."""
        with self.terminal.lock:
            sent = bytes(self.stage.received)
        return any(word in sent for word in (b"$J", b"$H", b"G0", b"G1"))

    def force(self, t: float) -> tuple[float, float, float]:
        """Noise, and the skin under the probe."""
        depth_mm = max(-self.stage.place_mm[2] - SURFACE_MM, 0.0)
        x, y, z = (random.gauss(0.0, 0.002) for _ in "xyz")
        return x, y, z - STIFFNESS_N_MM * depth_mm - self.hand_n


@contextmanager
def pushed(lab: Any) -> Iterator[None]:
    """Push the force sensor of a lab by hand whenever palpate waits for it; `lab.hand_n` is the force."""

    def push(force: ForceSensor, clock: Clock, axis: int | None = None) -> Force:
        timers = [threading.Timer(at_s, setattr, (lab, "hand_n", n)) for at_s, n in ((0.5, 2.0), (1.2, 0.0))]
        for timer in timers:
            timer.start()
        try:
            return await_push(force, clock, axis)
        finally:
            for timer in timers:
                timer.cancel()
            lab.hand_n = 0.0

    with (
        mock.patch.object(hand_motion, "await_push", push),
        mock.patch.object(first_touch, "await_push", push),
    ):
        yield


def remember(stage: GrblFirmware, terminal: FakeTerminal) -> None:
    """Leave the evidence of an earlier session, in which the stage was homed."""
    marker = 47_001
    with terminal.lock:
        stage._modes.spindle = marker
        steps = " ".join(f"{stage.settings[number]:g}" for number in (100, 101, 102))
        at = stage._axes.place_mm
    settings = f"+X -Y -Z {steps} 0 counts None None"
    PositionStore(terminal.path).establish(marker, settings, (0.0, 0.0, 0.0), at)


@contextmanager
def lab_file(
    folder: Path, *, model: GrblParameters | None = None, page: FakePage | None = None
) -> Iterator[LabFile]:
    """Start the fakes, and close them."""
    with ExitStack() as stack:
        clock = MonotonicClock()
        model = model or GrblParameters(
            homed=True, start_mm=START_MM, settings={1: 255, 120: 500, 121: 500, 122: 500}
        )
        stage = GrblFirmware(model, GrblFaults(), clock.now_ns() / NS_PER_S)
        stage.take()  # it was switched on long ago: no banner waits in its port
        terminal = stack.enter_context(FakeTerminal(stage, clock))
        remember(stage, terminal)
        box = stack.enter_context(FakeNetFT(page=page or FakePage(ranges="30;30;60;3;3;3")))
        SOURCES[str(folder)] = FakeVideoCapture(rate_hz=20.0)
        stack.callback(SOURCES.pop, str(folder))
        lab = LabFile(folder / "rig.toml", stage, terminal, box)
        box.force = lab.force
        lab.fields = {
            "name": "lab",
            "origin_mm": [-50.0, 50.0, 30.0],
            "stage": {
                "kind": "grbl", "port": terminal.path, "reference": "counts",
                "steps_per_mm": [stage.settings[number] for number in (100, 101, 102)],
                "direction_mask": stage.settings[3], "boot_s": 0.05, "latency_s": 0.01,
            },
            "force": {
                "kind": "netft",
                "host": box.host,
                "rdt_port": box.rdt_port,
                "http_port": box.http_port,
                "silence_s": 0.5,
                "axes": ["x", "y", "-z"],
            },
            "camera": {"kind": CAMERA, "lab": str(folder)},
            "limits": {
                "least_mm": [-90, 10, 10],
                "greatest_mm": [-10, 90, 35],
                "force_N": 15.0,
                "age_s": 0.4,
            },
        }  # fmt: skip
        yield lab


@contextmanager
def served(device: SerialDevice) -> Iterator[str]:
    """The port of a device."""
    with FakeTerminal(device, MonotonicClock()) as terminal:
        yield terminal.path


def palpate(*words: str, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run palpate's command line in a process of its own."""
    return subprocess.run(
        command(*words), capture_output=True, text=True, timeout=240, env=environment(), **more
    )


def command(*words: str) -> list[str]:
    """Words that start palpate."""
    return [sys.executable, "-m", "palpate.cli", *words]


def environment() -> dict[str, str]:
    """Environment in which a process finds the tests' own drivers."""
    root = str(Path(__file__).parents[2])
    return {**os.environ, "PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])}
