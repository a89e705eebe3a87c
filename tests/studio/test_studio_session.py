"""Whole sessions in the studio: recorded, calibrated, read live; two operators; a client that hangs."""

import json
import os
import time

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.studio import devtools
from tests.studio.page_driving import choose
from tests.studio.test_page_security import Served
from tests.studio.test_rig_page import MAX_S, Studio, opened, state_is, until_it_presses, use_small_plan

from palpate.devices.rpc import find
from palpate.sensing.live_client import LiveClient

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]
LONG_S = 300.0
SENSOR = "live virtual:palm"


@pytest.fixture
def studio(tmp_path, request):
    studio = Studio(tmp_path, *getattr(request, "param", ()))
    yield studio
    studio.close()
    if find(SENSOR, studio.addresses) is not None:
        with LiveClient(SENSOR, studio.addresses) as client:
            if client.reached(5.0):
                client.shutdown()


@pytest.mark.parametrize("studio", [("--accelerated",)], indirect=True)
def test_a_session_from_the_plan_to_a_report_and_live_newtons(browser, studio, tmp_path):
    tab = opened(browser, studio)
    use_small_plan(tab)  # configured; its places are drawn as a preview
    assert tab.run("document.querySelectorAll('#grid circle title').length") == 1
    tab.type(".field-cycles input", "80")
    tab.press("#plan-use")
    tab.wait("document.querySelector('#progress').innerText.includes('0 of 400 shots')", MAX_S)
    tab.type(".run-name input", "session")
    tab.press("#start")
    tab.press("#pause")  # as soon as it can be
    tab.wait(state_is("paused"), MAX_S)
    tab.press("#resume")
    studio.rig.wait_for(lambda status: status["shots"] >= 100, LONG_S)
    tab.press("#stop")
    tab.wait(state_is("stopped"), MAX_S)

    tab.go(f"{studio.url}recordings?run=runs%2Fsession")
    tab.wait("document.querySelector('.player img')?.naturalWidth > 100", MAX_S)
    tab.press("#calibrate")
    tab.wait("document.querySelector('#calibration-job').innerText.includes('done')", LONG_S)
    tab.press("#calibration-job a")
    tab.wait("document.querySelectorAll('.calibration table').length === 1", MAX_S)
    tab.press(".report-button")
    tab.wait("!!document.querySelector('#jobs a')", LONG_S)

    tab.go(f"{studio.url}live")
    tab.wait("!!document.querySelector('#live-begin')", MAX_S)
    choose(tab, "#live-calibration", "cal-session")
    tab.press("#live-begin")
    tab.wait(
        "[...document.querySelectorAll('.value b')].some((one) => /^−?[0-9.]+ N/.test(one.innerText))", LONG_S
    )
    tab.wait("!!document.querySelector('.live .plot svg')", MAX_S)
    assert tab.said == []
    elsewhere = [url for url in tab.requested if f"127.0.0.1:{studio.port}" not in url]
    assert [url for url in elsewhere if not url.startswith(("data:", "about:", "blob:"))] == []


@pytest.mark.parametrize("studio", [("--accelerated",)], indirect=True)
@pytest.mark.parametrize("way", ["#estop", "Escape"])
def test_the_page_of_live_sensors_stops_a_rig_that_moves(browser, studio, way):
    rig_tab = opened(browser, studio)
    use_small_plan(rig_tab)
    rig_tab.type(".field-cycles input", "80")
    rig_tab.press("#plan-use")
    rig_tab.wait("document.querySelector('#progress').innerText.includes('0 of 400 shots')", MAX_S)
    rig_tab.type(".run-name input", "stopped")
    tab = browser.open(studio.page("live"))
    tab.wait("!!document.querySelector('#live-begin')", MAX_S)
    rig_tab.press("#start")
    studio.rig.wait_for(lambda status: status["recording"], MAX_S)
    tab.front()
    until_it_presses(studio)
    if way == "Escape":
        tab.key("Escape", 27)
    else:
        tab.press(way)
    studio.rig.wait_for(lambda status: status["held"] and not status["recording"], MAX_S)
    stood = studio.rig.status["position_mm"]
    time.sleep(1.0)
    assert studio.rig.status["position_mm"] == pytest.approx(stood, abs=1e-6)
    assert studio.rig.status["held"]


def test_two_browsers_cannot_both_move_the_rig_and_both_can_stop_it(browser, studio, tmp_path):
    second = devtools.Browser(tmp_path / "second")
    try:
        one, two = opened(browser, studio), opened(second, studio)
        use_small_plan(one)  # which takes the rig
        two.wait(
            "document.querySelector('#holder').innerText.startsWith('Another browser holds the rig')", MAX_S
        )
        two.wait("document.querySelector('#start').disabled")
        one.wait("document.querySelector('#holder').innerText === 'You hold the rig.'")
        one.type(".run-name input", "theirs")
        one.press("#start")
        studio.rig.wait_for(lambda status: status["recording"], MAX_S)
        two.wait(state_is("running"), MAX_S)
        assert two.run("['#pause', '#stop', '#abort'].every((i) => document.querySelector(i).disabled)")
        two.press("#estop")
        studio.rig.wait_for(lambda status: status["held"] and not status["recording"], MAX_S)
        two.wait("document.querySelector('#release').disabled", MAX_S)
        one.press("#release")
        one.press("#release-yes")
        studio.rig.wait_for(lambda status: not status["held"], MAX_S)
        one.wait("!document.querySelector('.q-dialog__backdrop')", MAX_S)
        one.press("#let-go")
        two.wait("!document.querySelector('#start').disabled", MAX_S)
    finally:
        second.close()


def test_a_server_with_a_token_gives_nothing_without_it_and_a_page_with_it(browser):
    os.environ["TOKEN"] = "s3cret"
    served = Served()
    del os.environ["TOKEN"]
    try:
        assert served.ask("GET", "/", Cookie="none=0")[0] == 401
        assert served.ask("POST", "/estop", x_palpate="estop", Cookie="none=0")[0] == 401
        assert served.handshake(Cookie="none=0")[0] in (401, 403)
        cookie = f"palpate-token-{served.port}=s3cret"
        assert served.handshake(Cookie=cookie)[0] == 101
        tab = browser.open(f"http://127.0.0.1:{served.port}/rig?token=s3cret")
        tab.wait(
            "document.querySelector('#force-now b')?.innerText.length > 0", MAX_S
        )  # its socket was let in
        assert "token" not in tab.run("location.href")
        assert "s3cret" not in tab.run("document.cookie")
        served.tell(json.dumps({"recording": True, "state": "running"}))
        tab.front()
        tab.key("Escape", 27)
        assert served.process.stdout.readline().strip() == "estop"
    finally:
        served.close()
