"""Laws of a session that goes on: more presses beside those that are there, frames that a kill left bare."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused

import palpate
from palpate.core import InputError
from palpate.estimators.session_folder import SESSION_FILE, calibration_in
from palpate.recordings import Run, RunWriter
from palpate.sensing.collection.press_collector import presses_in
from palpate.workflows.certificate_sentence import left_out_text
from palpate.workflows.start_session import StartSession
from palpate.workflows.start_state import PRESSES

pytestmark = pytest.mark.usefixtures("changes_untried")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> StartSession:
    made = StartSession(tmp_path_factory.mktemp("session") / "s")
    made.choose("virtual:tactip", "virtual", asked=10)
    with made.feed() as feed:
        made.check_settings(feed)
        made.take_untouched(feed)
        made.collect(feed)
    made.train(curve=False)
    return made


def test_more_presses_are_collected_beside_the_old_ones_and_all_are_learnt_from(
    session: StartSession,
) -> None:
    before, first = presses_in(Run.open(session.run)), session.calibration
    session.ask_more(3)
    assert (session.step, session.state.asked) == ("collect", 13)
    with session.feed() as feed:
        session.collect(feed)
    after = presses_in(Run.open(session.run))
    assert after[:10] == before
    assert len(after) == 13
    assert not set(after[10:]) & set(before)  # the hand does not press the same again
    session.train(curve=False)
    assert session.state.trained["presses"] == 13
    assert session.calibration != first
    assert calibration_in(session.folder) == session.calibration, "a session's folder means its newest"
    assert calibration_in(first) == first
    assert shlex.split(session.commands()[-1])[2] == str(session.calibration)
    assert str(session.calibration) in session.newest_text
    assert first.name in session.newest_text
    with palpate.live(session.folder, camera="virtual:tactip", max_frames=1) as live:
        assert next(iter(live)).to_dict()["calibration"] == session.state.trained["id"]
    with refused("press-count", InputError):
        session.ask_more(0)


def test_another_scale_weighs_what_is_missing_beside_the_presses_that_are_there(
    session: StartSession, tmp_path: Path
) -> None:
    """Ten of ten were collected: with another scale none is missing, and four more are asked for as four."""
    shutil.copytree(session.folder, tmp_path / "s")
    other, held = StartSession(tmp_path / "s"), session.presses_held
    other.choose_if_other("virtual:tactip", "typed")
    assert other.step == "settings", "another scale is opened anew"
    assert (other.state.asked, other.presses_held) == (session.state.asked, held)
    assert other.remaining.endswith(f"holds {held} presses of {held}; nothing is still to be collected")
    kept = StartSession(tmp_path / "s")
    ways = (("typed", None), ("typed", held), ("typed", held + 1), (kept.state.scale, None))
    assert [kept.has_nothing_left_by("virtual:tactip", *way) for way in ways] == [True, True, False, False]
    assert not kept.has_nothing_left_by("virtual:palm", "typed", None)
    assert f"{held} presses" in kept.nothing_left_text
    other.ask_more(4)
    assert other.state.asked == held + 4
    assert other.remaining.endswith("; 4 are still to be collected")
    stated = StartSession(tmp_path / "s")
    stated.choose_if_other("virtual:tactip", "typed", asked=held + 7)
    assert stated.remaining.endswith("; 7 are still to be collected")


def test_a_session_that_holds_no_press_has_none_to_go_on_from(tmp_path: Path) -> None:
    fresh = StartSession(tmp_path / "s")
    fresh.choose_if_other("virtual:tactip", "virtual")
    assert (fresh.state.asked, fresh.remaining, fresh.presses_held) == (PRESSES, "", 0)
    fresh.choose_if_other("virtual:palm", "virtual", asked=12)
    fresh.choose_if_other("virtual:palm", "typed")
    assert fresh.state.asked == 12, "as it was begun for"
    fresh.choose_if_other("virtual:tactip", "virtual")
    assert fresh.state.asked == PRESSES, "another camera is another session"


def test_frames_that_a_kill_left_without_labels_are_left_out_and_counted(session: StartSession) -> None:
    run = Run.open(session.run)
    with RunWriter.resume(session.run) as writer:
        for _ in range(2):
            writer.frame(np.asarray(run.frame(0).image))
    assert (len(Run.open(session.run)), len(Run.open(session.run).labelled())) == (len(run) + 2, len(run))
    session.train(curve=False)
    assert "2 frames" in session.state.trained["left_out"]
    assert left_out_text(0) == ""
    assert run.labelled() is run


def test_a_file_in_place_of_the_folder_is_named_with_what_to_give(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("x")
    with refused("not-a-folder", InputError):
        StartSession(tmp_path / "mine.txt")


@pytest.mark.parametrize(
    "kept",
    [
        "",
        "[]",
        "{",
        '{"trained": {}}',
        '{"trained": {"folder": "../out"}}',
        '{"trained": {"folder": "gone"}}',
    ],
)
def test_a_folder_that_names_no_calibration_within_it_means_itself(kept: str, tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "s" / SESSION_FILE).write_text(kept)
    assert calibration_in(tmp_path / "s") == tmp_path / "s"
    assert calibration_in(tmp_path / "none") == tmp_path / "none"
