"""A session whose presses were deleted: the page says so and has a button that presses them anew."""

import json
from argparse import Namespace

import pytest
from tests.refusals import refused

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.studio.page_driving import opened, serving

from palpate.core import DeviceError
from palpate.studio.library.job_process import JobVoice
from palpate.studio.live.start_desk import kept_session
from palpate.studio.live.start_process import run_session
from palpate.workflows.start_session import StartSession
from palpate.workflows.stored_session import STATE

MAX_S = 120.0
ASKED = 11
TROUBLE = "document.querySelector('#start-trouble').innerText"
ANEW = "document.querySelector('#press-anew')"


@pytest.fixture
def deleted(tmp_path):
    """The folder of a session that is done, without the run of its presses."""
    folder = tmp_path / "ws" / "mine"
    (folder / "calibration").mkdir(parents=True)
    kept = {
        "camera": "virtual:tactip", "scale": "virtual", "sensor": "tactip", "asked": ASKED,
        "done": ["camera", "settings", "untouched", "collect", "train"],
        "collected": {"presses": ASKED, "text": f"{ASKED} of {ASKED}"}, "trained": {"folder": "calibration"},
    }  # fmt: skip
    (folder / STATE).write_text(json.dumps(kept))
    return folder


@pytest.mark.parametrize("more", [0, ASKED])
def test_pressed_anew_are_as_many_as_were_asked_for_and_the_file_waits_for_the_camera(
    deleted, more, monkeypatch
):
    opened_for = []

    def feed(session, **_):
        opened_for.append((session.step, session.state.asked))
        raise DeviceError("no camera here")

    monkeypatch.setattr(StartSession, "feed", feed)
    words = Namespace(folder=deleted, camera="virtual:tactip", scale="virtual", presses=ASKED,
                      seed=0, unit="", real_time=False, more=more)  # fmt: skip
    with refused("device" if more else "run-missing"):
        run_session(words, JobVoice())
    assert opened_for == ([("collect", ASKED)] if more else [])
    assert kept_session(deleted)["gone"], "and it is told again until there are presses"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_button_is_reached_by_keyboard_and_presses_anew(deleted, browser, tmp_path):
    with serving(tmp_path / "ws", tmp_path) as served:
        tab = opened(browser, served, "/?folder=mine", until=f"!!{ANEW}")
        tab.wait(f"{TROUBLE}.includes('is gone: put it back') && {ANEW}.offsetParent !== null", MAX_S)
        assert tab.run(f"{ANEW}.focus(); document.activeElement.id") == "press-anew"
        tab.key("Enter", 13)
        tab.wait(f"/presses\\s+\\d+ of {ASKED}/.test(document.querySelector('#steps').innerText)", MAX_S)
        steps = tab.run("document.querySelector('#steps').innerText")
        assert "4. Presses" in steps
        assert "5. Calibration" in steps, "that of before is not what is made now"
        assert tab.run("document.querySelector('#picture-caption').innerText") == "What the camera sees now."
        assert tab.run(f"{ANEW}.offsetParent") is None, "it goes once presses are there"
        assert tab.run(TROUBLE) == ""
        tab.press("#start-stop")
        tab.wait(f"{TROUBLE}.includes('go on when you are ready')", MAX_S)
        assert tab.said == []
    assert StartSession(deleted).state.asked == ASKED
