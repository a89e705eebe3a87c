"""Recordings that are killed at random moments: begun again, they hold their plan exactly."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

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
