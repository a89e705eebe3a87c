"""A port that nobody can listen at: what is said names it, its host and what to do."""

import errno
import socket

import pytest
from typer.testing import CliRunner

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from tests.refusals import refused

from palpate.cli import app
from palpate.core import DeviceError
from palpate.studio.page_server import _no_port_text, check_port


@pytest.mark.parametrize("words", [["studio", "--workspace", "{}"], ["start", "--folder", "{}/mine"]])
def test_a_port_that_another_program_has_is_refused_with_what_to_do(words, tmp_path):
    words = [word.format(tmp_path) for word in words]
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = CliRunner().invoke(app, [*words, "--port", str(port)])
    told = " ".join(done.output.split())
    assert done.exit_code == 2
    assert f"port {port}" in told
    assert f"--port {port + 1}" in told
    assert "address (" not in told, "the system's own words are left out"
    check_port(port)  # free again


def test_an_address_of_another_computer_and_a_port_of_the_systems_own_are_told_apart():
    with refused("address-unavailable", DeviceError, match=r"192\.0\.2\.1"):
        check_port(8080, "192.0.2.1")
    assert "--port 8080" in _no_port_text(80, "127.0.0.1", OSError(errno.EACCES, "Permission denied"))
    assert "--port 8080" in _no_port_text(65535, "::1", OSError(errno.EADDRINUSE, "in use"))
