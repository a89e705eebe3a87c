"""Recordings that are killed at random moments: begun again, they hold their plan exactly."""

import json
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.rig.rigs import keys

from palpate.recordings import Run, check
from palpate.rig.plans import StepHold

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.mark.skipif(sys.platform != "linux", reason="kills by another process's processor time")
@pytest.mark.parametrize("kills", [4, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_run_killed_at_any_moment_goes_on_by_the_same_call_to_its_plan_exactly(
    tmp_path, kills: int
) -> None:
    words = [sys.executable, "-m", "tests.rig.killed_recordings", str(kills), str(tmp_path)]
    done = subprocess.run(words, check=True, capture_output=True, text=True, cwd=REPOSITORY)
    met = json.loads(done.stdout)
    assert met["wrong"] == []
    assert met["kills"] == kills
    assert met["runs"] >= 1
    assert met["early"] >= kills // 10, "kills at its very beginning are among them"
    if kills >= 1000:
        assert met["unbegun"] > 0, "and kills before the run's folder is there"
        assert met["empty"] > 0, "and runs without a frame"


COMMAND_PLAN = """
name = "tiny"
cycles = 1
depth_mm = 0.8
step_mm = 0.4
frames = 2
reference_frames = 1
taps = 0
travel_mm_s = 50.0
[places]
kind = "listed"
at_mm = [[0.0, 0.0], [4.0, 3.0]]
"""


@pytest.mark.slow
def test_the_command_that_was_killed_goes_on_when_it_is_given_again(tmp_path: Path) -> None:
    out, file = tmp_path / "run", tmp_path / "tiny.toml"
    file.write_text(COMMAND_PLAN)
    words = [sys.executable, "-m", "palpate.cli", "record", "--rig", "virtual:palm", "--plan", str(file)]
    words += ["--out", str(out), "--quiet", "--json"]
    reached: tuple[Callable[[], bool], ...] = (
        lambda: True,
        out.exists,
        (out / "0000-signals.mcap").exists,
        lambda: out.exists() and len(Run.open(out)) > 2,
    )
    for moment in reached:
        with subprocess.Popen(words, stdout=subprocess.DEVNULL) as child:
            while not moment() and child.poll() is None:
                time.sleep(0.0005)
            child.kill()
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    assert json.loads(done.stdout)["state"] == "done"
    plan = StepHold(**tomllib.loads(COMMAND_PLAN))
    wanted = [(s.key, k) for press in plan.presses() for s, n in plan.shots(press) for k in range(n)]
    assert sorted(keys(Run.open(out))) == sorted(wanted)
    assert check(out).segments >= 2
