"""How `palpate studio` begins and ends: on a folder that is there, and whoever ends it, with the rig's process."""

import importlib.util
import signal
import sys
import time

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from tests.studio.test_rig_page import MAX_S, RIG, Studio

from palpate.devices.rpc import find

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("websockets") is None, reason="websockets is not installed"
)


@pytest.mark.skipif(sys.platform == "win32", reason="a process is told to end by POSIX signals")
@pytest.mark.parametrize("name", ["SIGTERM", pytest.param("SIGINT", marks=pytest.mark.slow)])
def test_who_ends_the_studio_ends_the_process_of_a_rig_that_stands(name: str, tmp_path) -> None:
    studio = Studio(tmp_path)
    try:
        said = studio.ctrl_c(getattr(signal, name))
        assert f"the rig {RIG} stands and nothing is recorded; its process ends" in said
        assert studio.process.returncode == 0
        until_s = time.monotonic() + MAX_S
        while find(RIG, tmp_path / "palpate") and time.monotonic() < until_s:
            time.sleep(0.05)
        assert find(RIG, tmp_path / "palpate") is None
    finally:
        studio.close()
