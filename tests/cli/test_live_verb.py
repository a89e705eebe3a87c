"""`palpate live`, as typed: what it prints, what it keeps, and that nothing it keeps is ever half."""

import fcntl
import json
import os
import signal
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

import palpate
from palpate.cli import app
from palpate.cli.sense import live_verbs
from palpate.cli.sense.live_verbs import ShownSensor
from palpate.recordings import Run, export_folder
from palpate.recordings.exchange.image_files import encode
from palpate.recordings.segments import scan
from palpate.sensing.live_loop import LiveState

SENSED = ("frame", "time_s", "readings", "drift", "calibration")


def typed(*words: object, status: int = 0):
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == status, result.output
    return result


@pytest.fixture(autouse=True)
def nothing_kept(monkeypatch) -> None:
    """To count all that pytest holds takes half a second."""
    monkeypatch.setattr(live_verbs, "loaded_kept", nullcontext)


@pytest.fixture
def spots(calibrate_spots, record_spots, tmp_path, changes_untried):
    """A calibration, a run, and that run's frames in a lossless video."""
    plan = {"targets": ("x_mm",), "split": "group:press", "size_px": (12, 16), "model": "pca-ridge"}
    run = record_spots("fresh", 2, seed=4)
    video = tmp_path / "taps.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"FFV1"), 20.0, (64, 48), isColor=True)
    for frame in run.frames():
        writer.write(cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR))
    writer.release()
    return calibrate_spots(tmp_path / "cal", **plan)[1], run, video


def readings_of(output: str) -> list[dict]:
    return [json.loads(line) for line in output.splitlines()]


def cut(run: Path) -> Path:
    """The same run as a writer leaves it that is killed: without the index at the end of its files."""
    for file in run.glob("*.mcap"):
        whole = file.read_bytes()
        file.write_bytes(whole[: scan(file).data_end or None])
    return run


def test_a_run_that_its_writer_did_not_close_is_read_named_and_ends_with_status_1(spots) -> None:
    calibration, run, _ = spots
    for words in (
        ("read", cut(run.path), "--with", calibration),
        ("live", calibration, "--camera", run.path, "--wait", 0.1),
    ):
        found = typed(*words, "--json", status=1)
        *readings, last = readings_of(found.stdout)
        assert len(readings) == 12
        assert (last["state"], "not closed by its writer" in last["why"]) == ("ended", True)
        assert found.stderr.count("not closed by its writer") == 1
    with (run.path / "manifest.json").open("r+b") as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # as a writer that is at work does: it has only not gone on
        typed("live", calibration, "--camera", run.path, "--wait", 0.1, "--json")


@pytest.mark.parametrize("changes", [False, True])
def test_frames_of_another_size_than_the_calibration_s_end_it_by_a_message_with_both(
    spots, tmp_path, changes
) -> None:
    calibration, run, _ = spots
    small = tmp_path / "small"
    small.mkdir()
    for i, frame in enumerate(run.frames()):
        (small / f"{i:02}.png").write_bytes(encode(frame.image[:24, :32].copy()).tobytes())
    found = typed(
        "live",
        calibration,
        "--camera",
        small if changes else small / "00.png",
        "--wait",
        0.1,
        "--json",
        status=2,
    )
    assert "32x24 px and the calibration of spots reads 64x48 px" in found.stderr
    assert "calibrate at this one" in found.stderr
    *readings, last = readings_of(found.stdout)
    assert len(readings) == (12 if changes else 1)
    assert last["error"]["code"] == "input"


def test_a_video_is_read_live_as_by_sense_frame_by_frame(spots) -> None:
    calibration, _, video = spots
    sensed = readings_of(typed("read", video, "--with", calibration, "--json").stdout)
    found = readings_of(typed("live", calibration, "--camera", video, "--json").stdout)
    assert len(found) == 12
    assert [{key: one[key] for key in SENSED} for one in found] == sensed
    assert [one["number"] for one in found] == list(range(12))
    assert {one["dropped"] for one in found} == {0}


