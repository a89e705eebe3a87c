"""Recordings that are killed at random moments: resumed, they hold their plan exactly."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tests.rig.rigs import rig

from palpate.core.clock import NS_PER_S, ManualClock
from palpate.recordings import Run, check
from palpate.rig import State, record
from palpate.rig.plans import Grid, StepHold

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


def small(pitch_mm: float, cycles: int) -> StepHold:
    return StepHold(
        taps=0,
        name="killed",
        places=Grid(pitch_mm=pitch_mm),
        cycles=cycles,
        depth_mm=2.0,
        step_mm=0.4,
        frames=3,
        reference_frames=2,
        clearance_mm=0.4,
        travel_mm_s=50.0,
    )


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


def cut_and_resumed(out: Path, plan: StepHold, kills: int, longest_s: float) -> int:
    rng = np.random.default_rng(kills)
    cuts = sum(killed(out, plan, float(rng.uniform(0.0, longest_s))) for _ in range(kills))
    clock = ManualClock(time.monotonic_ns() + 3600 * NS_PER_S)
    assert record(rig(clock=clock), plan, out).state is State.DONE
    return cuts


def test_a_few_kills_leave_a_run_that_resumes_to_its_plan_exactly(tmp_path: Path) -> None:
    plan = small(pitch_mm=20.0, cycles=1)
    cut_and_resumed(tmp_path / "run", plan, kills=4, longest_s=2.0)
    holds_its_plan_exactly(tmp_path / "run", plan)


@pytest.mark.slow
def test_a_hundred_kills_leave_a_run_that_resumes_to_its_plan_exactly(tmp_path: Path) -> None:
    plan = small(pitch_mm=7.0, cycles=5)
    cuts = cut_and_resumed(tmp_path / "run", plan, kills=100, longest_s=2.5)
    assert cuts > 90
    holds_its_plan_exactly(tmp_path / "run", plan)
