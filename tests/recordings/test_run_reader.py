"""A run yields what was written and nothing else, however its files were cut or changed."""

from __future__ import annotations

import json
import os
import shutil
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from mcap.writer import MCAP0_MAGIC
from tests.refusals import refused

from palpate.core import ImageError, ManualClock, PalpateError, RangeError, RecordingError
from palpate.recordings import Manifest, Run, RunWriter, check, repair
from palpate.recordings.exchange import image_files
from palpate.recordings.segments import segment_writer
from palpate.recordings.segments.segment_reader import scan

SECOND = 1_000_000_000
FRAMES = 3


def picture(k: int) -> np.ndarray:
    return np.random.default_rng(k).integers(0, 256, (3, 4), np.uint8)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of three frames, their labels and three forces, each signal in a chunk of its own."""
    path = tmp_path_factory.mktemp("written") / "run"
    manifest = Manifest.new(sensor="s", labels={"depth_mm": "number"})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.recordings.run_writer.SYNC_EVERY_S", 0.0)
        with RunWriter.create(path, manifest, clock=ManualClock()) as new:
            for k in range(FRAMES):
                new.frame(picture(k), time_ns=k * SECOND, labels={"depth_mm": k + 0.5})
                new.force([k] * 6, time_ns=k * SECOND)
    assert Run.open(path).damage == ()
    return path


@pytest.fixture
def run(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(written, tmp_path / "run"))


def assert_nothing_altered(run: Run) -> int:
    """Whatever can be read is what was written; returns how many frames that is."""
    readable = 0
    for index in range(len(run)):
        try:
            frame = run.frame(index)
        except RecordingError:
            continue
        k = round(frame.time_s)
        assert frame.time_s == k
        np.testing.assert_array_equal(frame.image, picture(k))
        assert run.labels["depth_mm"][index] in (k + 0.5, np.nan) or np.isnan(run.labels["depth_mm"][index])
        readable += 1
    force = run.force()
    assert (force["fx_N"] == force["time_s"]).all()
    assert len(force) <= FRAMES
    return readable


EVERY_BYTE = pytest.mark.parametrize("step", [pytest.param(1, marks=pytest.mark.slow), 131])


@pytest.mark.parametrize("name", ["0000-frames.mcap", "0000-signals.mcap"])
def test_a_file_cut_at_every_byte_yields_the_chunks_before_the_cut(run: Path, name: str) -> None:
    path = run / name
    whole = [(chunk.offset, chunk.length, chunk.channels, chunk.end_ns) for chunk in scan(path).chunks]
    for size in reversed(range(0, path.stat().st_size, 11)):
        os.truncate(path, size)
        cut = scan(path)
        found = [(chunk.offset, chunk.length, chunk.channels, chunk.end_ns) for chunk in cut.chunks]
        assert found == [chunk for chunk in whole if chunk[0] + chunk[1] <= size]
        assert cut.damage


@EVERY_BYTE
def test_frames_cut_at_any_byte_yield_all_before_the_cut(run: Path, step: int) -> None:
    path = run / "0000-frames.mcap"
    ends = [chunk.offset + chunk.length for chunk in scan(path).chunks[1:]]
    for size in reversed(range(0, path.stat().st_size, step)):
        os.truncate(path, size)
        cut = Run.open(run)
        assert len(cut) == sum(end <= size for end in ends)
        assert assert_nothing_altered(cut) == len(cut)
        assert any(found.file == path.name for found in cut.damage)


@EVERY_BYTE
def test_signals_cut_at_any_byte_yield_all_before_the_cut(run: Path, step: int) -> None:
    path = run / "0000-signals.mcap"
    chunks = scan(path).chunks
    for size in reversed(range(0, path.stat().st_size, step)):
        os.truncate(path, size)
        cut = Run.open(run)
        whole = [chunk for chunk in chunks if chunk.offset + chunk.length <= size]
        ids = {
            name: segment_writer.channel_id("signals", name)
            for name in (segment_writer.LABELS, segment_writer.FORCE)
        }
        assert len(cut.force()) == sum(ids[segment_writer.FORCE] in chunk.channels for chunk in whole)
        known = cut.labels["depth_mm"].dropna()
        assert len(known) == sum(ids[segment_writer.LABELS] in chunk.channels for chunk in whole)
        assert (known == known.index + 0.5).all()
        assert any(found.file == path.name for found in cut.damage)
        assert len(cut) == FRAMES


@pytest.mark.parametrize("name", ["0000-frames.mcap", "0000-signals.mcap"])
@pytest.mark.parametrize("closed", [True, False])
@EVERY_BYTE
@pytest.mark.cases(2)
def test_no_flipped_byte_passes_unseen_or_alters_anything(
    run: Path, name: str, closed: bool, step: int
) -> None:
    path = run / name
    if not closed:  # as its writer leaves it when killed
        os.truncate(path, scan(path).data_end)
    with path.open("r+b", buffering=0) as file:
        for at in range(0, path.stat().st_size, step):
            file.seek(at)
            old = file.read(1)
            file.seek(at)
            file.write(bytes([old[0] ^ 0x41]))
            flipped = Run.open(run)
            assert_nothing_altered(flipped)
            assert flipped.damage, at
            file.seek(at)
            file.write(old)


def test_a_flipped_frame_of_a_closed_segment_raises_and_moves_no_other(run: Path) -> None:
    path = run / "0000-frames.mcap"
    chunk = Run.open(run).segments[0].frames[1].chunk
    with path.open("r+b") as file:
        file.seek(chunk.offset + chunk.length - 20)
        file.write(b"\0\1\2\3")
    damaged = Run.open(run)
    assert len(damaged) == FRAMES
    with refused("segment-damaged", RecordingError, match=str(chunk.offset)):
        damaged.frame(1)
    np.testing.assert_array_equal(damaged.frame(2).image, picture(2))
    assert [(found.file, found.at_byte) for found in damaged.damage] == [(path.name, chunk.offset)]


def test_a_flipped_chunk_of_signals_is_left_out_and_told(run: Path) -> None:
    path = run / "0000-signals.mcap"
    force = [
        c
        for c in scan(path).chunks
        if segment_writer.channel_id("signals", segment_writer.FORCE) in c.channels
    ]
    with path.open("r+b") as file:
        file.seek(force[0].offset + force[0].length - 1)
        file.write(b"\xaa")
    damaged = Run.open(run)
    assert damaged.force()["fx_N"].tolist() == [1, 2]
    assert [found.at_byte for found in damaged.damage] == [force[0].offset]


def test_a_missing_file_of_a_segment_is_told(run: Path) -> None:
    (run / "0000-signals.mcap").unlink()
    damaged = Run.open(run)
    assert len(damaged) == FRAMES
    assert damaged.labels["depth_mm"].isna().all()
    assert [(found.file, found.at_byte) for found in damaged.damage] == [("0000-signals.mcap", 0)]


def test_a_missing_segment_is_told(run: Path) -> None:
    for kind in ("frames", "signals"):
        (run / f"0000-{kind}.mcap").rename(run / f"0001-{kind}.mcap")
    assert {found.file for found in Run.open(run).damage} == {"0000-frames.mcap", "0000-signals.mcap"}


def test_a_run_without_segments_is_empty_and_says_so(run: Path) -> None:
    for path in run.glob("*.mcap"):
        path.unlink()
    empty = Run.open(run)
    assert len(empty) == 0
    assert empty.damage


def spoilt(name: str) -> Callable[[Path], None]:
    """A way to spoil the manifest of a run."""

    def one_byte(path: Path) -> None:
        data = bytearray(path.read_bytes())
        data[len(data) // 3] ^= 0x80
        path.write_bytes(data)

    ways: dict[str, Callable[[Path], object]] = {
        "one byte is broken": one_byte,
        "another unit": lambda path: path.write_text(path.read_text().replace('"mm"', '"um"')),
        "it is gone": Path.unlink,
        "it is huge": lambda path: os.truncate(path, 1 << 40),
    }
    return lambda run: (ways[name](run / "manifest.json"), None)[1]


SPOILT = ("one byte is broken", "another unit", "it is gone", "it is huge")


@pytest.mark.parametrize("how", SPOILT)
def test_a_run_whose_manifest_is_spoilt_is_read_by_the_copy_in_its_segments(
    written: Path, run: Path, tmp_path: Path, how: str
) -> None:
    sound = Run.open(written)
    spoilt(how)(run)
    before = {path: path.read_bytes() for path in run.glob("*.mcap")}
    with pytest.warns(UserWarning, match=r"manifest\.json"):
        read = Run.open(run)
    assert read.manifest == sound.manifest
    assert assert_nothing_altered(read) == FRAMES
    assert read.hash == sound.hash, "it is the same data, and certificates name it so"
    with pytest.warns(UserWarning, match="instead"):
        report = check(run)
    assert [found.file for found in report.damage] == ["manifest.json"]
    assert not report.sound
    with pytest.warns(UserWarning, match="instead"):
        repair(run, tmp_path / "mended")
    assert check(tmp_path / "mended").sound
    assert {path: path.read_bytes() for path in run.glob("*.mcap")} == before


@pytest.mark.parametrize("how", SPOILT)
def test_a_run_whose_manifest_is_spoilt_goes_on_and_loses_nothing(run: Path, how: str) -> None:
    spoilt(how)(run)
    size = (run / "manifest.json").stat().st_size if (run / "manifest.json").exists() else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with RunWriter.resume(run, clock=ManualClock(9 * SECOND)) as new:
            new.frame(picture(9), labels={"depth_mm": 9.5})
        again = Run.open(run)
    assert len(again) == FRAMES + 1
    assert again.segments[1].manifest == again.segments[0].manifest
    if size is not None:
        assert (run / "manifest.json").stat().st_size == size, "what is there is not overwritten"
    else:
        assert check(run).sound, "a manifest that is gone is written again"


def test_without_a_copy_a_spoilt_manifest_is_an_error(run: Path) -> None:
    spoilt("one byte is broken")(run)
    for path in run.glob("*.mcap"):
        path.unlink()
    with refused("manifest-damaged", RecordingError, match=r"manifest\.json"):
        Run.open(run)


def test_a_segment_of_another_run_is_left_out_and_told(run: Path, tmp_path: Path) -> None:
    with RunWriter.create(tmp_path / "other", Manifest.new(sensor="t")) as new:
        new.frame(picture(9))
    for kind in ("frames", "signals"):
        shutil.copy(tmp_path / f"other/0000-{kind}.mcap", run / f"0001-{kind}.mcap")
    mixed = Run.open(run)
    assert len(mixed) == FRAMES
    assert ["another run" in found.what for found in mixed.damage] == [True]


def test_times_are_seconds_since_the_run_began(written: Path) -> None:
    assert Run.open(written).times_s.tolist() == [0, 1, 2]


@pytest.mark.parametrize("index", [-1, FRAMES])
def test_an_index_that_is_not_there_is_refused(written: Path, index: int) -> None:
    with refused("index-range", RangeError):
        Run.open(written).frame(index)


def test_the_hash_names_the_data_and_not_the_folder(written: Path, run: Path) -> None:
    assert Run.open(written).hash == Run.open(run).hash
    with (run / "0000-signals.mcap").open("ab") as file:
        file.write(b"\0")
    assert Run.open(written).hash != Run.open(run).hash


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0), "image-size"),
        (struct.pack(">IIBBBBB", 0, 4, 8, 0, 0, 0, 0), "image-size"),
        (struct.pack(">IIBBBBB", 4, 4, 16, 0, 0, 0, 0), "pixel-format"),
        (struct.pack(">IIBBBBB", 4, 4, 8, 3, 0, 0, 0), "pixel-format"),
    ],
)
def test_a_png_is_judged_by_its_header_before_it_is_decoded(header: bytes, message: str) -> None:
    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")
    with refused(message, ImageError):
        image_files.decode(np.frombuffer(data, np.uint8))


def read_everything(path: Path) -> None:
    """Everything a caller can ask a run for; only palpate's own errors may come of it."""
    for ask in (
        lambda run: list(run.frames()),
        lambda run: run.labels,
        lambda run: run.force(),
        lambda run: run.stage(),
        lambda run: run.events(),
        lambda run: run.damage,
        lambda run: run.hash,
        lambda run: check(run.path),
    ):
        try:
            ask(Run.open(path))
        except PalpateError:
            continue


