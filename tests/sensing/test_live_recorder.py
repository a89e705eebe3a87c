"""What of a live recording is removed at its end: a run without a frame, a log without a reading; no more."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sensing.live_stand_ins import HandedFrames

from palpate.core import Frame
from palpate.recordings import Run
from palpate.recordings.exchange.reading_log import ReadingLog
from palpate.sensing.streaming.live_recorder import LiveRecorder


@pytest.mark.parametrize("frames", [0, 1])
@pytest.mark.parametrize("noted", [False, True])
def test_a_run_is_removed_where_it_holds_neither_a_frame_nor_anything_that_was_added(
    tmp_path, frames: int, noted: bool
) -> None:
    recorder = LiveRecorder(tmp_path / "run", HandedFrames(waits=False), only_px=(6, 8))
    recorder.on_frame(Frame.unreadable("damaged", 0.0, "a.png"), None)
    recorder.on_frame(Frame(np.zeros((8, 6), np.uint8), 0.1), None)  # of another size
    for _ in range(frames):
        recorder.on_frame(Frame(np.zeros((6, 8), np.uint8), 0.2), None)
    if noted:
        (tmp_path / "run" / "notes.txt").write_text("the lamp flickers")
    for _ in range(2):
        recorder.close_or_discard()
    assert recorder.kept == frames
    assert (tmp_path / "run").exists() == bool(frames or noted)
    if frames or noted:
        assert len(Run.open(tmp_path / "run")) == frames


def test_a_log_that_is_discarded_removes_no_other_file_of_its_name(tmp_path) -> None:
    path = tmp_path / "log.mcap"
    log = ReadingLog(path)
    log.discard()
    assert not path.exists()
    log = ReadingLog(path)
    path.rename(tmp_path / "moved.mcap")
    path.write_bytes(b"another")
    log.discard()
    assert path.read_bytes() == b"another"
