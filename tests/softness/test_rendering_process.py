"""A rendering in its own process: it tells how it goes, and is safe whatever becomes of whoever began it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import DeviceError, InputError, RangeError, SafetyError
from palpate.devices.supervisor import process_link
from palpate.softness import Characteristic, Mode, SoftObject
from palpate.softness.process import RenderingSession, read_bench
from palpate.softness.process.rendering_session import ObjectPieces, object_messages
from palpate.stop_request import STOPPED, holders_of, stop_all

BALL = SoftObject(
    "ball", Characteristic("area", 1e-6 * np.linspace(0.0, 100.0, 257), np.linspace(0.0, 1.6, 257) ** 1.5),
    Characteristic("displacement", 1e-3 * np.linspace(0.0, 4.0, 257), np.linspace(0.0, 1.6, 257) ** 1.5),
    "made up",
)  # fmt: skip
LINE = SoftObject(
    "line", Characteristic("area", np.array([0.0, 130e-6]), np.array([0.0, 4.0])),
    Characteristic("displacement", np.array([0.0, 6e-3]), np.array([0.0, 4.0])), "made up",
)  # fmt: skip
OWN = """
name = "{name}"
[display]
kind = "tests.softness.own_bench:{display}"
{options}
[arm]
kind = "tests.softness.own_bench:arm"
[limits]
late_ms = 20
"""


def wait_until(holds, within_s: float = 5.0) -> bool:
    end_s = time.monotonic() + within_s
    while time.monotonic() < end_s:
        if holds():
            return True
        time.sleep(0.02)
    return False


def ended(session: RenderingSession) -> bool:
    return session.status().state == "ended"


def runs(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


@pytest.fixture
def own(tmp_path: Path):
    def write(display: str = "display", options: str = "", name: str = "own bench"):
        path = tmp_path / "bench.toml"
        path.write_text(OWN.format(name=f"{name} {tmp_path.name}", display=display, options=options))
        return read_bench(path)

    return write


def test_a_virtual_finger_feels_the_object_and_another_within_a_second() -> None:
    with RenderingSession(read_bench(None), BALL, Mode.BOTH, 1.0, 2.0) as session:
        assert wait_until(lambda: session.status().periods > 1500, 10.0)
        felt = [one for one in session.taken() if one.touched]
        begun_s = time.monotonic()
        session.show(LINE)
        assert time.monotonic() - begun_s < 1.0
        assert wait_until(lambda: session.status().object == "line", 1.0)
        status = session.stop()
    force = np.array([one.force_n for one in felt])
    assert force.max() == pytest.approx(1.0, rel=0.1)
    for curve, x in (
        (BALL.area, [one.area_m2 for one in felt]),
        (BALL.displacement, [one.displacement_m for one in felt]),
    ):
        off = force - np.interp(x, curve.x, curve.force_n)
        assert np.sqrt(np.mean(off**2)) < 0.06 * force.max()
    assert status.state == "ended"
    assert status.wished
    assert status.simulated


def test_devices_of_one_s_own_are_opened_by_name_and_anybody_stops_them_by_the_bench_s(own) -> None:
    bench = own()
    assert not holders_of(bench.name)
    with RenderingSession(bench, LINE, Mode.BOTH) as session:
        assert wait_until(lambda: session.status().periods > 100)
        assert not session.status().simulated
        holders = holders_of(bench.name)
        stop_all(holders)
        assert STOPPED in [one.code for one in holders if one.is_supervisor]
        assert wait_until(lambda: ended(session), 1.0)
        assert "emergency stop" in session.status().why
    assert not holders_of(bench.name)


def refusal_of_another(bench) -> str:
    try:
        RenderingSession(bench, LINE, Mode.BOTH).close()
    except DeviceError as e:
        return str(e)
    return ""


@pytest.mark.slow  # it waits for a process before it that may still be making its devices safe
def test_two_renderings_do_not_hold_one_bench(own) -> None:
    bench = own()
    for _ in range(3):  # a computer that is busy ends the first by a late period, and its bench is free
        with RenderingSession(bench, LINE, Mode.BOTH) as first:
            refused = refusal_of_another(bench)
            if refused or "a period of" not in first.status().why:
                break
    assert "drives" in refused


@pytest.mark.parametrize(
    ("options", "why"),
    [('fault = "wire off"', "wire off"), ("hangs_s = 1.0", "no period has ended")],
    ids=["fault", "hangs"],
)
@pytest.mark.cases(1)
def test_a_fault_ends_it_and_is_named(own, options: str, why: str) -> None:
    bench = own("FailingDisplay", options)
    for _ in range(3):  # a computer that is busy ends it first, by a late period
        with RenderingSession(bench, LINE, Mode.BOTH) as session:
            assert wait_until(lambda: ended(session), 8.0)
            status = session.status()
        assert not status.wished
        if "a period of" not in status.why:
            break
    assert why in status.why


def test_a_process_that_is_killed_is_told_of_and_not_waited_for() -> None:
    with RenderingSession(read_bench(None), LINE, Mode.BOTH) as session:
        os.kill(session.pid, signal.SIGKILL)
        assert wait_until(lambda: ended(session), 2.0)
        assert "watchdogs" in session.status().why


CLIENT = """
import sys, time
from palpate.softness import Mode
from palpate.softness.process import RenderingSession, read_bench
from tests.softness.test_rendering_process import LINE
session = RenderingSession(read_bench(None).model_copy(update={"name": sys.argv[1]}), LINE, Mode.BOTH)
print(session.pid, flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.slow)])
def test_a_client_that_is_gone_or_hangs_ends_the_rendering(number: int, tmp_path: Path) -> None:
    words = [sys.executable, "-c", CLIENT, f"of a client {tmp_path.name}"]
    client = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    try:
        assert client.stdout is not None
        pid = int(client.stdout.readline())
        time.sleep(0.3)
        assert runs(pid)
        os.kill(client.pid, number)
        assert wait_until(lambda: not runs(pid), 10.0)
    finally:
        client.kill()
        client.wait()
        client.stdout.close()


