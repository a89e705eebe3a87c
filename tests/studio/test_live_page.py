"""Sensors read live in a browser: begun, found again by the address, alive without the pages' server."""

import time

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.studio.page_driving import serving
from tests.studio.small_run import write_small_run
from tests.virtual_presses import KAPPA_N_M, references

from palpate.calibration.compliance.compliance_calibration import calibrate_compliance
from palpate.sensing.live_client import LiveClient
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import specimens_at

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
MAX_S, LONG_S = 120.0, 300.0
PLAYED = {"live runs/one": 10.0, "live runs/two": 25.0}
"""Recordings by the names of their processes, and the rates that they were recorded at [Hz]."""
COUNTED_S, TRIES = 8.0, 4
"""Frames are counted over so long; a machine with other work stalls now and then, and then again."""
PALM, NUSENSE, TIP = "live virtual:palm", "live virtual:nusense", "live virtual:tactip/S1=7.6"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("live")


@pytest.fixture(scope="module")
def workspace(folder):
    write_small_run(folder / "ws" / "runs" / "one")
    write_small_run(folder / "ws" / "runs" / "two", frames=50, step_s=0.04)
    spec = tactip()
    given = references(spec, specimens_at(spec, KAPPA_N_M), 2, 7000, rendered=False)
    calibrate_compliance(given, note="virtual").save(folder / "ws" / "tip.npz")
    return folder / "ws"


@pytest.fixture
def served(folder, workspace):
    with serving(workspace, folder, (PALM, NUSENSE, TIP, *PLAYED)) as served:
        yield served


def test_a_sensor_is_begun_found_again_by_its_address_and_outlives_the_server(browser, served, folder):
    tab = browser.open(served.url("/live"))
    tab.wait("!!document.querySelector('#live-begin')", MAX_S)
    tab.press("#live-begin")  # the virtual palm, without a calibration
    tab.wait("document.querySelector('.live h2')?.innerText.includes('live')", MAX_S)
    begun_s = time.monotonic()
    tab.wait("document.querySelector('.live .camera img')?.naturalWidth > 100", MAX_S)
    print(f"first picture {time.monotonic() - begun_s:.2f} s after the sensor's card")
    tab.wait("document.querySelector('.live .facts').innerText.includes('frames a second')", MAX_S)
    assert tab.run("location.search") == "?sensor=live%20virtual%3Apalm"
    other = browser.open(served.url("/live?sensor=live%20virtual%3Apalm"))
    other.wait("document.querySelector('.live .camera img')?.naturalWidth > 100", MAX_S)
    served.process.kill()  # the sensor goes on without the server of the pages
    served.process.communicate()
    with LiveClient(PALM, folder / "palpate") as client:
        client.wait_for(lambda status: status["state"] == "live" and status["frames"] > 0, MAX_S)
        client.shutdown()
    assert tab.said == []