def overwrite(run: Path, name: str, data: bytes) -> None:
    (run / name).write_bytes(data)


@pytest.fixture(scope="module")
def scratch(written: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(written, tmp_path_factory.mktemp("scratch") / "run"))


NAMES = st.sampled_from(["0000-frames.mcap", "0000-signals.mcap"])


@settings(max_examples=12)
@given(
    name=NAMES,
    records=st.lists(
        st.tuples(st.integers(0, 16), st.integers(0, 6), st.binary(max_size=120)), min_size=1, max_size=5
    ),
)
def test_arbitrary_messages_with_good_checksums_raise_nothing_but_our_own_errors(
    scratch: Path, name: str, records: list[tuple[int, int, bytes]]
) -> None:
    body = b""
    for opcode, channel, payload in records:
        inside = struct.pack("<HIQQ", channel, 0, 5, 5) + b"\0\1\0\0" + payload
        body += struct.pack("<BQ", opcode, len(inside)) + inside
    chunk = struct.pack("<QQQIIQ", 0, 0, len(body), zlib.crc32(body), 0, len(body)) + body
    overwrite(scratch, name, MCAP0_MAGIC + struct.pack("<BQ", 6, len(chunk)) + chunk)
    read_everything(scratch)


@settings(max_examples=12)
@given(
    channel=st.sampled_from([segment_writer.SEGMENT, segment_writer.LABELS, segment_writer.EVENTS]),
    value=st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(
                    ["frame", "labels", "depth_mm", "exposure_s", "kind", "fields", "run_id", "count"]
                ),
                inner,
                max_size=4,
            )
        ),
    ),
)
def test_arbitrary_json_in_a_segment_raises_nothing_but_our_own_errors(
    written: Path, scratch: Path, channel: segment_writer.Channel, value: object
) -> None:
    text = json.dumps(value).encode() + b"\0"
    inside = struct.pack("<HIQQ", segment_writer.channel_id("signals", channel), 0, 5, 5)
    inside += b"\0\1\0\0" + struct.pack("<I", len(text)) + text
    body = struct.pack("<BQ", 5, len(inside)) + inside
    chunk = struct.pack("<QQQIIQ", 0, 0, len(body), zlib.crc32(body), 0, len(body)) + body
    shutil.copy(written / "0000-frames.mcap", scratch)
    overwrite(scratch, "0000-signals.mcap", MCAP0_MAGIC + struct.pack("<BQ", 6, len(chunk)) + chunk)
    read_everything(scratch)


@settings(max_examples=8)
@given(data=st.data())
def test_a_segment_changed_in_several_places_raises_nothing_but_our_own_errors(
    written: Path, scratch: Path, data: st.DataObject
) -> None:
    name = data.draw(NAMES)
    shutil.copytree(written, scratch, dirs_exist_ok=True)
    content = bytearray((written / name).read_bytes())
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=6)):
        content[at] = data.draw(st.sampled_from([0, 1, 0x7F, 0xFF]))
    overwrite(scratch, name, bytes(content))
    read_everything(scratch)
    assert_nothing_altered(Run.open(scratch))
