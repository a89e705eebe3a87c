"""Notes on a run lie beside it, are bounded, and never alter it."""

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, RecordingError
from palpate.recordings import Manifest, Run, RunWriter, check
from palpate.recordings.manifest import MAX_NOTE, NOTES, add_note, read_notes


@pytest.fixture
def run(tmp_path):
    path = tmp_path / "run"
    with RunWriter.create(path, Manifest.new(sensor="made up")) as writer:
        writer.frame(np.zeros((8, 8), np.uint8))
    return path


def test_notes_come_back_in_the_order_of_their_times_and_the_run_stays_as_it_was(run):
    before = Run.open(run).hash
    add_note(run, 2.0, "slipped\n here")
    add_note(run, 0.5, "é <b>")
    assert [(note.time_s, note.text) for note in read_notes(run)] == [
        (0.5, "é <b>"),
        (2.0, "slipped here"),
    ]
    assert Run.open(run).hash == before
    assert check(run).sound


def test_a_line_that_is_no_note_is_left_out(run):
    add_note(run, 1.0, "one")
    with (run / NOTES).open("a") as file:
        file.write('{"time_s": "x"}\n[[[\n{"time_s": 1e999, "text": "", "written_utc": ""}\n{"time_s": 3')
    assert [note.text for note in read_notes(run)] == ["one"]


def test_too_long_or_timeless_notes_and_links_are_refused(run, tmp_path):
    for time_s, text in ((0.0, ""), (0.0, "x" * (MAX_NOTE + 1)), (float("nan"), "x")):
        with pytest.raises(InputError):
            add_note(run, time_s, text)
    with refused("not-a-run", RecordingError):
        add_note(tmp_path, 0.0, "x")
    (tmp_path / "elsewhere").write_text("secret")
    (run / NOTES).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RecordingError, match="link"):
        add_note(run, 0.0, "x")
    assert (tmp_path / "elsewhere").read_text() == "secret"
