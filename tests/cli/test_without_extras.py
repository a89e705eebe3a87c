"""Without optional packages every command works or names the extra to install; see `walked_commands.py`."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from palpate.core.failure_log import INTERNAL_STATUS
from palpate.core.optional_imports import EXTRAS

REPOSITORY = Path(__file__).resolve().parents[2]
WALK = REPOSITORY / "tests" / "cli" / "walked_commands.py"
EVERY = sorted({extra for _, extra in EXTRAS.values()})
SOME = ["studio", *(pytest.param(one, marks=pytest.mark.slow) for one in ("start", "rig"))]
"""First words of the commands that reach most extras."""


def walked(python: str | Path, out: Path, missing: list[str], only: str = "") -> list[dict[str, Any]]:
    """What came of each call of each command."""
    environment = {**os.environ, "ONLY": only, "XDG_STATE_HOME": str(out.parent)}
    if str(python) != sys.executable:
        environment.pop("PYTHONPATH", None)  # the installed wheel is tried, not the source tree
    command = [str(python), str(WALK), str(out), *missing]
    subprocess.run(command, env=environment, check=True, capture_output=True, timeout=1800)
    return [json.loads(line) for line in out.read_text().splitlines()]


def check(rows: list[dict[str, Any]]) -> None:
    """No exception passed a command, and each call ended with a status that is meant."""
    assert rows
    assert not [row for row in rows if row["error"] not in ("", "''")]
    assert not [row for row in rows if row["status"] == INTERNAL_STATUS or "Traceback" in row["said"]]
    assert {row["status"] for row in rows} <= {0, 1, 2}


@pytest.mark.parametrize("only", SOME)
def test_commands_that_need_an_extra_name_it(tmp_path: Path, only: str) -> None:
    rows = walked(sys.executable, tmp_path / "calls.jsonl", EVERY, only)
    check(rows)
    named = [row for row in rows if "'palpate[" in row["said"]]
    assert named
    assert (
        {row["status"] for row in named} == {2}
        if only != "rig"
        else {1, 2} >= {row["status"] for row in named}
    )


@pytest.mark.slow
@pytest.mark.parametrize("kept", ["", *EVERY])
def test_every_command_with_one_extra_or_none(tmp_path: Path, kept: str) -> None:
    check(walked(sys.executable, tmp_path / "calls.jsonl", [one for one in EVERY if one != kept]))


@pytest.mark.slow
def test_every_command_of_the_wheel_alone(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    constraints = ["--constraint", str(REPOSITORY / "constraints.txt")]
    source, wheels, bare = tmp_path / "source", tmp_path / "wheels", tmp_path / "bare"
    subprocess.run(["git", "clone", "-q", str(REPOSITORY), str(source)], check=True)
    build = ["wheel", "--no-deps", *constraints, "--build-constraint", constraints[1], "-w", str(wheels)]
    steps = [[*pip, *build, str(source)], [sys.executable, "-m", "venv", "--without-pip", str(bare)]]
    python = bare / "bin" / "python"
    for step in steps:
        done = subprocess.run(step, capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"the wheel cannot be built here: {done.stderr.strip()[-200:]}")
    install = [*pip, "--python", str(python), "install", *constraints, *map(str, wheels.glob("*.whl"))]
    done = subprocess.run(install, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"the required packages cannot be installed here: {done.stderr.strip()[-200:]}")
    absent = subprocess.run([str(python), "-I", "-c", "import nicegui"], capture_output=True, check=False)
    assert absent.returncode != 0
    check(walked(python, tmp_path / "calls.jsonl", []))
