"""The rig's verbs, as they are typed."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.recordings import Run, check
from palpate.sensors.tactip.tactip_sensor import TacTip

TOML = """
name = "tiny"
cycles = 1
depth_mm = 0.4
step_mm = 0.2
frames = 2
reference_frames = 1
clearance_mm = 0.4
travel_mm_s = 50
taps = 0
[places]
kind = "listed"
at_mm = [[0, 0], [5, 5]]
"""


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(TOML)
    return path


def typed(*words: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, [str(word) for word in words])
    return done.exit_code, done.stdout, done.stderr


@pytest.mark.slow
def test_a_recorded_run_is_checked_calibrated_and_reported_without_further_options(
    tiny: Path, tmp_path: Path
) -> None:
    tiny.write_text(
        TOML.replace("[5, 5]", "[5, 5], [-6, 3], [4, -7], [-3, -6]").replace("cycles = 1", "cycles = 2")
    )
    run, cal = tmp_path / "run", tmp_path / "cal"
    assert typed("record", "--plan", tiny, "--out", run, "--quiet")[0] == 0
    assert typed("check", run)[0] == 0
    assert typed("calibrate", run, "--out", cal, "--quiet")[0] == 0
    assert typed("report", cal)[0] == 0
    assert "<html" in (tmp_path / "cal.html").read_text()
    card = json.loads((cal / "card.json").read_text())
    assert [target["column"] for target in card["targets"]] == ["depth_mm", "force_N", "x_mm", "y_mm"]
    assert card["split"]["columns"] == ["location"]
    palms = (
        "calibrate",
        run,
        "--model",
        "palm-mlp-delta",
        "--size",
        "16x32",
        "--quiet",
        "--out",
        tmp_path / "mlp",
    )
    assert typed(*palms)[0] == 0
    card = json.loads((tmp_path / "mlp" / "card.json").read_text())
    assert [target["column"] for target in card["targets"]] == ["force_x_N", "force_y_N", "force_N"]
    assert card["options"]["epochs"] == 2000, "what was not asked for is told as well"
    seen = card["input"]
    assert (seen["channels"], seen["delta"]) == (1, True)
    assert (seen["crop_px"], seen["beside_px"]) == ([0, 0, 128, 128], [128, 0, 128, 128])


def test_the_palms_protocol_is_previewed_with_its_numbers(tmp_path: Path, figures_blank) -> None:
    png = tmp_path / "places.png"
    code, out, _ = typed("plan", "preview", "palm", "--png", png, "--json")
    found = json.loads(out)
    assert code == 0
    assert (found["points"], found["shots"], found["frames"]) == (37, 9250, 231_250)
    assert found["seconds"] > 231_250 / 30
    assert found["bytes"] > 1e9
    assert png.read_bytes().startswith(b"\x89PNG")
    assert typed("plan", "preview", "palm", "--png", png)[0] == 2


def test_a_recorded_plan_is_a_sound_run_and_the_same_command_finds_it_done(
    tiny: Path, tmp_path: Path
) -> None:
    tiny.write_text(TOML.replace(", [5, 5]", "").replace("step_mm = 0.2", "step_mm = 0.4"))
    out = tmp_path / "run"
    words = ("record", "--plan", tiny, "--out", out, "--json", "--quiet")
    code, said, _ = typed(*words)
    assert code == 0
    assert json.loads(said)["state"] == "done"
    assert check(out).sound
    frames = len(Run.open(out))
    assert frames == 1 + 2 * 1
    assert typed(*words)[0] == 0
    assert len(Run.open(out)) == frames


@pytest.mark.slow
def test_a_rig_records_its_sensors_own_plan_where_none_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = TacTip.default_plan
    fewer = {"cycles": 2, "indenters": ["rigid", "S1=7.6", "S3=1.1"]}  # of 5 and 5, for speed
    monkeypatch.setattr(TacTip, "default_plan", lambda tip: {**own(tip), **fewer})
    out = tmp_path / "presses"
    code, said, error = typed("record", "--rig", "virtual:tactip", "--out", out, "--quiet")
    assert code == 0, error
    assert "presses on 3 specimens, as compliance reads them" in said
    assert typed("calibrate", "--method", "compliance", out, "--out", tmp_path / "tip.npz", "--quiet")[0] == 0


@pytest.mark.parametrize(
    ("rig", "plan", "says"),
    [
        (
            "virtual:tactip",
            "palm",
            "'palm' does not suit .*'sphere:10' is no specimen.*own plans are tactip\n",
        ),
        ("virtual:palm", "tactip", "'tactip' does not suit .*own plans are palm, palm-reduced, "),
    ],
)
def test_a_plan_of_another_sensor_is_refused_and_the_own_ones_are_named(
    rig: str, plan: str, says: str, tmp_path: Path
) -> None:
    code, _, error = typed("record", "--rig", rig, "--plan", plan, "--out", tmp_path / "run", "--quiet")
    assert code == 2
    assert re.search(says, error)
    assert not (tmp_path / "run").exists()


def test_a_request_to_end_lifts_the_probe_and_leaves_a_run_that_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = [sys.executable, "-m", "palpate.cli", "record", "--plan", "palm-reduced", "--out", str(out)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not (out / "0000-frames.mcap").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1.0)  # the probe has begun to move
    process.send_signal(signal.SIGTERM)
    said, error = process.communicate(timeout=120)
    assert process.returncode == 1, error
    assert "aborted" in said
    assert "goes on at the first missing shot" in said
    run = Run.open(out)
    assert check(out).sound
    assert run.stage()["z_m"].iloc[-1] <= -1e-3 + 1e-9


def test_a_rig_is_worked_by_hand_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # where no other program serves a rig of this name
    code, out, _ = typed("rig", "jog", "virtual:palm", "--axis", "z", "--mm", "1", "--json")
    assert code == 0
    assert json.loads(out)["position_mm"] == pytest.approx([0, 0, -4], abs=0.02)
    code, out, _ = typed("rig", "zero", "virtual:palm", "--json")
    assert code == 0
    assert json.loads(out)["lifted_mm"] == pytest.approx(0.6)
    code, out, _ = typed("rig", "status", "virtual:palm", "--json")
    assert code == 0
    assert json.loads(out)["camera_rate_hz"] == pytest.approx(30, rel=0.05)
    code, out, _ = typed("rig", "stop", "virtual:palm", "--json")
    assert code == 0
    assert json.loads(out)["stopped"]


def test_what_cannot_be_done_by_hand_is_said_in_one_line(tmp_path: Path) -> None:
    for words, said in (
        (("jog", "virtual:palm", "--axis", "z", "--mm", "60"), "50 mm"),
        (("home", "virtual:palm"), "no homing"),
        (("setup", "--out", tmp_path / "a.toml", "--answers", tmp_path / "none.toml"), "no file of answers"),
        (("jog", tmp_path / "none.toml", "--axis", "z", "--mm", "1"), "no such file"),
    ):
        code, _, err = typed("rig", *words)
        assert code == 2
        assert said in err
        assert len(err.strip().splitlines()) <= 2
    file = tmp_path / "gone.toml"
    file.write_text('name = "x"\n[stage]\nkind = "grbl"\nport = "/dev/no-such-port"\n')
    code, _, err = typed("rig", "stop", file)
    assert (code, "Nothing was stopped" in err) == (2, True)
    code, out, _ = typed("rig", "status", file)
    assert code == 1
    assert "no-such-port" in out


@pytest.mark.slow
def test_a_stop_beside_a_process_that_holds_the_rig_is_its_emergency_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from palpate.rig.service import launch

    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    process, _ = launch("virtual:palm", tmp_path / "runs")
    try:
        code, out, _ = typed("rig", "stop", "virtual:palm")
        assert code == 0
        assert "emergency stop by the process" in out
        code, out, _ = typed("rig", "status", "virtual:palm", "--json")
        assert code == 0
        assert json.loads(out)["held"]
    finally:
        process.terminate()
        process.wait(30)
