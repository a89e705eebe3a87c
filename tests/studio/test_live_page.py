"""Sensors read live in a browser: begun, found again by the address, alive without the pages' server."""

import os
import time

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.studio import devtools
from tests.studio.small_run import write_small_run
from tests.studio.test_page_for_everybody import CONTRASTS
from tests.studio.test_page_security import Served

from palpate.devices.rpc import find
from palpate.sensing.live_client import LiveClient

pytestmark = pytest.mark.slow
MAX_S = 120.0
PALM = "live virtual:palm"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("live")


@pytest.fixture(scope="module")
def served(folder):
    write_small_run(folder / "ws" / "runs" / "one")
    kept = {name: os.environ.get(name) for name in ("WORKSPACE", "XDG_RUNTIME_DIR")}
    os.environ |= {"WORKSPACE": str(folder / "ws"), "XDG_RUNTIME_DIR": str(folder)}
    served = Served()
    for name, value in kept.items():
        os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)
    yield served
    served.close()
    for name in (PALM,):
        if find(name, folder / "palpate") is not None:
            with LiveClient(name, folder / "palpate") as client:
                if client.reached(5.0):
                    client.shutdown()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if devtools.chromium() is None:
        pytest.skip("there is no Chromium to drive")
    browser = devtools.Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


def test_a_sensor_is_begun_found_again_by_its_address_and_outlives_the_server(browser, served, folder):
    tab = browser.open(f"http://127.0.0.1:{served.port}/live")
    tab.wait("!!document.querySelector('#live-begin')", MAX_S)
    tab.press("#live-begin")  # the virtual palm, without a calibration
    tab.wait("document.querySelector('.live h2')?.innerText.includes('live')", MAX_S)
    begun_s = time.monotonic()
    tab.wait("document.querySelector('.live .camera img')?.naturalWidth > 100", MAX_S)
    print(f"first picture {time.monotonic() - begun_s:.2f} s after the sensor's card")
    tab.wait("document.querySelector('.live .facts').innerText.includes('frames a second')", MAX_S)
    assert tab.run("location.search") == "?sensor=live%20virtual%3Apalm"
    other = browser.open(f"http://127.0.0.1:{served.port}/live?sensor=live%20virtual%3Apalm")
    other.wait("document.querySelector('.live .camera img')?.naturalWidth > 100", MAX_S)
    served.process.kill()  # the sensor goes on without the server of the pages
    served.process.communicate()
    with LiveClient(PALM, folder / "palpate") as client:
        client.wait_for(lambda status: status["state"] == "live" and status["frames"] > 0, MAX_S)
        client.shutdown()
    assert tab.said == []


def test_text_stands_out_on_the_page_of_live_sensors(browser, folder):
    os.environ["WORKSPACE"] = str(folder / "ws")
    served = Served()
    del os.environ["WORKSPACE"]
    try:
        for size in ((390, 844), (1280, 900)):
            for scheme in ("light", "dark"):
                tab = browser.open("about:blank", size=size)
                media = [{"name": "prefers-color-scheme", "value": scheme}]
                tab.send("Emulation.setEmulatedMedia", features=media)
                tab.go(f"http://127.0.0.1:{served.port}/live?sensor=live%20nobody")
                tab.wait("document.body.innerText.includes('cannot be reached')", MAX_S)
                tab.front()
                weak = [one for one in tab.run(CONTRASTS) if one[1] < (3.0 if one[2] else 4.5)]
                assert weak == []
                assert tab.run("document.documentElement.scrollWidth") <= size[0]
    finally:
        served.close()
