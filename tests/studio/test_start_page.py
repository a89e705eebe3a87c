"""From the first page to live newtons on a virtual palm: stopped, found again by its address, finished."""

import os
import time

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")
pytest.importorskip("psutil", reason="psutil is not installed")

import psutil
from tests.studio.page_driving import DESK, PHONE, opened, serving, weak_texts, wider_than

from palpate.recordings import Run

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]
MAX_S, LONG_S = 120.0, 900.0
MAX_WIZARD_S = 180.0
"""From the first page to live newtons, on two cores that are free [s]."""
SENSOR = "live virtual:palm"
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
