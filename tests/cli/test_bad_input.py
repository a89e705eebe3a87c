"""Plug-ins and files that cannot be used, as typed: one line that names them and the law, status 2."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.installed_packages import lay_package
from typer.testing import CliRunner

from palpate import Manifest
from palpate.cli import app
from palpate.version import __version__

DEVICES = """
import numpy as np
from palpate.core import Frame, Travel, Wrench


class Stage:
    travel = Travel((-0.05, -0.05, -0.03), (0.05, 0.05, 0.02), 0.02, 0.5, 0.02)

    def position_m(self):
        return (0.0, 0.0, -0.01)

    def move_to(self, position_m, speed_m_s): ...
    def moving(self): return False
    def stop(self): ...
    def close(self): ...


class MillimetreStage(Stage):
    def position_m(self): return (0.0, 0.0, -10.0)


RunawayStage = type("RunawayStage", (), {k: v for k, v in vars(Stage).items() if k != "stop"})


class Force:
    rate_hz, range_n = 1000.0, (20.0, 20.0, 60.0)

    def __init__(self, clock): self.clock = clock
    def latest(self): return Wrench(self.clock.now_ns(), (0.1, 0.2, 0.3))
    def drain(self): return [self.latest()]
    def close(self): ...


class BareForce(Force):
    def latest(self): return (0.1, 0.2, 0.3)


class Camera:
    rate_hz, size_px = 30.0, (64, 48)

    def __init__(self, clock): self.clock = clock

    def grab(self, timeout_s=1.0):
        return self.clock.now_ns(), Frame(np.zeros((48, 64), np.uint8), self.clock.now_ns() / 1e9)

    def drain(self): return [self.grab()]
    def close(self): ...


class TurnedCamera(Camera):
    size_px = (48, 64)
"""
RIG = """
name = "own bench"
[stage]
kind = "{stage}"
[force]
kind = "{force}"
[camera]
kind = "{camera}"
[limits]
least_mm = [-30, -30, -20]
greatest_mm = [30, 30, 8]
"""
MODELS = """
class Half:
    def fit(self, frames, targets, rows, seed): ...

def too_few(table, *, folds, seed):
    return [0, 1]
