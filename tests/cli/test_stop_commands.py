"""Stop commands act before anything heavy loads, and past processes that are dead or hang."""

import json
import os
import socket
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palpate import stop_request
from palpate.cli import app
from palpate.cli.stop_command import FIRST_BYTES, run_stop
from palpate.devices.rpc import Address, folder_of, publish, supervisor_name
from palpate.devices.rpc_server import RpcServer
from palpate.rig.real.grbl.grbl_link import CANCEL
from palpate.stop_request import GONE, REFUSED, SILENT, STOPPED, address_folder, holders_of, stop_all

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are stopped by POSIX signals")

RIG = "virtual:palm"
LOADS = """
import sys
from palpate.cli import main
sys.argv[1:] = {words!r}
try:
    main()
finally:
    print(*sys.modules, file=sys.stderr)
"""


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


class Served:
    """A process's RPC server that counts stops."""

    def __init__(self, name: str, folder: Path | None = None, answer: dict[str, int] | None = None) -> None:
        self.stops = 0
        self.answer = {"asked_ns": 1_000_000, "stood_ns": 3_000_000} if answer is None else answer
        self.server = RpcServer(name, dict, lambda after: None, {"estop": self.stop}, {})
        publish(Address(name, self.server.port, self.server.token, os.getpid()), folder)

    def stop(self, request: Any) -> dict[str, int]:
        self.stops += 1
        return self.answer


@pytest.fixture
def serve() -> Iterator[Any]:
    served: list[Served] = []

    def begin(*arguments: Any, **fields: Any) -> Served:
        served.append(Served(*arguments, **fields))
        return served[-1]

    yield begin
    for one in served:
        one.server.close()


def stopped(name: str) -> list[stop_request.Holder]:
    holders = holders_of(name)
    stop_all(holders)
    return holders


def silent_address(name: str) -> socket.socket:
    """A listener that accepts connections and never answers, as that of a process that hangs."""
    listener = socket.create_server(("127.0.0.1", 0))
    publish(Address(name, listener.getsockname()[1], "token", os.getpid()))
    return listener


@pytest.mark.parametrize("words", [["rig", "stop", RIG], ["display", "stop", "--name", "bench"]])
def test_a_stop_imports_neither_numpy_nor_typer(serve, words: list[str]) -> None:
    one = serve(RIG if words[0] == "rig" else supervisor_name("bench"))
    code = LOADS.format(words=[*words, "--json"])
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["code"] == STOPPED
    assert one.stops == 1
    loaded = set(done.stderr.split())
    assert "palpate.stop_request" in loaded
    assert not loaded & {"numpy", "typer", "click", "pydantic", "palpate.core", "palpate.devices"}


def test_every_holder_of_a_rig_is_stopped_in_every_workspace_and_no_other(serve) -> None:
    workspace = folder_of() / "workspaces" / "one"
    held = [serve(RIG), serve(supervisor_name(RIG)), serve(RIG, folder=workspace)]
    others = [serve("virtual:tactip"), serve("live one")]
    assert [one.code for one in stopped(RIG)] == [STOPPED] * 3
    assert [one.stops for one in held] == [1, 1, 1]
    assert [one.stops for one in others] == [0, 0]


def test_the_folder_of_addresses_is_that_of_the_processes() -> None:
    assert address_folder() == str(folder_of())


def test_a_dead_process_that_left_its_address_does_not_keep_its_supervisor_from_being_stopped(serve) -> None:
    gone = socket.create_server(("127.0.0.1", 0))
    publish(Address(RIG, gone.getsockname()[1], "token", os.getpid()))
    gone.close()
    supervisor = serve(supervisor_name(RIG))
    assert {one.name: one.code for one in stopped(RIG)} == {RIG: GONE, supervisor_name(RIG): STOPPED}
    assert supervisor.stops == 1


def test_a_process_that_hangs_is_waited_for_a_second_and_its_supervisor_is_stopped_meanwhile(serve) -> None:
    with silent_address(RIG):
        supervisor = serve(supervisor_name(RIG))
        begun_s = time.monotonic()
        assert {one.name: one.code for one in stopped(RIG)} == {RIG: SILENT, supervisor_name(RIG): STOPPED}
        assert time.monotonic() - begun_s < stop_request.SILENT_S + 1.0
        assert supervisor.stops == 1


def test_a_wrong_token_and_foreign_bytes_confirm_nothing(serve) -> None:
    one = serve(RIG)
    publish(Address(RIG, one.server.port, "another", os.getpid()))
    assert [holder.code for holder in stopped(RIG)] == [REFUSED]
    with socket.create_server(("127.0.0.1", 0)) as listener:
        publish(Address(RIG, listener.getsockname()[1], "token", os.getpid()))

        def babble() -> None:
            with listener.accept()[0] as connection:
                connection.sendall(b'[1]\n"two"\n{"id": 1, "ok": true}\n')

        threading.Thread(target=babble).start()
        assert [holder.code for holder in stopped(RIG)] == [GONE]
    assert one.stops == 0


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b'{"name": 1}', b"\xff", b"[" * 4096])
def test_an_address_file_that_is_none_is_passed_over(text: bytes) -> None:
    (folder_of() / "devices-virtual-palm.json").write_bytes(text)
    assert holders_of(RIG) == []


@pytest.mark.parametrize(
    "words",
    [["rig"], ["rig", "stop"], ["rig", "stop", "--help"], ["rig", "stop", "a", "b"], ["rig", "stop", "-x"],
     ["display", "stop", "--help"], ["display", "stop", "x"], ["display", "stop", "--name"], ["rig", "home"]],
)  # fmt: skip
def test_words_that_are_no_stop_are_left_to_the_command_tree(words: list[str]) -> None:
    assert run_stop(words) is None


def test_a_display_that_nobody_renders_on_and_one_that_hangs_end_with_a_code(capsys) -> None:
    assert run_stop(["display", "stop", "--name=bench", "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "nothing-renders"
    with silent_address(supervisor_name("bench")):
        assert run_stop(["display", "stop", "--json", "--name", "bench"]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "stop-not-confirmed"


def test_the_first_bytes_are_those_of_the_drivers() -> None:
    assert FIRST_BYTES["grbl"] == CANCEL
    assert FIRST_BYTES["marlin"].strip() == b"M410"


@pytest.mark.parametrize("held", [False, True])
def test_without_any_process_the_stage_s_port_gets_the_stop_first(tmp_path: Path, held: bool) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    rig = tmp_path / "bench.toml"
    rig.write_text(f'name = "bench"\n[stage]\nkind = "grbl"\nport = "{os.ttyname(slave)}"\n')
    if held:
        import fcntl

        fcntl.flock(slave, fcntl.LOCK_EX)
    assert run_stop(["rig", "stop", str(rig)]) is None  # the drivers confirm next
    assert os.read(master, 10) == CANCEL
    if not held:
        assert termios.tcgetattr(slave)[4] == termios.B115200
    os.close(master)
    os.close(slave)


def test_a_stop_of_a_hung_virtual_rig_is_not_confirmed_and_says_so() -> None:
    with silent_address(RIG):
        done = CliRunner().invoke(app, ["rig", "stop", RIG, "--json"])
    assert done.exit_code == 2
    assert json.loads(done.stdout)["error"]["code"] == "stop-not-confirmed"