def test_a_run_and_a_log_keep_all_that_was_read(spots, tmp_path) -> None:
    calibration, run, video = spots
    words = ("live", calibration, "--camera", video, "--json")
    found = readings_of(typed(*words, "--record", tmp_path / "kept", "--mcap", tmp_path / "log.mcap").stdout)
    kept = Run.open(tmp_path / "kept")
    assert not kept.damage
    assert [np.array_equal(a.image, b.image) for a, b in zip(kept.frames(), run.frames(), strict=True)]
    assert np.diff(kept.times_s) == pytest.approx(np.full(11, 0.05), abs=1e-6)
    with (tmp_path / "log.mcap").open("rb") as file:
        logged = [
            (schema.encoding, channel.metadata["source"], json.loads(message.data))
            for schema, channel, message in make_reader(file).iter_messages()
        ]
    assert [one[:2] for one in logged] == [("jsonschema", str(video))] * 12
    same = [key for key in found[0] if key not in ("advice", "image")]
    assert [one[2] for one in logged] == [{key: one[key] for key in same} for one in found]
    refused = typed(*words, "--record", tmp_path / "kept", status=2)
    assert "exists" in refused.stderr


def test_a_command_that_is_refused_leaves_no_run_and_no_log(spots, tmp_path) -> None:
    calibration, run, video = spots
    kept, log = tmp_path / "kept", tmp_path / "log.mcap"
    outputs = ("--record", kept, "--mcap", log)
    small, empty = tmp_path / "small.png", tmp_path / "empty"
    small.write_bytes(encode(np.full((24, 32), 90, np.uint8)).tobytes())
    empty.mkdir()
    dull = tmp_path / "dull"
    dull.mkdir()
    cv2.imwrite(str(dull / "0.png"), np.full((6, 8), 40_000, np.uint16))
    for words, why in (
        ((calibration, "--camera", video, "--camera", "NOSUCHSERIAL"), "serial number"),
        ((calibration, "--camera", small), "calibrate at this one"),
        (("--camera", empty, "--wait", 0.1), "without a frame"),
        (("--camera", dull, "--wait", 0.1), "without a frame that is an image"),
        (("--camera", video, "--compliance", tmp_path / "none.npz"), "force sensor beside"),
    ):
        before = sorted(tmp_path.rglob("*"))
        said = typed("live", *words, *outputs, status=2).stderr
        assert why in said
        assert "kept:" not in said
        assert sorted(tmp_path.rglob("*")) == before
    typed("live", calibration, "--camera", video, *outputs)
    assert len(Run.open(kept)) == len(run) == 12
    assert log.is_file()


def test_what_holds_a_frame_stays_whole_where_the_command_fails_and_is_told(
    spots, tmp_path, monkeypatch
) -> None:
    calibration, run, video = spots
    small = tmp_path / "small"
    small.mkdir()
    for i, frame in enumerate(run.frames()):
        (small / f"{i:02}.png").write_bytes(encode(frame.image[:24, :32].copy()).tobytes())

    def left(name: str, *words: object, status: int) -> str:
        kept, log = tmp_path / name, tmp_path / f"{name}.mcap"
        said = typed("live", *words, "--record", kept, "--mcap", log, status=status).stderr
        assert not Run.open(kept).damage
        assert len(Run.open(kept)) == 12
        with log.open("rb") as file:
            assert make_reader(file).get_summary().statistics.message_count == 12
        assert f"kept: {kept} (12 frames), {log} (12 readings); the next one needs other names" in said
        return said

    left("refused", calibration, "--camera", small, "--wait", 0.1, status=2)
    monkeypatch.setattr(ShownSensor, "summary", lambda self: exec("raise KeyboardInterrupt"))
    assert "nothing half-written" not in left("stopped", "--camera", video, status=130)


def test_several_cameras_are_read_at_once_each_by_its_own_calibration(spots, tmp_path) -> None:
    calibration, run, video = spots
    export_folder(run, tmp_path / "exported")
    folder = tmp_path / "exported" / "images"
    words = ("live", calibration, "--camera", video, "--camera", folder, "--wait", 0.1, "--json")
    found = readings_of(typed(*words, "--record", tmp_path / "kept").stdout)
    for source in (video, folder):
        own = [one for one in found if one["source"] == str(source)]
        assert [one["number"] for one in own] == list(range(12))
    assert len(Run.open(tmp_path / "kept-1")) == len(Run.open(tmp_path / "kept-2")) == 12
    refused = typed(
        "live", calibration, calibration, calibration, "--camera", video, "--camera", folder, status=2
    )
    assert "3 calibrations and 2 cameras" in refused.stderr


