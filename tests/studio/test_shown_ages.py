"""No number of the machine looks current for longer than a second, whoever falls silent."""

import json
import os
import signal
import threading
import time
from dataclasses import replace

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.studio.test_page_security import Served

from palpate.rig.service import RigService, open_served_rig
from palpate.studio.status_text import MAX_FRESH_S, MAX_SILENT_S, PARTS, ages_at

MAX_S = 60.0


def test_an_age_is_what_was_told_and_the_time_since():
    status = {"ages_s": {"force": 0.2, "position": 3.0, "camera": None, "engine": 1.5}}
    ages = ages_at(100.0, status, 96.0)
    assert ages == {"process": 4.0, "engine": 5.5, "force": 4.2, "position": 7.0, "camera": None}
    at_rest = {"ages_s": {**status["ages_s"], "engine": None}}
    assert ages_at(100.0, at_rest, 96.0)["engine"] == 4.0  # of a rig that records nothing, its process's
    assert ages_at(100.0, None, 96.0)["process"] == 4.0
    assert set(ages_at(100.0, None, None).values()) == {None}


class FreezingStage:
    """A stage whose driver hangs in `moving` while it is told to, and then goes on."""

    def __init__(self, inner):
        self._inner = inner
        self.frozen, self.goes_on = threading.Event(), threading.Event()
        self.freezes = False

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def moving(self):
        if self.freezes:
            self.freezes = False
            self.frozen.set()
            assert self.goes_on.wait(MAX_S)
        return self._inner.moving()


@pytest.mark.slow
@pytest.mark.parametrize("accelerated", [True, False])
def test_behind_a_frozen_engine_all_numbers_age_by_real_time(tmp_path, accelerated):
    opened = open_served_rig("virtual:palm", accelerated=accelerated)
    stage = FreezingStage(opened.rig.stage)
    service = RigService(replace(opened, rig=replace(opened.rig, stage=stage)), tmp_path)
    try:
        ages = until(service, lambda ages: all(ages[part] is not None for part in PARTS))
        assert ages["engine"] is None
        service.plan({"places": {"kind": "listed", "at_mm": [[0.0, 0.0]]}, "cycles": 1, "taps": 0})
        service.start("frozen")
        stage.freezes = True
        assert stage.frozen.wait(MAX_S)
        frozen_s = time.monotonic()
        time.sleep(0.5)  # for what was under way elsewhere
        first_s, first = time.monotonic(), service.status()["ages_s"]
        time.sleep(MAX_FRESH_S)
        between_s, second = time.monotonic(), service.status()["ages_s"]
        second_s = time.monotonic()
        for part in ("engine", "force", "position"):
            # Exact but for how long the two calls took on a busy machine, and rounding to 0.01 s.
            assert second[part] - first[part] <= second_s - first_s + 0.02
            assert second[part] >= between_s - frozen_s - 0.2 > MAX_FRESH_S, "it is marked as old"
        shown = ages_at(second_s + 7.0, {"ages_s": second}, second_s)
        assert shown["force"] == pytest.approx(second["force"] + 7.0)
        stage.goes_on.set()
        until(service, lambda ages: ages["force"] < MAX_FRESH_S)  # and what is new is not marked
    finally:
        stage.goes_on.set()
        service.close()


def until(service, holds):
    """The first ages of which something holds."""
    end_s = time.monotonic() + MAX_S
    while time.monotonic() < end_s:
        if holds(ages := service.status()["ages_s"]):
            return ages
        time.sleep(0.05)
    raise AssertionError(f"it did not come about: {ages}")


@pytest.fixture
def served():
    served = Served()
    served.tell(json.dumps(AT_ONCE))
    yield served
    served.process.send_signal(signal.SIGCONT)
    served.close()


AT_ONCE = {"ages_s": {"force": 0.0, "position": 0.0, "camera": 0.0, "engine": None}}
STALE = "[...document.querySelectorAll('[data-stale]')].map((e) => e.id || e.dataset.ageOf)"
OLD = "[...document.querySelectorAll('.age')].map((e) => e.textContent).filter((text) => text)"
SILENCE = "(document.querySelector('#silence:not([hidden])')?.innerText ?? '')"
ALL_SHOWN = {"state", "progress", "grid", "camera", "force-now", "force", "doing"}


def opened(browser, served):
    tab = browser.open(served.url("/rig"))
    tab.wait(
        "document.querySelector('#force-now b') && document.querySelector('#camera img')?.naturalWidth", 30
    )
    tab.wait(f"{STALE}.length === 0 && {SILENCE} === ''", 30)
    return tab


def seconds(text):
    """The age that a text says [s]."""
    return float(text.split(" s")[0].split()[-1])


@pytest.mark.slow
def test_a_silent_engine_process_or_server_ages_all_that_is_shown_and_is_named(browser, served):
    tab = opened(browser, served)
    recording = {"recording": True, "state": "running", "message": "p1, cycle 0: depth", "shots": 3}
    frozen = {"force": 5.0, "position": 5.0, "camera": 5.0, "engine": 5.0}
    served.tell(json.dumps({**recording, "ages_s": frozen}))
    tab.wait(f"{SILENCE}.startsWith('The engine that records says nothing.')")
    assert set(tab.run(STALE)) >= ALL_SHOWN

    served.tell(json.dumps({**recording, "ages_s": AT_ONCE["ages_s"]}))
    tab.wait(f"{SILENCE} === '' && {STALE}.length === 0")
    began_s = time.monotonic()
    served.tell('"silent"')
    tab.wait(f'{SILENCE}.startsWith("The rig\'s process says nothing.")')
    assert set(tab.run(STALE)) >= ALL_SHOWN
    assert time.monotonic() - began_s > MAX_SILENT_S - 0.3

    served.tell(json.dumps(AT_ONCE))
    tab.wait(f"{SILENCE} === '' && {STALE}.length === 0")
    served.process.send_signal(signal.SIGSTOP)  # the page is left to its own clock
    stopped_s = time.monotonic()
    tab.wait(f"{SILENCE}.startsWith('This page hears nothing from its server.')")
    time.sleep(1.0)
    (force,) = (text for text in tab.run(OLD) if text.startswith("force"))
    since_s = time.monotonic() - stopped_s
    assert since_s - 2.0 < seconds(force) < since_s + 1.5
    assert since_s - 2.0 < seconds(tab.run(SILENCE).split("for ")[-1]) < since_s + 1.5
    assert set(tab.run(STALE)) >= ALL_SHOWN
    os.kill(served.process.pid, signal.SIGCONT)
    tab.wait(f"{SILENCE} === '' && {STALE}.length === 0", 30)
