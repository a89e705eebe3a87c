"""A check says what a run holds, at which rates, with which gaps, and what is wrong with it."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import ManualClock, RecordingError
from palpate.recordings import Manifest, RunWriter, check
from palpate.recordings.segments.segment_reader import scan
from palpate.reports.terminal_text import check_text

SECOND = 1_000_000_000
LABELS = {"depth_mm": "number", "press": "number", "object": "text", "touching": "flag"}


def record(path: Path, manifest: Manifest) -> None:
    """Frames at 0, 1, 2 and 5 s, the third like the second; force at 10 Hz for 5 s."""
    with RunWriter.create(path, manifest, clock=ManualClock()) as new:
        for k, (time_s, grey) in enumerate([(0, 10), (1, 20), (2, 20), (5, 30)]):
            labels = {"depth_mm": k, "touching": True} if k else None
            new.frame(np.full((4, 5), grey, np.uint8), time_ns=time_s * SECOND, labels=labels)
        for k in range(51):
            new.force([0] * 6, time_ns=k * SECOND // 10)


def test_a_check_reports_rates_gaps_labels_and_duplicates(tmp_path: Path) -> None:
    record(tmp_path / "run", Manifest.new(sensor="tactip-3", labels=LABELS))
    report = check(tmp_path / "run")
    assert (report.frames, report.duration_s, report.segments, report.sensor) == (4, 5.0, 1, "tactip-3")
    frames, force = report.channels["frames"], report.channels["force"]
    assert (frames.count, frames.rate_Hz, frames.longest_gap_s) == (4, pytest.approx(3 / 5), 3.0)
    assert (force.count, force.rate_Hz, force.longest_gap_s) == (51, pytest.approx(10), pytest.approx(0.1))
    assert report.channels["stage"].count == 0
    assert report.channels["stage"].rate_Hz is None
    assert report.labels == {"depth_mm": "mm", "press": None, "object": None, "touching": None}
    assert report.missing_labels == {"depth_mm": 1, "press": 4, "object": 4, "touching": 1}
    assert report.duplicated_frames == 1
    assert (report.drops, report.damage, report.sound) == ({}, (), True)


def test_the_pause_between_segments_is_neither_duration_nor_gap(tmp_path: Path) -> None:
    record(tmp_path / "run", Manifest.new(sensor="s", labels=LABELS))
    with RunWriter.resume(tmp_path / "run", clock=ManualClock(1000 * SECOND)) as new:
        for k in range(2):
            new.frame(np.full((4, 5), 40 + k, np.uint8), time_ns=(1000 + k) * SECOND)
    report = check(tmp_path / "run")
    assert (report.segments, report.frames, report.duration_s) == (2, 6, 6.0)
    assert report.channels["frames"].longest_gap_s == 3.0


def test_a_damaged_run_is_reported_as_not_sound_and_as_far_as_it_can_be_read(tmp_path: Path) -> None:
    record(tmp_path / "run", Manifest.new(sensor="s", labels=LABELS))
    file = tmp_path / "run/0000-frames.mcap"
    os.truncate(file, file.stat().st_size - 1)
    report = check(tmp_path / "run")
    assert (report.frames, report.sound) == (4, False)
    assert [found.file for found in report.damage] == ["0000-frames.mcap"]
    assert json.loads(json.dumps(report.to_dict()))["damage"][0]["file"] == "0000-frames.mcap"


@pytest.mark.parametrize("cut", ["frames", "signals"])
def test_frames_without_a_record_and_records_without_a_frame_are_told_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: str
) -> None:
    monkeypatch.setattr("palpate.recordings.run_writer.SYNC_EVERY_S", 0.0)  # a chunk for each message
    with RunWriter.create(tmp_path / "run", Manifest.new(sensor="s", labels=LABELS)) as new:
        for k in range(9):
            new.frame(np.full((4, 5), k, np.uint8), labels={"depth_mm": k} if k % 2 else None)
            while new._buffer._items:
                time.sleep(0.001)
    whole = check(tmp_path / "run")
    assert (whole.orphan_frames, whole.orphan_records) == (0, 0)
    file = tmp_path / f"run/0000-{cut}.mcap"
    counts = []
    for chunk in reversed(scan(file).chunks):
        os.truncate(file, chunk.offset)
        report = check(tmp_path / "run")
        assert (report.orphan_frames == 0) or cut == "signals"
        assert (report.orphan_records == 0) or cut == "frames"
        counts.append(report.orphan_frames + report.orphan_records)
    assert counts[0] == 1
    assert counts == sorted(counts)
    assert counts[-1] == 9
    said = check_text(report)
    assert ("9 frames" in said) == (cut == "signals")
    assert ("9 records" in said) == (cut == "frames")


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with refused("not-a-run", RecordingError):
        check(tmp_path)