@pytest.mark.parametrize(
    ("option", "value", "why"),
    [
        ("--fps", "-3", "--fps -3; it has to be above 0 [Hz] and finite"),
        ("--fps", "inf", "--fps inf; it has to be above 0 [Hz] and finite"),
        ("--exposure-ms", "0", "--exposure-ms 0; it has to be above 0 [ms] and finite"),
        ("--size", "0x480", "width is 0 px; it has to be greater than 0"),
        ("--size", "640x-2", "height is -2 px; it has to be greater than 0"),
    ],
)
def test_a_setting_that_no_camera_has_is_named_as_it_was_typed(option: str, value: str, why: str) -> None:
    said = typed("live", "--camera", "0", option, value, status=2).stderr
    assert why in said
    assert "UvcSettings" not in said  # no object of the program


def test_a_camera_that_is_lost_and_comes_back_is_told(capsys) -> None:
    loop = SimpleNamespace(name="camera 4B2D", state=LiveState.LIVE, why="")
    shown = ShownSensor(SimpleNamespace(loop=loop), None)
    for state, why in (
        (LiveState.LIVE, ""),
        (LiveState.LOST, "it was unplugged"),
        (LiveState.LOST, "it is not there"),
        (LiveState.LIVE, ""),
    ):
        loop.state, loop.why = state, why
        shown.tell_state()
    lost, back = capsys.readouterr().err.splitlines()
    assert lost == "camera 4B2D lost: it was unplugged; it is opened again when it comes back"
    assert back == "camera 4B2D is back"


LIVE = "from palpate.cli import main; main()"


def started(words: list[str], **options) -> subprocess.Popen:
    source = str(Path(palpate.__file__).parents[1])
    return subprocess.Popen(
        [sys.executable, "-c", LIVE, "live", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": source},
        **options,
    )


@pytest.mark.skipif(sys.platform == "win32", reason="a process is told to end by POSIX signals")
@pytest.mark.parametrize(
    "name", ["SIGINT", *(pytest.param(name, marks=pytest.mark.slow) for name in ("SIGTERM", "SIGHUP"))]
)
def test_who_ends_it_leaves_run_and_log_whole(spots, tmp_path, name) -> None:
    _, run, _ = spots
    images = b"".join(encode(frame.image).tobytes() for frame in run.frames())
    run_, log = tmp_path / "kept", tmp_path / "log.mcap"
    words = ["--camera", "-", "--json", "--record", str(run_), "--mcap", str(log)]
    process = started(words, stdin=subprocess.PIPE)
    process.stdin.write(images)
    process.stdin.flush()
    lines = [process.stdout.readline() for _ in range(12)]
    process.send_signal(getattr(signal, name))
    _, said = process.communicate(timeout=30)
    assert process.returncode == 0, said
    assert [json.loads(line)["number"] for line in lines] == list(range(12))
    kept = Run.open(run_)
    assert not kept.damage
    assert len(kept) == 12
    with log.open("rb") as file:
        assert make_reader(file).get_summary().statistics.message_count == 12
    assert b"12 frames" in said


def test_a_folder_of_which_no_image_can_be_read_is_no_success_and_the_reason_is_told(tmp_path) -> None:
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((6, 8), 40_000, np.uint16))
    said = typed("live", "--camera", tmp_path, "--wait", "0.1", status=2).output
    assert "ended without a frame that is an image" in said
    assert "has more than 8 bits a channel" in said
    cv2.imwrite(str(tmp_path / "2.png"), np.full((6, 8), 90, np.uint8))
    said = typed("live", "--camera", tmp_path, "--wait", "0.1").output
    assert "3 frames, 0 dropped, 0 lost, 2 broken" in said


@pytest.mark.parametrize("option", ["--seconds", "--frames", "--wait"])
@pytest.mark.parametrize("value", ["0", "-3", "nan"])
def test_an_end_that_never_comes_is_refused(option, value) -> None:
    said = typed("live", "--camera", "virtual:tactip", option, value, status=2).output
    assert option in said
    assert "Traceback" not in said


def test_a_reader_that_goes_as_head_does_ends_it_without_a_word(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for k in range(3):
        (tmp_path / "frames" / f"{k}.png").write_bytes(encode(np.full((48, 64), 40 * k, np.uint8)))
    code = "from palpate.cli import main; main()"
    line = ["live", "--camera", str(tmp_path / "frames"), "--record", str(tmp_path / "run")]
    with subprocess.Popen(
        [sys.executable, "-c", code, *line], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.close()
        told = process.stderr.read().decode() if process.stderr is not None else ""
        assert (process.wait(60), told) == (141, "")
    assert len(Run.open(tmp_path / "run")) > 0
