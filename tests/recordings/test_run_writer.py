"""What a writer accepts is stored once, in order, on one clock; what it cannot take it refuses or counts."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from tests.refusals import refused

from palpate.core import (
    ExistsError,
    ImageError,
    InputError,
    LabelError,
    ManualClock,
    RecordingError,
    StorageError,
)
from palpate.recordings import Manifest, Run, RunWriter, check
from palpate.recordings.exchange import image_files

SECOND = 1_000_000_000


@pytest.fixture
def manifest() -> Manifest:
    return Manifest.new(sensor="s", labels={"depth_mm": "number", "object": "text", "touching": "flag"})


def picture(k: int) -> np.ndarray:
    return np.full((6, 8), k, np.uint8)


def test_what_is_recorded_reads_back_unchanged(tmp_path: Path, manifest: Manifest, rng) -> None:
    grey = rng.integers(0, 256, (30, 41), np.uint8)
    colour = rng.integers(0, 256, (30, 41, 3), np.uint8)
    labels = {"depth_mm": 1.25, "object": "pen", "touching": True}
    with RunWriter.create(tmp_path / "run", manifest, clock=ManualClock()) as new:
        assert new.frame(grey, time_ns=SECOND, exposure_s=0.01, labels=labels)
        assert new.frame(colour, time_ns=2 * SECOND)
        assert new.force([1, 2, 3, 0.1, 0.2, 0.3], time_ns=3 * SECOND)
        assert new.stage([0.001, 0.002, 0.003], time_ns=3 * SECOND)
        assert new.event("press", row=3, at=[1, 2])
    run = Run.open(tmp_path / "run")
    assert run.manifest == manifest
    first, second = run.frames()
    np.testing.assert_array_equal(first.image, grey)
    np.testing.assert_array_equal(second.image, colour)
    assert (first.time_s, second.time_s) == (1.0, 2.0)
    assert (first.exposure_s, second.exposure_s) == (0.01, None)
    assert (first.name, first.sensor) == ("0", "s")
    assert run.labels.iloc[0].to_dict() == labels
    assert run.labels.iloc[1].isna().all()
    assert run.force().to_numpy().tolist() == [[3.0, 1, 2, 3, 0.1, 0.2, 0.3]]
    assert run.stage().to_numpy().tolist() == [[3.0, 0.001, 0.002, 0.003]]
    assert run.events()[["time_s", "kind"]].to_numpy().tolist() == [[0.0, "press"]]
    assert json.loads(run.events()["fields"][0]) == {"row": 3, "at": [1, 2]}
    assert run.damage == ()


def test_the_caller_may_reuse_its_image_at_once(tmp_path: Path, manifest: Manifest) -> None:
    image = picture(0)
    with RunWriter.create(tmp_path / "run", manifest, overflow="wait") as new:
        for k in range(50):
            image[:] = k
            new.frame(image)
    assert [int(frame.image[0, 0]) for frame in Run.open(tmp_path / "run").frames()] == list(range(50))


def test_an_existing_path_is_refused_and_left_alone(tmp_path: Path, manifest: Manifest) -> None:
    (tmp_path / "run").write_text("mine")
    with refused("exists", ExistsError):
        RunWriter.create(tmp_path / "run", manifest)
    assert (tmp_path / "run").read_text() == "mine"


def test_resuming_opens_the_next_segment_and_touches_no_other(tmp_path: Path, manifest: Manifest) -> None:
    path = tmp_path / "run"
    with RunWriter.create(path, manifest) as new:
        new.frame(picture(1), labels={"depth_mm": 1})
        new.force(np.arange(6.0))
    before = {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in path.iterdir()}
    last_s = Run.open(path).force()["time_s"].iloc[-1]
    with RunWriter.resume(path) as new:
        new.frame(picture(2), labels={"depth_mm": 2})
    assert {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in before} == before
    run = Run.open(path)
    assert run.times_s[1] > last_s
    assert run.labels["depth_mm"].tolist() == [1, 2]
    assert run.damage == ()


@pytest.mark.parametrize(
    ("later_ns", "expected_s"),
    [
        pytest.param(25 * SECOND, 15.0, id="same clock"),
        pytest.param(0, 5.000000001, id="new clock"),
    ],
)
def test_a_resumed_run_continues_strictly_later_on_one_clock(
    tmp_path: Path, manifest: Manifest, later_ns: int, expected_s: float
) -> None:
    with RunWriter.create(tmp_path / "run", manifest, clock=ManualClock(10 * SECOND)) as new:
        new.frame(picture(0), time_ns=15 * SECOND)
    with RunWriter.resume(tmp_path / "run", clock=ManualClock(later_ns)) as new:
        new.frame(picture(1))
    assert Run.open(tmp_path / "run").times_s.tolist() == [5.0, expected_s]


def test_an_interrupted_segment_is_followed_by_the_next(tmp_path: Path, manifest: Manifest) -> None:
    path = tmp_path / "run"
    with RunWriter.create(path, manifest) as new:
        for k in range(3):
            new.frame(picture(k), labels={"depth_mm": k})
    os.truncate(path / "0000-frames.mcap", Run.open(path).segments[0].frames[2].chunk.offset + 7)
    with RunWriter.resume(path) as new:
        new.frame(picture(9))
    run = Run.open(path)
    assert [int(frame.image[0, 0]) for frame in run.frames()] == [0, 1, 9]
    assert run.labels["depth_mm"].isna().tolist() == [False, False, True]  # not the lost frame's label


def test_two_writers_on_one_run_are_impossible(tmp_path: Path, manifest: Manifest) -> None:
    with RunWriter.create(tmp_path / "run", manifest) as new:
        with pytest.raises(RecordingError, match="another writer"):
            RunWriter.resume(tmp_path / "run")
        new.frame(picture(0))
    assert len(list((tmp_path / "run").glob("*.mcap"))) == 2
    RunWriter.resume(tmp_path / "run").close()


def test_drops_are_counted_and_recorded_when_the_queue_is_full(
    tmp_path: Path, manifest: Manifest, monkeypatch: pytest.MonkeyPatch
) -> None:
    encode, gate = image_files.encode, threading.Event()

    def slow(image: np.ndarray) -> np.ndarray:
        gate.wait()
        return encode(image)

    monkeypatch.setattr(image_files, "encode", slow)
    with RunWriter.create(tmp_path / "run", manifest, queue_frames=4) as new:
        accepted = [new.frame(picture(k), labels={"depth_mm": k}) for k in range(20)]
        assert new.force(np.zeros(6)), "frames that wait must not push signals out"
        dropped = dict(new.dropped)
        gate.set()
    kept = [k for k, there in enumerate(accepted) if there]
    assert len(kept) in (4, 5)  # four queued, and perhaps one that the thread took before
    assert dropped == {"frames": 20 - len(kept), "force": 0, "stage": 0, "events": 0, "force_raw": 0}
    run = Run.open(tmp_path / "run")
    assert run.labels["depth_mm"].tolist() == kept
    assert check(tmp_path / "run").drops == {"frames": 20 - len(kept)}


def test_several_threads_may_record_at_once(tmp_path: Path, manifest: Manifest) -> None:
    with RunWriter.create(tmp_path / "run", manifest, overflow="wait") as new:

        def record() -> None:
            for k in range(40):
                new.frame(picture(k))
                new.force(np.full(6, k))

        threads = [threading.Thread(target=record) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    run = Run.open(tmp_path / "run")
    assert (len(run), len(run.force())) == (160, 160)
    assert (np.diff(run.times_s) >= 0).all()


@pytest.mark.parametrize("step", [0])
def test_few_messages_are_on_disk_within_a_second_too(tmp_path: Path, manifest: Manifest, step: int) -> None:
    clock = ManualClock()  # the disk keeps the machine's time whatever clock the run is on
    with RunWriter.create(tmp_path / "run", manifest, clock=clock) as new:
        new.frame(picture(0))
        time.sleep(0.1)
        clock.ns += step
        new.force(np.ones(6))
        new.frame(picture(1), labels={"depth_mm": 3})
        time.sleep(1.0)
        run = Run.open(tmp_path / "run")
        assert (len(run), len(run.force())) == (2, 1)
        assert run.labels["depth_mm"].tolist()[1] == 3


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda w: w.force([0, 0, np.nan, 0, 0, 0]), InputError, "finite-numbers"),
        (lambda w: w.force([0, 0, np.inf, 0, 0, 0]), InputError, "finite-numbers"),
        (lambda w: w.force([0, 0, 0]), InputError, "finite-numbers"),
        (lambda w: w.stage([0, 0, -np.inf]), InputError, "finite-numbers"),
        (lambda w: w.frame(picture(0), exposure_s=np.nan), InputError, "finite-numbers"),
        (lambda w: w.frame(picture(0), labels={"weight_g": 1}), LabelError, "label-unknown"),
        (lambda w: w.frame(picture(0), labels={"depth_mm": "deep"}), LabelError, "label-kind"),
        (lambda w: w.frame(picture(0), labels={"depth_mm": np.nan}), LabelError, "label-kind"),
        (lambda w: w.frame(picture(0), labels={"depth_mm": True}), LabelError, "label-kind"),
        (lambda w: w.frame(picture(0), labels={"object": 3}), LabelError, "label-kind"),
        (lambda w: w.frame(picture(0), labels={"touching": 1}), LabelError, "label-kind"),
        (lambda w: w.frame(np.zeros((4, 4, 4), np.uint8)), ImageError, "image-channels"),
        (lambda w: w.frame(picture(0), time_ns=-1), InputError, "time-order"),
        (lambda w: w.frame(picture(0), time_ns=1 << 62), InputError, "time-order"),
        (lambda w: w.event("reading", value=np.nan), InputError, "not-json"),
        (lambda w: w.event("reading", value=object()), InputError, "not-json"),
        (lambda w: w.event("dropped", channel="frames"), InputError, "event-kind"),
    ],
)
def test_what_cannot_be_recorded_is_refused_and_leaves_no_trace(
    tmp_path: Path, manifest: Manifest, call: Callable, error: type[Exception], message: str
) -> None:
    with RunWriter.create(tmp_path / "run", manifest, clock=ManualClock()) as new:
        with refused(message, error):
            call(new)
        new.frame(picture(7))
    run = Run.open(tmp_path / "run")
    assert len(run) == 1
    assert run.labels.isna().all(axis=None)
    assert run.force().empty
    assert run.stage().empty
    assert run.events().empty


def test_time_that_runs_backwards_is_refused(tmp_path: Path, manifest: Manifest) -> None:
    with RunWriter.create(tmp_path / "run", manifest, clock=ManualClock()) as new:
        new.frame(picture(0), time_ns=100)
        new.force(np.zeros(6), time_ns=50)  # another channel has its own order
        with refused("time-order", InputError, match="100"):
            new.frame(picture(1), time_ns=99)


@pytest.mark.parametrize("kwargs", [{"queue_frames": 0}])
def test_a_queue_without_room_is_refused_before_anything_is_made(
    tmp_path: Path, manifest: Manifest, kwargs: dict
) -> None:
    with refused("queue", InputError):
        RunWriter.create(tmp_path / "run", manifest, **kwargs)
    assert list(tmp_path.iterdir()) == []


def test_an_exception_inside_the_block_closes_the_segment(tmp_path: Path, manifest: Manifest) -> None:
    def interrupted() -> None:
        with RunWriter.create(tmp_path / "run", manifest) as new:
            new.frame(picture(5))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    run = Run.open(tmp_path / "run")
    assert (len(run), run.damage) == (1, ())


def test_a_closed_writer_takes_nothing_and_closes_again_in_peace(tmp_path: Path, manifest: Manifest) -> None:
    new = RunWriter.create(tmp_path / "run", manifest)
    new.close()
    new.close()
    with pytest.raises(RecordingError, match="closed"):
        new.frame(picture(0))


def test_an_error_of_the_disk_is_raised_by_close_at_the_latest(
    tmp_path: Path, manifest: Manifest, monkeypatch: pytest.MonkeyPatch
) -> None:
    new = RunWriter.create(tmp_path / "run", manifest)

    def refuse(*_: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("palpate.recordings.segments.mcap_file.os.fsync", refuse)
    new.frame(picture(0))
    with pytest.raises(StorageError, match="Input/output error"):
        new.close()
    assert len(Run.open(tmp_path / "run")) == 1


def test_an_error_of_the_disk_wakes_those_who_wait_for_room(
    tmp_path: Path, manifest: Manifest, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: bytes) -> None:
        time.sleep(0.2)
        raise OSError(28, "No space left on device")

    new = RunWriter.create(tmp_path / "run", manifest, queue_frames=1, overflow="wait")
    monkeypatch.setattr(new._segment.frames._sink, "write", refuse)
    with refused("disk-full", StorageError):
        all(new.frame(picture(k)) for k in range(5))
    with refused("disk-full", StorageError):
        new.close()


def test_other_readers_open_a_segment_and_decode_it(tmp_path: Path, manifest: Manifest, rng) -> None:
    image = rng.integers(0, 256, (20, 30), np.uint8)
    with RunWriter.create(tmp_path / "run", manifest) as new:
        new.frame(image, labels={"depth_mm": 2.5})
        new.force([1, 2, 3, 4, 5, 6])
        new.stage([7, 8, 9])
        new.event("press")
    with (tmp_path / "run/0000-frames.mcap").open("rb") as file:
        counts = make_reader(file, validate_crcs=True).get_summary().statistics.channel_message_counts
    assert sum(counts.values()) == 2  # the segment's note and the frame
    seen = {}
    for kind in ("frames", "signals"):
        with AnyReader([tmp_path / f"run/0000-{kind}.mcap"]) as reader:
            for connection, time_ns, raw in reader.messages():
                message = reader.deserialize(raw, connection.msgtype)
                seen[connection.topic] = message
                if hasattr(message, "header"):
                    stamp = message.header.stamp
                    assert stamp.sec * SECOND + stamp.nanosec == time_ns
    assert seen["/frames"].format == "png"
    np.testing.assert_array_equal(image_files.decode(seen["/frames"].data), image)
    assert seen["/force"].wrench.torque.z == 6
    assert seen["/stage"].point.x == 7
    assert json.loads(seen["/labels"].data) == {"frame": 0, "labels": {"depth_mm": 2.5}}
    assert json.loads(seen["/events"].data)["kind"] == "press"
