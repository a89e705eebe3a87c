"""A repair copies what is readable into a new, sound run and says what was lost."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import ManualClock, RecordingError
from palpate.recordings import Manifest, Run, RunWriter, repair

SECOND = 1_000_000_000


def picture(k: int) -> np.ndarray:
    return np.random.default_rng(k).integers(0, 256, (5, 7), np.uint8)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Five frames with labels and forces, two events, in two segments: 0 to 2 and 3 to 4."""
    path = tmp_path / "run"
    manifest = Manifest.new(sensor="s", origin="the bench", labels={"depth_mm": "number"})
    clock = ManualClock()
    for numbers in ((0, 1, 2), (3, 4)):
        clock.ns = numbers[0] * SECOND
        resumed = RunWriter.resume(path, clock=clock) if path.exists() else None
        with resumed or RunWriter.create(path, manifest, clock=clock) as new:
            for k in numbers:
                clock.ns = k * SECOND
                new.frame(picture(k), labels={"depth_mm": k})
                new.force([k] * 6)
            new.event("end", of=list(numbers))
    return path


def spoil(run: Path, segment: int, frame: int) -> None:
    chunk = Run.open(run).segments[segment].frames[frame].chunk
    with (run / f"{segment:04d}-frames.mcap").open("r+b") as file:
        file.seek(chunk.offset + chunk.length - 30)
        file.write(b"\x11\x22\x33")


def test_a_repaired_run_is_sound_and_holds_all_that_was_readable(run: Path, tmp_path: Path) -> None:
    spoil(run, segment=0, frame=1)
    frames = run / "0001-frames.mcap"
    os.truncate(frames, frames.stat().st_size // 2)
    spoiled = [found.file for found in Run.open(run).damage]
    before = {path: path.read_bytes() for path in run.iterdir()}
    report = repair(run, tmp_path / "new")
    assert {path: path.read_bytes() for path in run.iterdir()} == before
    new = Run.open(tmp_path / "new")
    assert new.damage == ()
    kept = [round(t) for t in new.times_s]
    assert {0, 2} <= set(kept)
    assert 1 not in kept
    assert report.frames == len(kept)
    for k, frame in zip(kept, new.frames(), strict=True):
        np.testing.assert_array_equal(frame.image, picture(k))
    assert new.labels["depth_mm"].tolist() == kept, "labels stay with their frames"
    assert new.force()["fx_N"].tolist() == [0, 1, 2, 3, 4]
    assert new.events()["kind"].tolist() == ["end", "end"]
    lost = [found.file for found in report.lost]
    assert set(spoiled) <= set(lost)
    assert sum("labels belong" in found.what for found in report.lost) == 2


def test_a_sound_run_is_copied_whole_and_loses_nothing(run: Path, tmp_path: Path) -> None:
    report = repair(run, tmp_path / "new")
    assert (report.frames, report.messages, report.lost) == (5, 12, ())
    old, new = Run.open(run), Run.open(tmp_path / "new")
    assert old.times_s.tolist() == new.times_s.tolist()
    assert old.labels.equals(new.labels)
    assert old.force().equals(new.force())
    assert old.events().equals(new.events())


def test_a_repaired_run_keeps_its_identity_and_names_its_source(run: Path, tmp_path: Path) -> None:
    repair(run, tmp_path / "new")
    old, new = Run.open(run), Run.open(tmp_path / "new")
    assert new.manifest.run_id == old.manifest.run_id
    assert old.hash in new.manifest.origin
    same = {"origin": ""}
    assert new.manifest.model_copy(update=same) == old.manifest.model_copy(update=same)


def test_a_run_without_segments_has_nothing_to_repair(run: Path, tmp_path: Path) -> None:
    for path in run.glob("*.mcap"):
        path.unlink()
    with refused("no-segments", RecordingError):
        repair(run, tmp_path / "new")
    assert not (tmp_path / "new").exists()
