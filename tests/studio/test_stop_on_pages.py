"""The emergency stop on the pages: Escape whatever has the focus, what is confirmed, and without a server."""

import json
import time

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.studio.page_driving import opened
from tests.studio.test_page_security import Served

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
MOVES = json.dumps({"recording": True, "state": "running", "message": "p1, cycle 0: depth"})
SHOWN = "!document.querySelector('#estop').hidden"
DONE = "!document.querySelector('#estop-done').hidden"
FAILED = "!document.querySelector('#estop-failed').hidden"
MOVING = "document.querySelector('#estop').dataset.moving === 'made up'"
AT_REST = "document.querySelector('#estop').dataset.moving === ''"


@pytest.fixture
def served():
    served = Served()
    yield served
    served.close()


def into_text(tab):
    tab.press(".run-name input")
    tab.wait("document.activeElement.tagName === 'INPUT'")


def into_menu(tab):
    tab.press(".q-select")
    tab.wait("!!document.querySelector('.q-menu')")


def into_dialog(tab):
    tab.press("#release")
    tab.wait("!!document.querySelector('.q-dialog__backdrop')")


def nowhere(tab):
    tab.run("document.activeElement?.blur()")


@pytest.mark.parametrize("focus", [nowhere, into_text, into_menu])
def test_escape_stops_what_moves_whatever_has_the_focus(browser, served, focus):
    tab = opened(browser, served, "/rig")
    tab.wait(SHOWN)
    focus(tab)
    served.tell(MOVES)
    tab.wait(MOVING)
    tab.key("Escape", 27)
    assert served.process.stdout.readline().strip() == "estop"
    tab.wait(DONE)
    assert "made up" in tab.run("document.querySelector('#estop-what').textContent")
    assert 0 <= float(tab.run("document.querySelector('#estop-done').dataset.ms")) < 2000
    assert not tab.run(FAILED)
    assert tab.said == []


def test_escape_at_rest_closes_a_menu_and_a_dialog_and_stops_nothing(browser, served):
    tab = opened(browser, served, "/rig")
    tab.wait(f"{SHOWN} && {AT_REST}")
    into_menu(tab)
    tab.key("Escape", 27)
    tab.wait("!document.querySelector('.q-menu')")
    served.tell(json.dumps({"held": True, "state": "e-stopped"}))
    tab.wait("document.querySelector('#held').checkVisibility()")
    into_dialog(tab)
    tab.key("Escape", 27)
    tab.wait("!document.querySelector('.q-dialog__backdrop')")
    into_text(tab)
    tab.key("Escape", 27)
    time.sleep(1.0)
    assert not tab.run(DONE)
    assert not tab.run(FAILED)
    tab.press("#estop")  # the first stop that is told: there was none before
    assert served.process.stdout.readline().strip() == "estop"
    served.process.kill()
    assert served.process.stdout.read() == ""


def test_the_stop_is_shown_where_a_rig_is_active_and_a_lost_rig_is_started_on_request(browser, monkeypatch):
    monkeypatch.setenv("RIG", "none")
    served = Served()
    try:
        tab = browser.open(served.url("/rig"))
        tab.wait("document.querySelector('#lost')?.checkVisibility()")
        assert not tab.run(SHOWN)
        tab.press("#start-process")
        tab.wait(SHOWN)
        tab.wait("!document.querySelector('#lost').checkVisibility()")
        served.tell("null")  # it is lost
        tab.wait(f"!({SHOWN}) && document.querySelector('#lost').checkVisibility()")
        tab.press("#start-process")
        tab.wait(SHOWN)
        assert tab.said == []
    finally:
        served.close()


def test_a_stop_works_while_the_pages_server_is_blocked(browser, served):
    tab = opened(browser, served, "/rig")
    tab.wait(SHOWN)
    served.tell(MOVES)
    tab.wait(MOVING)
    served.tell("5.0")  # from now on each picture blocks the server's loop for so long
    tab.run("fetch('/picture?x')")
    time.sleep(0.3)
    begun_s = time.monotonic()
    tab.press("#estop")
    assert served.process.stdout.readline().strip() == "estop"
    assert time.monotonic() - begun_s < 3.0
    tab.wait(DONE, 3.0)
