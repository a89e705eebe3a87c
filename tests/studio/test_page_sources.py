"""A page opens devices, virtual sensors, and what lies in the workspace, and nothing else."""

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from tests.studio.small_run import write_small_run

from palpate.core import InputError
from palpate.studio.library.workspace import OutsideError, Workspace
from palpate.studio.live.live_desk import check_devices, source_options

SERIAL = "9A3F21"


def cameras():
    return {SERIAL: "a camera", "/dev/video7": "another"}


@pytest.fixture
def workspace(tmp_path):
    write_small_run(tmp_path / "at" / "runs" / "one")
    (tmp_path / "at" / "taps.avi").touch()
    write_small_run(tmp_path / "outside")
    return Workspace(tmp_path / "at")


@pytest.mark.parametrize("source", ["virtual:palm", "virtual:tactip/S1=7.6", "0", "12", SERIAL, "picamera2"])
def test_devices_and_virtual_sensors_are_opened_as_they_are_named(workspace, source):
    assert source_options(workspace, source, cameras) == {"camera": source}


def test_what_lies_in_the_workspace_is_opened_by_its_whole_path(workspace):
    at = workspace.folder
    assert source_options(workspace, "taps.avi", cameras) == {"camera": str(at / "taps.avi")}
    played = {"camera": str(at / "runs" / "one"), "paced": True, "repeat": True}
    assert source_options(workspace, "runs/one", cameras) == played


@pytest.mark.parametrize(
    "source",
    ["", "-", ".", "..", "../outside", "runs/../../outside", "{outside}", "/etc/passwd", "/dev/stdin",
     "/dev/null", "/dev/../etc/passwd", "/dev/fd/0", "~/outside", "missing", "file:///etc/passwd", "http://127.0.0.1:1/",
     "123", "runs\\one", "link", "linked-run", "taps.avi\n", "٣"],
)  # fmt: skip
def test_nothing_else_is_opened(workspace, tmp_path, source):
    (workspace.folder / "link").symlink_to(tmp_path / "outside")
    linked = write_small_run(workspace.folder / "linked-run")
    frames = next(linked.glob("*frames*"))
    frames.unlink()
    frames.symlink_to(next((tmp_path / "outside").glob("*frames*")))
    with pytest.raises(OutsideError):
        source_options(workspace, source.format(outside=tmp_path / "outside"), cameras)


@pytest.mark.parametrize("scale", ["virtual", "typed", "FT4S9X", "COM3"])
def test_a_first_session_takes_scales_by_name(scale):
    check_devices("virtual:palm", scale, cameras)


@pytest.mark.parametrize(
    ("camera", "scale"),
    [("../outside", "typed"), ("runs/one", "typed"), ("0", "/etc/passwd"), ("0", "socket://10.0.0.1:23"),
     ("0", "../port"), ("0", "\\\\host\\share")],
)  # fmt: skip
def test_a_first_session_opens_no_file_and_no_network_address(camera, scale):
    with pytest.raises(InputError):
        check_devices(camera, scale, cameras)
