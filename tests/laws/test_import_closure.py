"""How much of palpate the record verb loads: what it does not need stays on the disk."""

import subprocess
import sys
from pathlib import Path

import pytest

MAX_MODULES = 160
PLAN = """
name = "one place"
kind = "stepped"
cycles = 1
depth_mm = 1.0
step_mm = 1.0
frames = 1
reference_frames = 1
taps = 0
places = {kind = "listed", at_mm = [[0.0, 0.0]]}
"""
CODE = """
import sys
from palpate.cli import app
try:
    app(["record", "--rig", "virtual:palm-debug", "--plan", "plan.toml", "--out", "run", "--quiet"])
except SystemExit as e:
    assert not e.code
print(*sorted(name for name in sys.modules if name.partition(".")[0] == "palpate"))
"""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory) -> list[str]:
    """The modules of palpate that recording one press on the virtual palm has loaded."""
    folder: Path = tmp_path_factory.mktemp("record")
    (folder / "plan.toml").write_text(PLAN)
    run = subprocess.run(
        [sys.executable, "-c", CODE], cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )
    assert run.returncode == 0, run.stderr
    assert (folder / "run" / "manifest.json").is_file()
    return run.stdout.splitlines()[-1].split()


def test_the_record_verb_loads_few_modules(loaded) -> None:
    assert "palpate.rig.engine" in loaded
    assert len(loaded) <= MAX_MODULES, loaded


def test_a_virtual_rig_loads_no_driver_check_network_or_other_sensor(loaded) -> None:
    needless = (
        "palpate.devices.check",
        "palpate.estimators",
        "palpate.recordings.exchange.press",
        "palpate.rig.real",
        "palpate.rig.service",
        "palpate.sensors.tactip",
    )
    assert not [name for name in loaded if name.startswith(needless)]
