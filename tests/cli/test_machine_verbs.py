"""`palpate cameras` and `palpate doctor`, as typed."""

import json

import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.rig.real import camera_listing
from palpate.rig.real.camera_listing import CameraMode, ListedCamera
from palpate.workflows import machine_check

CAMERA = ListedCamera(
    "/dev/video0",
    "Tip camera",
    "4B2D",
    "046d:0825",
    "uvcvideo",
    (CameraMode("MJPG", (640, 480), (60.0, 30.0)),),
)
LOCKED = ListedCamera("/dev/video2", "Other", advice="you may not open it: sudo usermod -aG video $USER")


def typed(*words: str, status: int = 0) -> str:
    result = CliRunner().invoke(app, list(words))
    assert result.exit_code == status, result.output
    return result.stdout


def test_cameras_are_listed_with_the_command_that_reads_each(monkeypatch) -> None:
    monkeypatch.setattr(camera_listing, "list_cameras", lambda: (CAMERA, LOCKED))
    text = typed("cameras")
    assert "palpate live --camera 4B2D" in text
    assert "MJPG: 640x480 at 60 Hz" in text
    assert "palpate live --camera /dev/video2" in text
    assert "-> you may not open it" in text
    assert "640x480 at 60, 30 Hz" in typed("cameras", "--all")
    found = json.loads(typed("cameras", "--json"))
    assert [one["serial"] for one in found] == ["4B2D", ""]
    assert found[0]["modes"][0] == {"pixels": "MJPG", "size_px": [640, 480], "rates_hz": [60.0, 30.0]}


def test_a_camera_of_a_sensor_that_is_known_is_opened_as_its_preset_says(monkeypatch) -> None:
    mini = ListedCamera("/dev/video4", "GelSight Mini R0B 2BNN-4ZE7: Ge", "2BNN4ZE7", "0c45:636d")
    monkeypatch.setattr(camera_listing, "list_cameras", lambda: (mini, CAMERA))
    text = typed("cameras")
    assert "palpate live --camera 2BNN4ZE7 --size 3280x2464 --fps 25 --exposure-ms 18\n" in text
    assert "palpate sensors gelsight-mini" in text
    assert "palpate live --camera 4B2D\n" in text
    assert [one["preset"] for one in json.loads(typed("cameras", "--json"))] == ["gelsight-mini", None]


def test_the_doctor_names_a_mend_for_all_that_is_missing() -> None:
    parts = json.loads(typed("doctor", "--json"))
    names = [part["name"] for part in parts]
    assert {"Python", "cores", "memory", "disk", "packages", "extra studio", "extra rig"} <= set(names)
    assert all(part["mend"] for part in parts if part["state"] != "ok" and part["name"] != "packages")
    assert {part["state"] for part in parts if part["name"] in ("Python", "numpy", "cv2")} == {"ok"}


def test_what_is_needed_and_broken_ends_with_status_1_and_what_is_missing_does_not(monkeypatch) -> None:
    monkeypatch.setattr(machine_check, "list_cameras", lambda: (LOCKED,))
    assert "missing camera /dev/video2" in " ".join(typed("doctor").split())
    monkeypatch.setattr(machine_check, "NEEDED_LIBRARIES", ("numpy", "no_such_library"))
    text = typed("doctor", status=1)
    assert "broken" in text
    assert "pip install --force-reinstall palpate" in text


@pytest.mark.parametrize("version", [(3, 10), (3, 14)])
def test_another_python_is_broken(monkeypatch, version) -> None:
    monkeypatch.setattr(machine_check.sys, "version_info", (*version, 0))
    assert machine_check.check_machine()[0].state == "broken"


def test_a_port_without_the_right_to_it_names_the_group(monkeypatch, tmp_path) -> None:
    port = tmp_path / "ttyACM0"
    port.touch()
    monkeypatch.setattr(machine_check, "_port_names", lambda: [(str(port), "A1")])
    monkeypatch.setattr(machine_check.os, "access", lambda path, how: str(path) != str(port))
    (found,) = [part for part in machine_check.check_machine() if part.name.startswith("port ")]
    assert found.state == "missing"
    assert "usermod -aG" in found.mend
