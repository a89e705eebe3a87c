"""How `palpate studio` begins and ends: on a folder that is there, and with the rig's process."""

import importlib.util
import signal
import sys
import time

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from tests.studio.test_rig_page import MAX_S, RIG, Studio
from typer.testing import CliRunner

from palpate.cli import app
from palpate.cli.study import study_verbs
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
        assert RIG in said
        assert studio.process.returncode == 0
        until_s = time.monotonic() + MAX_S
        while find(RIG, studio.addresses) and time.monotonic() < until_s:
            time.sleep(0.05)
        assert find(RIG, studio.addresses) is None
    finally:
        studio.close()


@pytest.mark.parametrize("option", ["--workspace", "--objects"])
def test_a_folder_that_is_not_there_is_refused_before_anything_is_started(
    option: str, tmp_path, monkeypatch
) -> None:
    served: list[dict] = []
    monkeypatch.setattr(study_verbs, "serve_studio", lambda **words: served.append(words))
    done = CliRunner().invoke(app, ["studio", option, str(tmp_path / "misspelt")])
    assert (done.exit_code, served) == (2, [])
    assert option in done.output
    assert "misspelt" in done.output
    monkeypatch.chdir(tmp_path)
    for words in ([], [option, str(tmp_path)]):  # where it is run, and a folder that is there
        assert CliRunner().invoke(app, ["studio", *words]).exit_code == 0
    assert len(served) == 2
