"""Ctrl-C in a verb: what is said then holds for what the verb does."""

from __future__ import annotations

import os
import signal
import sys

import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.cli.record.rig_verbs import stopped_by_signals
from palpate.core.errors import DeviceError
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


def test_ctrl_c_in_the_check_of_a_run_speaks_of_no_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("palpate.recordings.check", interrupted)
    result = CliRunner().invoke(app, ["check", "a-run"])
    assert result.exit_code == 130
    assert "probe" not in result.output


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
