"""A disk that is full ends a run, and the end is written: room for it is held from the beginning."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from palpate.core import StorageError
from palpate.recordings import Manifest, Run, RunWriter, check
from palpate.recordings.segments.mcap_file import HeldFile, McapFile

FULL_DISK = """
    import resource, sys
    from pathlib import Path
    import numpy as np
    from palpate.core import StorageError
    from palpate.recordings.manifest import Manifest
    from palpate.recordings.run_writer import RunWriter

    rng = np.random.default_rng(0)
    if sys.argv[2] != "0":
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)  # no file may outgrow it
    writer = RunWriter.create(Path(sys.argv[1]), Manifest.new(sensor="s"), overflow="wait")
    try:
        for k in range(100_000):
            writer.frame(rng.integers(0, 256, (60, 80), np.uint8))
            writer.force([k] * 6)
    except StorageError as e:
        print(k, e)
    for k in range(20):
        writer.event("end", number=k, why="x" * 1000)
    try:
        writer.close()
    except StorageError as e:
        print("closed:", e)
"""


def ended_in_full(path: Path, limit: int) -> Run:
    """A run whose writer was stopped by a full disk, which said so, and then told of the end."""
    child = [sys.executable, "-c", textwrap.dedent(FULL_DISK), str(path), str(limit)]
    said = subprocess.run(child, check=True, capture_output=True, text=True).stdout.splitlines()
    assert "no room left" in said[0]
    assert said[1].startswith("closed: no room left")
    run = Run.open(path)
    rng = np.random.default_rng(0)
    for frame in run.frames():
        np.testing.assert_array_equal(frame.image, rng.integers(0, 256, (60, 80), np.uint8))
    assert len(run) >= int(said[0].split()[0]) - 65, "no more is lost than the queue held"
    assert run.force()["fx_N"].tolist()[: len(run) - 1] == list(range(len(run) - 1))
    ends = run.events().query("kind == 'end'")["fields"].map(json.loads)
    assert [fields["number"] for fields in ends] == list(range(20)), "the end of the run is written"
    assert check(path).sound, "and both files have their index"
    return run


needs_room_held = pytest.mark.skipif(
    not hasattr(os, "posix_fallocate"), reason="this system holds no room on a disk"
)


@needs_room_held
@pytest.mark.parametrize("limit", [400_000, 2_345_678])
@pytest.mark.cases(1)
def test_a_full_disk_reaches_the_caller_and_the_end_of_the_run_is_written(tmp_path: Path, limit: int) -> None:
    run = ended_in_full(tmp_path / "run", limit)
    files = [path.stat().st_size for path in run.path.glob("*.mcap")]
    assert limit / 4 < max(files) <= limit, "most of the disk holds frames"


@needs_room_held
def test_room_for_the_end_is_enough_whatever_was_written(tmp_path: Path, rng) -> None:
    """The file never outgrows what was held for it, at no place and for no message."""
    for kind, chunk_bytes in (("frames", 0), ("signals", 64 * 1024)):
        path = tmp_path / kind
        file = HeldFile(path)
        mcap = McapFile(file, chunk_bytes)
        mcap.start("ros2", "test")
        for k in range(5):
            mcap.add_channel(f"/c{k}", "cdr", mcap.add_schema(f"t{k}", "ros2msg", b"x" * 500))
        promised = []
        for k in range(200):
            data = bytes(int(rng.choice([0, 10, 100, 3000])))
            promised.append(file.tell() + mcap.bytes_to_end(len(data)))
            mcap.add_message(int(rng.integers(1, 6)), k, k, data)
            if rng.random() < 0.1:
                mcap.flush()
            assert file.tell() <= promised[-1]
        mcap.finish()
        file.close()
        assert path.stat().st_size <= promised[-1] < path.stat().st_size + 40_000


@pytest.mark.parametrize("chunk_bytes", [0, 5000])
def test_a_file_is_the_library_s_own_to_the_byte(tmp_path: Path, rng, chunk_bytes: int) -> None:
    with (tmp_path / "theirs").open("wb") as theirs:
        library = Writer(
            theirs, chunk_size=chunk_bytes, compression=CompressionType.NONE, enable_data_crcs=True
        )
        own = HeldFile(tmp_path / "own")
        mcap = McapFile(own, chunk_bytes)
        library.start("ros2", "test")
        mcap.start("ros2", "test")
        for k in range(3):
            number = library.register_schema(f"type{k}", "ros2msg", b"abc" * k)
            assert mcap.add_schema(f"type{k}", "ros2msg", b"abc" * k) == number
            assert library.register_channel(f"/c{k}", "cdr", number) == mcap.add_channel(
                f"/c{k}", "cdr", number
            )
        for k in range(500):
            at, channel, data = (
                int(rng.integers(10**9)),
                int(rng.integers(1, 4)),
                rng.bytes(int(rng.integers(300))),
            )
            library.add_message(channel, at, data, at, k)
            mcap.add_message(channel, at, k, data)
            if rng.random() < 0.05:
                library.flush()
                mcap.flush()
        library.finish()
        mcap.finish()
        own.close()
    assert (tmp_path / "own").read_bytes() == (tmp_path / "theirs").read_bytes()


@needs_room_held
@pytest.mark.parametrize("fails_at", [1, 2], ids=["the first file", "the second file"])
def test_a_segment_whose_beginning_never_fitted_is_no_segment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails_at: int
) -> None:
    path = tmp_path / "run"
    with RunWriter.create(path, Manifest.new(sensor="s")) as writer:
        writer.frame(np.zeros((4, 6), np.uint8))
    hold, files = HeldFile.hold, set()

    def full(self: HeldFile, count: int) -> None:
        files.add(id(self))
        if len(files) >= fails_at:
            raise OSError(errno.ENOSPC, "no room")
        hold(self, count)

    before = sorted(one.name for one in path.iterdir())
    for _ in range(2):
        files.clear()
        with monkeypatch.context() as patch:
            patch.setattr(HeldFile, "hold", full)
            with pytest.raises(StorageError):
                RunWriter.resume(path)
    assert sorted(one.name for one in path.iterdir()) == before
    with RunWriter.resume(path) as writer:
        writer.frame(np.ones((4, 6), np.uint8))
    report = check(path)
    assert (report.sound, report.frames, report.damage) == (True, 2, ())
