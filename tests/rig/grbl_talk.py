"""Plain conversation with a GRBL firmware, a fake or a simulator of a real one, by none of the driver's code.

A simulator talks on its standard input and output. One such prints `error:7` and its settings before the
first banner, hears nothing for a second, keeps its settings in its working folder, and runs at about half
real time. PALPATE_GRBL_SIM names the executable of one of Grbl 1.1, PALPATE_GRBLHAL_SIM of one of grblHAL;
neither is part of palpate.
"""

import os
import re
import shlex
import subprocess
import time
import tty
from contextlib import contextmanager

import pytest
from tests.fakes.grbl_firmware import GrblFirmware
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.rig.serial_terminal import FakeTerminal

from palpate.core.clock import NS_PER_S, MonotonicClock

serial = pytest.importorskip("serial", reason="the stage's driver needs pyserial")
SIMULATORS = {"1.1h": "PALPATE_GRBL_SIM", "grblHAL": "PALPATE_GRBLHAL_SIM"}
"""Environment variable that names the simulator of each firmware."""
PATIENCE_S = 60.0


@contextmanager
def fake(firmware: str = "1.1h"):
    clock = MonotonicClock()
    model = GrblParameters(firmware=firmware, settings={20: 0, 22: 0}, print_s=0.006)
    with FakeTerminal(GrblFirmware(model, GrblFaults(), clock.now_ns() / NS_PER_S), clock) as terminal:
        yield terminal.path


@contextmanager
def simulator(folder, firmware: str = "1.1h"):
    executable = os.environ.get(SIMULATORS[firmware], "")
    if not executable:
        pytest.skip(f"no simulator of real firmware; name its executable in {SIMULATORS[firmware]}")
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    try:
        with subprocess.Popen(
            shlex.split(executable), stdin=ours, stdout=ours, stderr=subprocess.DEVNULL, bufsize=0, cwd=folder
        ) as process:
            try:
                yield os.ttyname(theirs)
            finally:
                process.kill()
    finally:
        os.close(ours)
        os.close(theirs)


class Talk:
    """A plain conversation, by none of the driver's code."""

    def __init__(self, path: str) -> None:
        self.port = serial.Serial(path, 115200, timeout=0.05, exclusive=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.port.close()

    def wake(self) -> None:
        """Reset it until it answers, and let it have its say."""
        for _ in range(int(PATIENCE_S)):
            self.port.write(b"\x18")
            try:
                self.hear("(?i)grbl", patience_s=1.0)
            except AssertionError:
                continue
            while self.port.readline():
                pass
            return
        raise AssertionError("the firmware never said its banner")

    def hear(self, wanted: str, patience_s: float = PATIENCE_S) -> list[str]:
        """All lines up to one that matches."""
        heard, end = [], time.monotonic() + patience_s
        while time.monotonic() < end:
            line = self.port.readline().decode("ascii", "replace").strip()
            if line:
                heard.append(line)
            if re.match(wanted, line):
                return heard
        raise AssertionError(f"{wanted!r} never came; heard {heard}")

    def send(self, line: str) -> list[str]:
        self.port.write(line.encode() + b"\n")
        return self.hear(r"ok$|error:\d+$")

    def status(self) -> str:
        self.port.write(b"?")
        return self.hear("<")[-1]

    def until(self, state: str) -> str:
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            status = self.status()
            if status.startswith(f"<{state}"):
                return status
        raise AssertionError(f"never {state}, last {status}")

    def reset(self) -> list[str]:
        self.port.write(b"\x18")
        return self.hear("(?i)grbl")

    def x_mm(self) -> float:
        return float(re.search(r"MPos:(-?\d+\.\d+)", self.status())[1])