"""
SENSORS = "class Bare:\n    name = 'bare'\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on Python's path with modules of a stranger's."""
    before = set(sys.modules)
    (tmp_path / "their_devices.py").write_text(DEVICES)
    (tmp_path / "their_models.py").write_text(MODELS)
    (tmp_path / "their_sensors.py").write_text(SENSORS)
    (tmp_path / "their_crash.py").write_text("raise OSError('no driver\\non this machine')\n")
    (tmp_path / "their_exit.py").write_text("import sys\nsys.exit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - before:
        if name.startswith("their_"):
            del sys.modules[name]


def refusal(*words: object) -> str:
    """The one line with which a command is refused."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 2, (result.output, result.exception)
    assert result.stderr.startswith("palpate: ")
    assert result.stderr.count("\n") == 1
    assert not result.stdout
    return result.stderr


def test_a_plug_in_that_ends_the_process_is_told_and_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.rig.rig_file.open_rig", lambda *args, **seed: sys.exit(0))
    assert "a plug-in ended it: SystemExit: 0, from " in refusal("record", "--out", "nowhere")


OWN = {"stage": "their_devices:Stage", "force": "their_devices:Force", "camera": "their_devices:Camera"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("role", "kind", "message"),
    [
        ("stage", "their_nowhere:Stage", "does not import: ModuleNotFoundError: No module named"),
        ("stage", "their_devices:Gantry", "does not import: AttributeError: module 'their_devices'"),
        ("force", "their_crash:Force", "does not import: OSError: no driver on this machine"),
        ("camera", "their_exit:Camera", "does not import"),
        ("stage", "their_devices:RunawayStage", 'methods": it lacks stop'),
        ("stage", "their_devices:MillimetreStage", "breaks the law 'stands inside its travel'"),
        ("force", "their_devices:BareForce", "breaks the law 'hands out samples'"),
        ("camera", "their_devices:TurnedCamera", "breaks the law 'keeps the stated size'"),
        ("camera", "webcam", "there is no camera 'webcam'; there are uvc, virtual, or give module:Name"),
    ],
)
@pytest.mark.parametrize("verb", ["record", "check"])
def test_a_rig_of_a_broken_device_is_refused_by_its_name_and_law(
    folder: Path, role: str, kind: str, message: str, verb: str
) -> None:
    (folder / "rig.toml").write_text(RIG.format(**{**OWN, role: kind}))
    words = ["record", "--out", folder / "run", "--rig"] if verb == "record" else ["rig", "check"]
    line = refusal(*words, folder / "rig.toml")
    assert f"'{kind}'" in line
    assert message in line
    assert not (folder / "run").exists()


@pytest.mark.parametrize(
    ("role", "group", "name"),
    [
        ("stage", "palpate.stages", "grbl"),
        ("force", "palpate.force_sensors", "netft"),
        ("camera", "palpate.cameras", "uvc"),
    ],
)
def test_a_device_that_takes_an_existing_name_is_refused(
    folder: Path, role: str, group: str, name: str
) -> None:
    lay_package(folder, "their_package", group, name, OWN[role])
    kinds = {"stage": 'grbl"\nport = "COM3', "force": 'netft"\nhost = "box', "camera": 'uvc"\naddress = "0'}
    (folder / "rig.toml").write_text(RIG.format(**{**OWN, role: kinds[role]}))
    line = refusal("record", "--out", folder / "run", "--rig", folder / "rig.toml")
    assert f"{role} '{name}' of {OWN[role]}" in line
    assert "takes the name of palpate itself" in line


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ("their_nowhere:make", "does not import: ModuleNotFoundError"),
        ("their_exit:make", "does not import: SystemExit"),
        ("their_sensors:Bare", "breaks its contract: a sensor has spec, frame_px"),
    ],
)
def test_a_broken_sensor_is_refused_by_its_name_and_law(folder: Path, sensor: str, message: str) -> None:
    line = refusal("record", "--out", folder / "run", "--rig", f"virtual:{sensor}")
    assert sensor in line
    assert message in line


@pytest.mark.parametrize(
    ("option", "name", "message"),
    [
        ("--model", "their_nowhere:Model", "does not import"),
        ("--model", "their_exit:Model", "does not import"),
        ("--model", "their_models:Half", "their_models:Half"),
        ("--split", "their_nowhere:by_day", "does not import"),
        ("--split", "their_models:too_few", "shape [2] for 50 rows"),
    ],
)
def test_a_broken_model_or_split_is_refused_by_its_name(
    folder: Path, record_spots, option: str, name: str, message: str
) -> None:
    run = record_spots("run", 10)
    words = ["calibrate", run.path, "--targets", "x_mm", "--size", "12x16", "--out", folder / "cal"]
    line = refusal(*words, "--quiet", option, name)
    assert name in line
    assert message in line
    assert not (folder / "cal").exists()


NEWER = {
    "another format": {"format": "palpate-run/9", "software": "palpate 9.1.0"},
    "another format, of nobody": {"format": "palpate-run/9", "software": ""},
    "a field that is new": {"skin": "white", "software": "palpate 9.1.0"},
    "a field that is gone": {"units": None, "software": "palpate 0.2.0"},
}


@pytest.mark.parametrize("change", NEWER.values(), ids=NEWER)
def test_a_run_of_a_newer_version_says_which_version_opens_it(tmp_path: Path, change: dict) -> None:
    fields = json.loads(Manifest.new(sensor="one").model_dump_json()) | change
    (tmp_path / "manifest.json").write_text(json.dumps(fields))
    for words in (["check", tmp_path], ["calibrate", tmp_path, "--targets", "x_mm", "--out", tmp_path / "c"]):
        line = refusal(*words)
        writer = change["software"] or "the version of palpate that wrote it"
        assert f"this is palpate {__version__}, which reads palpate-run/1: open it with {writer}" in line


def test_a_damaged_manifest_of_this_version_is_called_damaged(tmp_path: Path) -> None:
    fields = json.loads(Manifest.new(sensor="one").model_dump_json()) | {"skin": "white"}
    (tmp_path / "manifest.json").write_text(json.dumps(fields))
    assert "is damaged: skin" in refusal("check", tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        {"format": "palpate-calibration/2", "software": {"palpate": "9.1.0"}},
        {"guards": [], "software": {"palpate": "9.1.0"}},
    ],
    ids=["another format", "a field that is new"],
)
def test_a_certificate_of_a_newer_version_says_which_version_opens_it(
    tmp_path: Path, calibrate_spots, changes_untried, change: dict
) -> None:
    plan = {"targets": ("x_mm",), "model": "mean", "split": "group:press", "size_px": (12, 16)}
    run, _ = calibrate_spots(tmp_path / "cal", presses=10, **plan)
    (card,) = (tmp_path / "cal").glob("card.json")
    fields = json.loads(card.read_text()) | change
    card.write_text(json.dumps(fields))
    for words in (["read", run.path, "--with", tmp_path / "cal"], ["report", tmp_path / "cal"]):
        line = refusal(*words, *(["--out", tmp_path / "page.html"] if words[0] == "report" else []))
        writer = fields["software"]["palpate"]
        assert f"which reads palpate-calibration/1: open it with palpate {writer}" in line