@pytest.mark.slow
def test_a_process_that_hangs_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_link, "SILENT_S", 1.0)
    session = RenderingSession(read_bench(None), LINE, Mode.BOTH)
    os.kill(session.pid, signal.SIGSTOP)
    try:
        assert wait_until(lambda: ended(session), 10.0)
        assert "hangs" in session.status().why
        with refused("process-not-ended", DeviceError):
            session.close()
    finally:
        os.kill(session.pid, signal.SIGCONT)


def test_an_object_goes_through_its_pieces_to_the_last_digit() -> None:
    pieces = ObjectPieces()
    *parts, last = object_messages(BALL)
    for part in parts:
        pieces.take(part)
    whole = pieces.whole(last)
    for cue in ("area", "displacement"):
        sent, came = getattr(BALL, cue), getattr(whole, cue)
        assert np.array_equal(sent.x, came.x)
        assert np.array_equal(sent.force_n, came.force_n)
    assert (whole.name, whole.source) == (BALL.name, BALL.source)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ('[display]\nkind = "labjack"', "file-field"),
        ('[arm]\nkind = "no-such-arm"', "arm-unknown"),
        ("[limits]\nlate_ms = 0.5", "file-field"),
        ("[limits]\nforce_N = 100", "file-field"),
        ("", "arm-missing"),
        ("speed = 3", "file-field"),
        ("[arm", "toml"),
        ('[arm]\npress_axis = "z"\npress_sign = 1', "file-field"),
    ],
)
def test_a_bench_s_file_that_cannot_be_is_refused_by_name(tmp_path: Path, text: str, code: str) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(text)
    with refused(code, InputError):
        read_bench(path)


def test_a_mode_that_needs_a_display_is_refused_without_one(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(f'name = "arm alone {tmp_path.name}"\n[arm]\nkind = "tests.softness.own_bench:arm"\n')
    with pytest.raises(SafetyError, match=r"no \[display\]"):
        RenderingSession(read_bench(path), LINE, Mode.BOTH)


def test_what_the_process_refuses_is_raised_as_it_was() -> None:
    with refused("force-range", RangeError):
        RenderingSession(read_bench(None), LINE, Mode.BOTH, peak_n=40.0)
