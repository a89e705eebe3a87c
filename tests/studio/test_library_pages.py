"""Recordings, calibrations and trials in a browser: listed, opened by address, played, noted on, split."""

import json
import subprocess
import sys

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.studio.page_driving import opened, serving
from tests.studio.small_run import write_small_run

from palpate.core.provenance import Provenance
from palpate.recordings.manifest import read_notes

pytestmark = pytest.mark.slow
MAX_S = 60.0
PAGES = {
    "start": "/",
    "recordings": "/recordings",
    "one run": "/recordings?run=runs%2Fone&frame=3&split=group%3Apress",
    "two runs": "/recordings?run=runs%2Fone&beside=runs%2Ftwo",
    "calibrations": "/calibrations",
    "trials": "/trials",
}


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    folder = tmp_path_factory.mktemp("workspace")
    for name, provenance in (("one", Provenance.SIMULATED), ("two", Provenance.MEASURED)):
        write_small_run(folder / "runs" / name, provenance=provenance)
    calibrate = ("calibrate", "runs/one", "--split", "group:press", "--folds", "3", "--quiet")
    for words in (
        (*calibrate, "--model", "pca-ridge", "--out", "cal-one"),
        (*calibrate, "--model", "mean", "--out", "cal-two"),
        ("experiment", "new", "jelly", "--seed", "3"),
        ("experiment", "run", "jelly", "--participant", "R01", "--noise", "0.3"),
    ):
        code = f"import sys; sys.argv[1:] = {list(words)!r}; from palpate.cli import main; main()"
        subprocess.run([sys.executable, "-c", code], cwd=folder, check=True, capture_output=True, timeout=300)
    return folder


@pytest.fixture(scope="module")
def served(workspace):
    with serving(workspace) as served:
        yield served


BADGES = "[...document.querySelectorAll({!r})].filter((e) => e.innerText.includes('simulated')).length"
"""How many of these parts of a page say that what they show is simulated."""


def seek(tab, index):
    """Move the first player to a frame, as its slider does."""
    event = "new Event('input', {bubbles: true})"
    tab.run(
        f"(() => {{ const r = document.querySelector('.player input'); r.value = {index};"
        f"r.dispatchEvent({event}) }})()"
    )


def test_runs_are_listed_and_one_is_played_noted_on_and_split(browser, served, workspace):
    tab = opened(browser, served, "/recordings")
    tab.wait("document.body.innerText.includes('2 runs')", MAX_S)
    assert tab.run(BADGES.format("tbody tr")) == 1  # the other was measured
    tab.press("a[href='/recordings?run=runs%2Fone']")
    tab.wait("document.querySelector('.player img')?.naturalWidth === 32", MAX_S)
    tab.wait("document.querySelector('[data-labels]').innerText.includes('force_N 0')")
    seek(tab, 17)
    tab.wait("document.querySelector('[data-labels]').innerText.includes('force_N 7')")
    tab.wait("location.search.includes('frame=17')")
    tab.type("input[aria-label='note on the frame that is shown']", "slipped <here>")
    tab.press("#note")
    tab.wait("document.querySelector('#notes').innerText.includes('slipped <here>')")
    assert [(round(n.time_s, 1), n.text) for n in read_notes(workspace / "runs/one")] == [
        (1.7, "slipped <here>")
    ]
    tab.reload()  # the address says which frame it was
    tab.wait("document.querySelector('.player output')?.innerText.startsWith('frame 17 of 30')", MAX_S)
    tab.press("[data-play]")
    tab.wait("document.querySelector('.player output').innerText.startsWith('frame 29 of 30')")
    assert tab.said == []
    again = opened(browser, served, PAGES["one run"])
    again.wait("document.body.innerText.includes('3 groups')", MAX_S)


def test_a_calibration_is_reported_compared_and_scored_by_processes_of_their_own(browser, served):
    tab = opened(browser, served, "/calibrations?cal=cal-one&beside=cal-two&run=runs%2Ftwo")
    tab.wait("document.querySelectorAll('.calibration table').length === 2", MAX_S)
    assert tab.run(BADGES.format(".calibration h3")) == 2
    tab.press("#score")
    tab.wait("document.querySelector('#jobs').innerText.includes('mean error')", 2 * MAX_S)
    tab.press("#compare")
    tab.wait("document.querySelectorAll('#jobs a').length === 1", 2 * MAX_S)
    tab.press(".report-button")
    tab.wait("document.querySelectorAll('#jobs a').length === 2", 2 * MAX_S)
    address = tab.run("[...document.querySelectorAll('#jobs a')].at(-1).getAttribute('href')")
    answer = served.ask("GET", address)
    assert answer[0] == 200
    policies = answer[1].get_all("content-security-policy")
    assert any(policy.startswith("sandbox") for policy in policies)
    assert any("frame-ancestors 'none'" in policy for policy in policies)
    report = browser.open(served.url(address))
    report.wait("document.querySelectorAll('img').length > 0", MAX_S)
    assert report.run("[...document.querySelectorAll('img')].every((i) => i.naturalWidth > 0)")
    assert tab.said == []


def test_the_emergency_stop_works_from_every_page(browser, served):
    for path in ("/", "/live", "/recordings", "/calibrations", "/trials", "/softness", "/rig"):
        served.tell(json.dumps({"recording": True, "state": "running"}))
        tab = opened(browser, served, path, until="!!document.querySelector('#estop:not([hidden])')")
        tab.key("Escape", 27)
        assert served.process.stdout.readline().strip() == "estop", path
