"""Ctrl-C in a verb: what is said then holds for what the verb does."""

import os
import signal
import sys

import numpy as np
import pytest
from click.testing import CliRunner as ClickRunner
from tests.cli.walked_commands import commands
from typer.main import get_command
from typer.testing import CliRunner

from palpate.cli import app
from palpate.cli.record.rig_verbs import stopped_by_signals
from palpate.core.errors import DeviceError
from palpate.recordings import RunWriter
from palpate.rig.rig_check import check_rig
from palpate.rig.virtual import virtual_rig


@pytest.mark.parametrize(
    "words",
    [
        ["home", "virtual:palm"],
        ["jog", "virtual:palm", "--axis", "z", "--mm", "1"],
        ["zero", "virtual:palm"],
        ["check", "virtual:palm"],
    ],
)
def test_ctrl_c_in_a_verb_that_moves_a_stage_speaks_of_the_stage(
    monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("palpate.rig.commissioning.bench.open_bench", interrupted)
    monkeypatch.setattr("palpate.rig.rig_check.check_rig", interrupted)
    result = CliRunner().invoke(app, ["rig", *words])
    assert result.exit_code == 130
    assert "the probe is not lifted" in result.output
    assert "calibration" not in result.output


def test_ctrl_c_ends_every_command_with_one_line_and_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(**_: object) -> None:
        raise KeyboardInterrupt

    tried, root = 0, get_command(app)  # the commands of this tree alone are replaced
    for words, command in commands(root):
        if hasattr(command, "commands") or hasattr(command, "kinds"):
            continue
        monkeypatch.setattr(command, "params", [])
        monkeypatch.setattr(command, "callback", interrupted)
        result = ClickRunner().invoke(root, list(words))
        assert result.exit_code == 130, (words, result.output)
        assert len(result.stderr.splitlines()) == 1
        tried += 1
    assert tried > 70


@pytest.mark.parametrize("close", [True, False])
def test_a_rigs_check_that_is_interrupted_in_a_move_stops_the_stage(close: bool) -> None:
    rig = virtual_rig()
    stopped, looks, sleep = list[bool](), 0, rig.clock.sleep

    def interrupt(seconds: float) -> None:
        nonlocal looks
        sleep(seconds)
        if rig.stage.moving() and not stopped:
            looks += 1
            if looks == 5:
                stopped.append(True)
                raise KeyboardInterrupt

    rig.clock.sleep = interrupt  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        check_rig(rig, close=close)
    assert stopped
    if close:
        with pytest.raises(DeviceError):
            rig.stage.position_m()
    else:
        assert not rig.stage.moving()
        rig.close()


@pytest.mark.skipif(sys.platform == "win32", reason="a process is told to end by POSIX signals")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_second_signal_does_not_cut_short_the_stop_that_the_first_began(name: str) -> None:
    asked, ended = getattr(signal, name), list[bool]()

    def stop_twice() -> None:
        try:
            os.kill(os.getpid(), asked)
        finally:
            os.kill(os.getpid(), asked)
            ended.append(True)

    kept = signal.signal(
        asked, signal.default_int_handler
    )  # nohup, under which tests may run, has one ignored
    with stopped_by_signals(), pytest.raises(KeyboardInterrupt):
        stop_twice()
    signal.signal(asked, kept)
    assert ended


def test_frames_that_a_kill_left_without_labels_are_left_out_of_a_calibration_and_counted(
    record_spots, tmp_path, changes_untried, figures_blank
) -> None:
    run = record_spots("killed", 12)
    with RunWriter.resume(run.path) as writer:
        for _ in range(3):  # shown, and killed before they were labelled
            writer.frame(np.asarray(run.frame(0).image))
    words = [
        "--targets",
        "x_mm",
        "--size",
        "6x8",
        "--model",
        "pca-ridge",
        "--split",
        "group:press",
        "--quiet",
    ]
    done = CliRunner().invoke(app, ["calibrate", str(run.path), *words, "--out", str(tmp_path / "cal")])
    assert done.exit_code == 0, done.output
    told = f"{run.path}: 3 frames have no label at all"
    assert told in done.stderr
    assert f"the other {len(run)} are used" in done.stderr
    scored = CliRunner().invoke(
        app, ["evaluate", str(tmp_path / "cal"), str(run.path), "--quiet", "--no-keep"]
    )
    assert scored.exit_code == 0, scored.output
    assert told in scored.stderr
    with RunWriter.resume(run.path) as writer:  # a label is missing: that is no kill, and is not guessed
        labels = {"press": "press-000", "height_mm": 1.0, "flat_mm": 1.0, "reference": False}
        writer.frame(np.asarray(run.frame(0).image), labels=labels)
    refused = CliRunner().invoke(app, ["calibrate", str(run.path), *words, "--out", str(tmp_path / "other")])
    assert refused.exit_code == 2
    assert "'x_mm' holds no finite number in row" in refused.stderr
