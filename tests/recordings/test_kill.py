"""A recording that is killed keeps every frame older than a second, unaltered, and makes none up."""

from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from palpate.recordings import Run, RunWriter, repair

CHILD = Path(__file__).with_name("record_until_killed.py")
SECOND = 1_000_000_000


def picture(number: int) -> np.ndarray:
    return np.random.default_rng(number).integers(0, 256, (24, 32), np.uint8)


def record_and_kill(folder: Path, seed: int) -> int:
    """Start a recording, kill -9 it at a random moment; when that was [ns]."""
    folder.mkdir()
    notes = folder / "notes"
    child = subprocess.Popen([sys.executable, str(CHILD), str(folder / "run"), str(notes), str(seed)])
    try:
        while not notes.exists() or not notes.stat().st_size:
            assert child.poll() is None, "the recording ended by itself"
            time.sleep(0.01)
        time.sleep(np.random.default_rng(seed).uniform(0, 3.5))
        assert child.poll() is None, "the recording ended by itself"
        return time.monotonic_ns()
    finally:
        child.kill()
        child.wait()


def check_what_is_left(folder: Path, killed_ns: int) -> int:
    """Compare what is read with what was accepted; how many frames had to be there."""
    lines = (folder / "notes").read_text().splitlines()
    accepted = dict(map(int, line.split()) for line in lines)
    due = [number for number, at_ns in accepted.items() if at_ns < killed_ns - SECOND]
    run = Run.open(folder / "run")
    assert run.damage, "an interrupted segment says so"
    for k, frame in enumerate(run.frames()):
        np.testing.assert_array_equal(frame.image, picture(k))
    # The very last frame may have been accepted and stored without its note.
    assert len(due) <= len(run) <= len(accepted) + 1
    assert run.labels["number"].tolist()[: len(due)] == due
    known = run.labels["number"].dropna()
    assert (known == known.index).all()
    return len(due)


def kill_many(folder: Path, kills: int, at_once: int) -> int:
    with ThreadPoolExecutor(at_once) as pool:
        killed = list(pool.map(lambda seed: record_and_kill(folder / str(seed), seed), range(kills)))
    return sum(check_what_is_left(folder / str(seed), at_ns) for seed, at_ns in enumerate(killed))


def test_a_killed_recording_keeps_every_frame_older_than_a_second(tmp_path: Path) -> None:
    due = kill_many(tmp_path, kills=2, at_once=2)
    assert due > 100, "the kills came too early to prove anything"
    # What was killed can be continued and repaired.
    path = tmp_path / "0/run"
    readable = len(Run.open(path))
    with RunWriter.resume(path) as writer:
        writer.frame(picture(readable), labels={"number": readable})
    report = repair(path, tmp_path / "repaired")
    assert report.frames == readable + 1
    mended = Run.open(tmp_path / "repaired")
    assert mended.damage == ()
    assert (np.diff(mended.times_s) > 0).all()


@pytest.mark.slow
def test_fifty_killed_recordings_keep_every_frame_older_than_a_second(tmp_path: Path) -> None:
    due = kill_many(tmp_path, kills=50, at_once=5)
    assert due > 1000, "the kills came too early to prove anything"
