"""A port that nobody can listen at: what is said names it, its host and what to do."""

import socket

import pytest
from typer.testing import CliRunner

pytest.importorskip("nicegui", reason="NiceGUI is not installed")


from palpate.cli import app
from palpate.studio.page_server import check_port


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
