"""Recordings that are killed at random moments: begun again, they hold their plan exactly."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from palpate.recordings import Run, check
from palpate.rig.plans import StepHold

CHILD = """
import sys, time
from pathlib import Path
from palpate.core.clock import ManualClock
from palpate.rig import record
from palpate.rig.plans import plan_from
import json
sys.path.insert(0, sys.argv[1])
from tests.rig.rigs import rig
plan = plan_from(json.loads(sys.argv[3]))
clock = ManualClock(time.monotonic_ns())
made = rig(clock=clock)
print("go", flush=True)
print(record(made, plan, Path(sys.argv[2])).state.value, flush=True)
"""
REPOSITORY = Path(__file__).resolve().parents[2]


def killed(out: Path, plan: StepHold, after_s: float) -> bool:
    """Whether it was cut; False where it ended before."""
    words = [sys.executable, "-c", CHILD, str(REPOSITORY), str(out), plan.model_dump_json()]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=REPOSITORY) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "go\n"
        time.sleep(after_s)
        cut = child.poll() is None
        child.kill()
    return cut


def holds_its_plan_exactly(out: Path, plan: StepHold) -> None:
    run = Run.open(out)
    labels = run.labels.dropna(subset=["shot"])
    held = list(zip(labels["shot"], labels["frame_in_shot"].astype(int), strict=True))
    wanted = [(s.key, k) for press in plan.presses() for s, n in plan.shots(press) for k in range(n)]
    assert len(held) == len(set(held)), "no frame is there twice"
    assert sorted(held) == sorted(wanted), "and none is missing"
    for index in range(0, len(run), 17):
        run.frame(index)
    segments = check(out).segments
    assert segments >= 2


def killed_in_a_process(kills: int, folder: Path) -> dict[str, Any]:
    """What the kills met, of children that are forked from a process of their own."""
    words = ["-m", "tests.rig.killed_recordings", str(kills), str(folder), "--seed", str(kills)]
    done = subprocess.run(
        [sys.executable, *words], check=True, capture_output=True, text=True, cwd=REPOSITORY
    )
    return json.loads(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="kills by another process's processor time")
@pytest.mark.parametrize("kills", [4, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_run_killed_at_any_moment_goes_on_by_the_same_call_to_its_plan_exactly(tmp_path, kills):
    met = killed_in_a_process(kills, tmp_path)
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
    holds_its_plan_exactly(out, StepHold(**tomllib.loads(COMMAND_PLAN)))
