"""A packed set gives back prepared frames by row, in little memory, or says that it is damaged."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.refusals import refused

from palpate.core import ExistsError, InputError, ManualClock, RecordingError, StorageError
from palpate.core.files import sha256_of
from palpate.recordings import Manifest, PackedSet, Run, RunWriter, pack
from palpate.recordings.preparation import Preparation

KINDS = {"depth_mm": "number", "image_file": "text", "row": "number"}
SMALL = Preparation(crop_px=(2, 1, 12, 10), size_px=(5, 6), channels=1)


def recorded(
    path: Path, rng: np.random.Generator, count: int = 7, size: tuple[int, ...] = (12, 16, 3)
) -> Run:
    with RunWriter.create(
        path, Manifest.new(sensor="s1", labels=KINDS), clock=ManualClock(), overflow="wait"
    ) as writer:
        for i in range(count):
            labels = {"depth_mm": i / 4, "image_file": f"touch_{i}.png", "row": float(i % 2)}
            writer.frame(rng.integers(0, 256, size, dtype=np.uint8), time_ns=i * 10**9, labels=labels)
    return Run.open(path)


@pytest.fixture
def run(tmp_path: Path, rng: np.random.Generator) -> Run:
    return recorded(tmp_path / "run", rng)


def test_what_is_packed_is_what_preparation_makes_of_each_frame(run, tmp_path, rng):
    packed = pack(run, tmp_path / "packed", SMALL)
    expected = np.stack([SMALL.apply(frame.image) for frame in run.frames()])
    rows = rng.integers(0, len(run), 20)
    assert np.array_equal(packed.read(rows), expected[rows])
    assert np.array_equal(np.load(tmp_path / "packed" / "frames.npy", mmap_mode="r"), expected)
    assert np.array_equal(np.concatenate(list(packed.batches(rows, 6))), expected[rows])
    assert packed.read([]).shape == (0, 5, 6, 1)


def test_the_set_carries_labels_names_times_and_the_runs_hash(run, tmp_path):
    told: list[tuple[int, int]] = []
    made = pack(run, tmp_path / "packed", SMALL, lambda done, total: told.append((done, total)))
    packed = PackedSet.open(made.folder, verify=True)
    assert packed.table["row"].tolist() == [0, 1, 0, 1, 0, 1, 0]  # the user's own, not the position
    assert packed.table["depth_mm"].tolist() == run.labels["depth_mm"].tolist()
    assert packed.names == packed.table["frame"].tolist() == [f"touch_{i}.png" for i in range(7)]
    assert packed.times_s.tolist() == packed.table["time_s"].tolist() == list(range(7))
    assert (packed.run_hash, packed.run_id) == (run.hash, run.manifest.run_id)
    assert packed.units == {"depth_mm": "mm"}
    assert packed.preparation == SMALL
    assert told == [(i, 7) for i in range(1, 8)]


def test_colour_becomes_grey_by_bt601_and_grey_becomes_three_equal_channels():
    primaries = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255]]], np.uint8)
    grey = Preparation(None, (1, 3), 1).apply(primaries)[0, :, 0]
    # ITU-R BT.601: 0.299 R + 0.587 G + 0.114 B, rounded
    assert grey.tolist() == [76, 150, 29]
    assert np.array_equal(
        Preparation(None, (1, 3), 3).apply(grey[None]), np.repeat(grey[None, :, None], 3, axis=2)
    )


def test_a_crop_outside_the_image_names_both_sizes_and_leaves_nothing(run, tmp_path):
    with refused("crop-outside", InputError, match="16x12 px"):
        pack(run, tmp_path / "packed", Preparation((9, 0, 12, 10), (5, 5), 1))
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize(
    ("crop", "size", "word"),
    [
        (None, (0, 5), "preparation-size"),
        ((-1, 0, 4, 4), (4, 4), "preparation-crop"),
        ((0, 0, 0, 4), (4, 4), "preparation-crop"),
    ],
)
def test_a_preparation_that_makes_no_image_is_refused(crop, size, word):
    with refused(word, InputError):
        Preparation(crop, size, 1)


def test_what_is_no_packed_set_is_refused_with_its_code(tmp_path):
    with refused("not-a-packed-set", RecordingError):
        PackedSet.open(tmp_path)


def test_an_empty_run_and_an_existing_folder_are_refused(run, tmp_path, rng):
    with pytest.raises(RecordingError, match="no frames"):
        pack(recorded(tmp_path / "empty", rng, 0), tmp_path / "packed", SMALL)
    (tmp_path / "packed").mkdir()
    with pytest.raises(ExistsError, match="packed"):
        pack(run, tmp_path / "packed", SMALL)


def test_a_disk_that_fills_up_leaves_nothing(run, tmp_path, monkeypatch):
    def full(*_: object) -> bytes:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Preparation, "apply", full)
    with refused("disk-full", StorageError):
        pack(run, tmp_path / "packed", SMALL)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("rows", [[-1], [0, 99]])
def test_a_row_outside_the_set_is_refused(run, tmp_path, rows):
    with refused("index-range", InputError):
        pack(run, tmp_path / "packed", SMALL).read(rows)


def cut_frames(folder: Path) -> None:
    os.truncate(folder / "frames.npy", (folder / "frames.npy").stat().st_size - 1)


def lengthen_frames(folder: Path) -> None:
    with (folder / "frames.npy").open("ab") as file:
        file.write(b"\0")


def drop_index(folder: Path) -> None:
    (folder / "index.csv.gz").unlink()


def edit_card(**changes: object) -> object:
    def edit(folder: Path) -> None:
        card = json.loads((folder / "card.json").read_text())
        (folder / "card.json").write_text(json.dumps(card | changes))

    return edit


def objects_in_frames(folder: Path) -> None:
    np.save(folder / "frames.npy", np.array([{}], dtype=object), allow_pickle=True)


@pytest.mark.parametrize(
    "damage",
    [
        cut_frames,
        lengthen_frames,
        drop_index,
        objects_in_frames,
        edit_card(format="else"),
        edit_card(frames=6),
        edit_card(preparation={"crop_px": None, "size_px": [5, 6], "channels": 2}),
        edit_card(units=None),
    ],
)
def test_a_set_whose_parts_do_not_fit_is_refused_by_name(run, tmp_path, damage):
    folder = pack(run, tmp_path / "packed", SMALL).folder
    damage(folder)
    with pytest.raises(RecordingError, match="packed") as caught:
        PackedSet.open(folder)
    assert caught.value.code in ("packed-damaged", "packed-card")


@pytest.mark.parametrize("name", ["frames.npy", "index.csv.gz"])
def test_a_flipped_byte_is_found_when_asked_to_verify(run, tmp_path, name):
    folder = pack(run, tmp_path / "packed", SMALL).folder
    data = bytearray((folder / name).read_bytes())
    data[-1 if name == "frames.npy" else len(data) // 4] ^= 1
    (folder / name).write_bytes(data)
    with pytest.raises(RecordingError, match=name):
        PackedSet.open(folder, verify=True)


def test_a_set_whose_index_was_written_as_parquet_opens_to_the_same(run, tmp_path):
    pytest.importorskip("pyarrow", reason="needs pyarrow, which reads Parquet")
    packed = pack(run, tmp_path / "packed", SMALL)
    folder = shutil.copytree(packed.folder, tmp_path / "former")
    (folder / "index.csv.gz").unlink()
    labels = run.labels.assign(**{"frame:name": packed.names, "frame:time_s": packed.times_s})
    labels[["frame:name", "frame:time_s", *run.labels]].to_parquet(folder / "index.parquet", index=False)
    sums = json.loads((folder / "card.json").read_text())["sha256"]
    del sums["index.csv.gz"]
    edit_card(sha256=sums | {"index.parquet": sha256_of(folder / "index.parquet")})(folder)
    former = PackedSet.open(folder, verify=True)
    pd.testing.assert_frame_equal(former.table, packed.table)
    assert former.names == packed.names
    assert np.array_equal(former.read(range(len(run))), packed.read(range(len(run))))


def test_a_file_cut_while_in_use_is_noticed(run, tmp_path):
    packed = pack(run, tmp_path / "packed", SMALL)
    cut_frames(packed.folder)
    with refused("file-truncated", RecordingError):
        packed.read([6])


WITH_LITTLE_MEMORY = """
import resource, sys
from pathlib import Path
import numpy as np
from palpate.recordings import PackedSet, pack
from palpate.recordings.run_reader import Run
from palpate.recordings.preparation import Preparation
run = Run.open(Path(sys.argv[1]))
preparation = Preparation(None, (512, 512), 3)
# The libraries load before the limit is set.
pack(run, Path(sys.argv[2], "warm"), Preparation(None, (4, 4), 1)).read([0])
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + int(sys.argv[3]),) * 2)
packed = pack(run, Path(sys.argv[2], "packed"), preparation)
rows = np.random.default_rng(0).permutation(len(packed))
print(sum(int(batch[:, 0, 0, 0].sum()) for batch in packed.batches(rows, 4)), len(packed) * 512 * 512 * 3)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux to bound a process's memory")
def test_a_set_five_times_larger_than_the_memory_allowed_is_packed_and_read(tmp_path, rng):
    run = recorded(tmp_path / "run", rng, count=150, size=(16, 16, 3))
    allowed = 20 * 2**20
    answer = subprocess.run(
        [sys.executable, "-c", WITH_LITTLE_MEMORY, str(run.path), str(tmp_path), str(allowed)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    total, size = map(int, answer.stdout.split())
    assert size >= 5 * allowed
    assert total == sum(int(frame.image[0, 0, 0]) for frame in run.frames())
