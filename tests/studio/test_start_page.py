"""From the first page to live newtons on a virtual palm: stopped, found again by its address, finished."""

import os
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")
pytest.importorskip("psutil", reason="psutil is not installed")

import psutil
from tests.rig.hand_scale import HandScale
from tests.rig.serial_terminal import FakeTerminal
from tests.studio.page_driving import (
    DESK,
    PHONE,
    SCALE,
    choose,
    end_sensors,
    opened,
    serving,
    type_into_list,
    weak_texts,
    wider_than,
)
from tests.studio.test_rig_page import Studio

from palpate.recordings import Run

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]
MAX_S, LONG_S = 120.0, 900.0
MAX_WIZARD_S = 180.0
"""From the first page to live newtons, on two cores that are free [s]."""
SENSOR = "live virtual:palm"
WEIGHED = 12  # presses by a scale: each takes as long as it takes a hand
STEPS = "document.querySelector('#steps').innerText"
TROUBLE = "document.querySelector('#start-trouble').innerText"


def goes_on_to(tab, state):
    """Wait until the page shows a state, or what keeps it from there: that fails at once, in its words."""
    tab.wait(f"{state} || {TROUBLE} !== ''", LONG_S)
    assert tab.run(TROUBLE) == ""


@pytest.fixture
def served(tmp_path):
    with serving(tmp_path / "ws", tmp_path, (SENSOR,)) as served:
        yield served


def test_from_the_first_page_to_live_newtons_on_a_virtual_palm(browser, served, tmp_path):
    tab = opened(browser, served, "/", until="!!document.querySelector('#start-begin')")
    begun_s = time.monotonic()
    tab.press("#start-begin")
    goes_on_to(tab, f"/presses\\s+([3-9]|[1-3]\\d) of 40/.test({STEPS})")
    assert tab.run("document.querySelector('.start .camera img').naturalWidth") > 100
    tab.press("#start-stop")
    tab.wait("document.querySelector('#start-trouble').innerText.includes('go on when you are ready')", MAX_S)
    assert len(Run.open(tmp_path / "ws" / "my-sensor" / "presses")) > 0
    assert tab.run("location.search") == "?folder=my-sensor"
    tab.reload()
    tab.wait("document.querySelector('#start-begin')?.innerText === 'GO ON' || "
             "document.querySelector('#start-begin')?.innerText === 'Go on'", MAX_S)  # fmt: skip
    tab.press("#start-begin")
    tab.wait(f"{STEPS}.includes('6. Live newtons ready')", LONG_S)
    tab.wait("document.querySelector('#result').innerText.includes('errs by')", MAX_S)
    assert "not measured" in tab.text()
    assert "--camera virtual:palm" in tab.text()
    for size in (PHONE, DESK):
        tab.resize(*size)
        time.sleep(0.5)
        assert wider_than(tab) <= size[0]
        assert weak_texts(tab) == []
    tab.press("#go-live")
    tab.wait("location.pathname === '/live'", MAX_S)
    tab.wait("/^−?[0-9.]+ N/.test(document.querySelector('.value b')?.innerText ?? '')", LONG_S)
    took_s = time.monotonic() - begun_s
    busy = os.getloadavg()[0] / (os.cpu_count() or 1)
    cpu = psutil.Process(served.process.pid).cpu_times()
    cpu_s = cpu.user + cpu.system + cpu.children_user + cpu.children_system
    print(f"first page to live newtons: {took_s:.0f} s, load {busy:.1f} a core, {cpu_s:.0f} s of processor")
    assert took_s < MAX_WIZARD_S * max(1.0, busy)
    assert tab.said == []


class Started(Studio):
    """`palpate start`, whose first session presses on a scale that is told its force through a file."""

    starts_rig = False

    def __init__(self, folder, force):
        self._force = force
        super().__init__(folder)

    def open(self):
        words = ["palpate", "start", "--folder", str(self.folder / "weighed"), "--port", str(self.port)]
        code = f"import sys; sys.argv = {words!r}; from palpate.cli import main; main()"
        paths = [str(Path(__file__).with_name("hand_on_scale")), os.environ.get("PYTHONPATH", "")]
        env = {"XDG_RUNTIME_DIR": str(self.folder), "HAND_FORCE": str(self._force)}
        self.process = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env={**os.environ, **env, "PYTHONPATH": os.pathsep.join(paths)},
        )  # fmt: skip
        self.until_served()


def test_from_palpate_start_to_live_newtons_by_a_scale_on_a_serial_port(browser, tmp_path):
    """The hand presses in real time, as a person does; what is beyond that is the machine's own time."""
    force = tmp_path / "force"
    force.write_bytes(struct.pack("<d", 0.0))
    scale = HandScale(lambda _: struct.unpack("<d", force.read_bytes())[0], tare_n=1.0)
    studio = Started(tmp_path, force)
    try:
        with FakeTerminal(scale) as terminal:
            begun_s = time.monotonic()
            tab = browser.open(studio.page("?folder=weighed"), size=DESK)
            tab.wait("!!document.querySelector('#start-begin')", MAX_S)
            type_into_list(tab, SCALE, terminal.path)
            tab.type("input[aria-label^='presses to collect']", str(WEIGHED))
            choose(tab, "#unit", "g")  # this scale prints bare numbers
            tab.press("#start-begin")
            goes_on_to(tab, f"/presses\\s+0 of {WEIGHED}/.test({STEPS})")
            presses_s = time.monotonic()
            goes_on_to(tab, f"!/presses\\s+\\d+ of {WEIGHED}/.test({STEPS})")
            pressed_s = time.monotonic() - presses_s
            goes_on_to(tab, f"{STEPS}.includes('6. Live newtons ready')")
        tab.press("#go-live")
        tab.wait("location.pathname === '/live'", MAX_S)
        tab.wait("/^−?[0-9.]+ N/.test(document.querySelector('.value b')?.innerText ?? '')", LONG_S)
        machine_s = time.monotonic() - begun_s - pressed_s
        busy = os.getloadavg()[0] / (os.cpu_count() or 1)
        print(f"{WEIGHED} presses by a scale: the hand {pressed_s:.0f} s, the machine {machine_s:.0f} s, "
              f"load {busy:.1f} a core")  # fmt: skip
        table = Run.open(tmp_path / "weighed" / "presses").labels
        held = table[table["force_N"] > 0.5]
        assert held["press"].nunique() >= WEIGHED - 1
        error = (held["force_N"] - held["true_force_N"]).abs()
        assert error.median() < 0.03 * held["true_force_N"].max()
        assert machine_s < MAX_WIZARD_S * max(1.0, busy)
    finally:
        end_sensors(studio.addresses, (SENSOR,))
        studio.close()
