"""A fake GRBL stage at a real pseudo-terminal, with its driver, on a clock in the test's hand."""

import math
import time
from collections.abc import Callable
from contextlib import ExitStack

import pytest
from tests.fakes.grbl_firmware import GrblFirmware
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.rig.serial_terminal import FakeTerminal

from palpate.core.clock import NS_PER_S, ManualClock
from palpate.devices import motion_guard
from palpate.rig.real.grbl.grbl_stage import GrblStage
from palpate.rig.real.grbl.grbl_supervisor import GrblSpec

PATIENCE_S = 60.0  # for what must happen; a loaded machine may take long, a broken one takes for ever


def until(condition: Callable[[], object]) -> None:
    """Wait for what must happen."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(1e-3)


class FastClock:
    """Real time, many times as fast: for moves that block their caller."""

    def __init__(self, pace: float = 20.0) -> None:
        self.pace = pace

    def now_ns(self) -> int:
        return int(time.monotonic_ns() * self.pace)

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds / self.pace)


class GrblBench:
    """The fake, its terminal and the driver's spec; by default homed, and with limits that fit it."""

    def __init__(self, stack: ExitStack, clock, model: GrblParameters, faults: GrblFaults, **spec) -> None:
        self.clock, self._stack = clock, stack
        self.firmware = GrblFirmware(model, faults, clock.now_ns() / NS_PER_S)
        self.terminal = stack.enter_context(FakeTerminal(self.firmware, clock))
        # Replies are waited for in real time: long enough for a loaded machine.
        self._spec = {"boot_s": 0.02, "reply_s": 10.0, "latency_s": 0.02} | spec

    @property
    def spec(self) -> GrblSpec:
        return GrblSpec(self.terminal.path, **self._spec)

    def open(self, *, known: bool = True) -> GrblStage:
        stage = GrblStage.open(self.spec, self.clock)
        self._stack.callback(stage._link.close)  # whatever the test did to it
        if known:
            stage.reference()
        return stage

    @property
    def place_mm(self):
        """The true place."""
        with self.terminal.lock:
            self.terminal.catch_up()
            return self.firmware.place_mm

    @property
    def speed_mm_s(self) -> float:
        with self.terminal.lock:
            self.terminal.catch_up()
            return self.firmware.speed_mm_s

    @property
    def received(self) -> bytes:
        """All that the driver sent, but for the questions for the status, which come on a period."""
        with self.terminal.lock:
            return bytes(self.firmware.received).replace(b"?", b"")

    def stops(self, *bytes_: int) -> list[tuple[float, float, float]]:
        """The true places when each of these bytes came."""
        with self.terminal.lock:
            return [place for byte, place in self.firmware.stops if byte in bytes_]

    def spoil(self, faults: GrblFaults) -> None:
        with self.terminal.lock:
            self.firmware.faults = faults

    def say(self, data: bytes) -> None:
        """Bytes from somebody else's programme."""
        with self.terminal.lock:
            self.firmware.receive(data)

    def wait(self, condition, step_s: float = 0.02) -> None:
        """Let the clock run until the condition holds."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, "what was waited for never came"
            self.clock.sleep(step_s)
            self.terminal.catch_up()  # so that a clock in the hand does not run away from the fake
            time.sleep(0)  # and its thread comes to speak

    def arrive(self, stage: GrblStage) -> None:
        self.wait(lambda: not stage.moving())

    def move_to_speed(self, stage: GrblStage, target_m, speed_m_s: float, after_mm: float = 0.0) -> None:
        """Begin a move, and return when it is up to speed and so far on."""
        start = self.place_mm
        stage.move_to(target_m, speed_m_s)
        full = speed_m_s * 1e3 * 0.999
        self.wait(lambda: self.speed_mm_s >= full and math.dist(self.place_mm, start) >= after_mm, 0.01)


@pytest.fixture(autouse=True)
def no_stored_position(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each test a state folder of its own: terminals have the names of those of earlier tests."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))


@pytest.fixture
def grbl_bench():
    """Make a bench: model and faults of the fake, and words of the driver's spec."""
    pytest.importorskip("serial", reason="the stage's driver needs pyserial")
    with ExitStack() as stack:

        def make(
            model: GrblParameters | None = None, faults: GrblFaults | None = None, clock=None, **spec
        ) -> GrblBench:
            return GrblBench(
                stack,
                clock or ManualClock(),
                model or GrblParameters(homed=True),
                faults or GrblFaults(),
                **spec,
            )

        yield make


@pytest.fixture
def grbl_open(grbl_bench):
    """Make a bench and open its stage; whether its position is known, as on a bench."""

    def make(*args, known: bool = True, **spec) -> tuple[GrblBench, GrblStage]:
        bench = grbl_bench(*args, **spec)
        return bench, bench.open(known=known)

    return make


@pytest.fixture
def coarse_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the guard look once a force sample of a virtual rig: for tests of what is recorded."""
    monkeypatch.setattr(motion_guard, "POLL_S", 0.005)


@pytest.fixture
def fast_clock():
    return FastClock
