"""The emergency stop listener: a process of its own, with the token, in time, whatever else hangs."""

import ast
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress

import pytest

from palpate.devices.rpc import (
    Address,
    find,
    publish,
    running,
    shared_folder,
    supervisor_name,
    workspace_folder,
)
from palpate.devices.rpc_server import RpcServer
from palpate.studio import stop_listener, stop_process
from palpate.studio.stop_listener import SCRIPT, StopListener, rig_targets
from palpate.studio.stop_process import is_moving

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are ended by POSIX signals")
RIG, BENCH = "made up rig", "made up bench"
RESTS = {"state": "ready", "recording": False, "held": False}
MOVES = {"state": "running", "recording": True, "held": False}
MAX_S = 10.0


class Rig:
    """Process of a rig, as the listener reaches it."""

    def __init__(self, folder, name=RIG, status=RESTS, answer=None):
        self.status, self.stops, self._answer = dict(status), 0, answer
        quick = {"estop": lambda _: self._estop(), "status": lambda _: self.status}
        self.server = RpcServer(name, lambda: self.status, lambda after: None, quick, {})
        address = Address(name, self.server.port, self.server.token, os.getpid())
        self.path = publish(address, folder)

    def _estop(self):
        self.stops += 1
        if self._answer is not None:
            self._answer()
        return {"asked_ns": 0, "stood_ns": 1}

    def close(self):
        self.path.unlink(missing_ok=True)
        self.server.close()


@pytest.fixture
def rig(tmp_path):
    rig = Rig(tmp_path)
    yield rig
    rig.close()


@pytest.fixture
def listener(tmp_path):
    with StopListener(rig_targets(RIG, BENCH, tmp_path)) as listener:
        yield listener
    with suppress(ProcessLookupError):
        os.kill(listener.pid, signal.SIGKILL)


@pytest.fixture
def quick_listener(tmp_path, monkeypatch):
    """A listener whose times are a tenth as long."""
    text = SCRIPT.read_text(encoding="utf-8")
    for name in ("REQUEST_S", "LINGER_S"):
        seconds = getattr(stop_process, name)
        assert f"\n{name} = {seconds}" in text
        text = text.replace(f"\n{name} = {seconds}", f"\n{name} = {seconds / 10}")
        monkeypatch.setattr(stop_process, name, seconds / 10)
    (tmp_path / "quick.py").write_text(text, encoding="utf-8")
    monkeypatch.setattr(stop_listener, "SCRIPT", tmp_path / "quick.py")
    with StopListener(rig_targets(RIG, BENCH, tmp_path)) as listener:
        yield listener
    with suppress(ProcessLookupError):
        os.kill(listener.pid, signal.SIGKILL)


def until(holds, what="it"):
    end_s = time.monotonic() + MAX_S
    while time.monotonic() < end_s:
        if holds():
            return
        time.sleep(0.02)
    raise AssertionError(f"{what} did not come")


def reached(listener, *names):
    until(lambda: set(names) <= set(listener.ask("state")["active"]), names)


def raw(port, data, timeout=MAX_S):
    """What is answered to bytes, until the connection is closed or nothing comes for long."""
    with socket.create_connection(("127.0.0.1", port), 5) as connection:
        connection.sendall(data)
        connection.settimeout(timeout)
        found = b""
        try:
            while more := connection.recv(65536):
                found += more
        except (TimeoutError, ConnectionResetError):
            pass
        return found


def test_who_reads_what_the_studio_says_does_not_wait_for_its_listener(tmp_path):
    words = [sys.executable, "-I", "-S", str(SCRIPT)]
    with subprocess.Popen(words, **dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)) as process:
        config = {"host": "127.0.0.1", "port": 0, "token": "t", "targets": []}
        process.stdin.write(json.dumps(config).encode() + b"\n")
        process.stdin.flush()
        assert json.loads(process.stdout.readline())["port"]
        process.stdin.close()
        assert process.stderr.read() == b""
        assert process.poll() is None  # it still listens, for those that stop after the studio's end
        process.kill()


def request_of(listener, do="stop", token=None, **headers):
    body = json.dumps({"token": listener.token if token is None else token, "do": do}).encode()
    lines = [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    lines += [f"Content-Length: {len(body)}"]
    return ("POST / HTTP/1.1\r\nHost: localhost\r\n" + "\r\n".join(lines) + "\r\n\r\n").encode() + body


def test_the_listener_imports_the_standard_library_alone():
    tree = ast.parse(SCRIPT.read_text(encoding="utf-8"))
    names = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module] if isinstance(node, ast.ImportFrom) else [one.name for one in node.names])
    }
    assert names <= sys.stdlib_module_names
    assert "palpate" not in names


@pytest.mark.parametrize(
    ("status", "moves"),
    [
        (RESTS, False),
        (MOVES, True),
        ({**MOVES, "held": True}, False),
        ({**MOVES, "state": "paused"}, False),
        ({"state": "opens", "held": False}, True),  # a supervisor that homes
        ({"state": "waits", "held": False}, False),
        ({"state": "carries out lift", "held": False}, True),
        ({"state": "renders", "held": False}, True),
        ({"state": "ended", "held": False}, False),
        ({}, True),  # unknown
    ],
)
def test_what_moves_is_told_from_the_status(status, moves):
    assert is_moving(status) is moves


def test_a_stop_reaches_the_rig_and_names_what_stood_and_when(listener, rig):
    reached(listener, RIG)
    answer = listener.ask("stop")
    assert (answer["ok"], [one["name"] for one in answer["stopped"]], answer["failed"]) == (True, [RIG], [])
    assert 0 <= answer["stopped"][0]["ms"] < 1e3 * stop_process.STOP_S
    assert rig.stops == 1


def test_a_stop_that_depends_on_motion_stops_what_moves_and_nothing_at_rest(listener, rig):
    reached(listener, RIG)
    assert listener.ask("stop-moving") == {"ok": True, "moving": False, "stopped": [], "failed": []}
    assert rig.stops == 0
    rig.status = dict(MOVES)  # not told yet: the listener asks
    answer = listener.ask("stop-moving")
    assert (answer["moving"], rig.stops) == (True, 1)
    until(lambda: listener.ask("state")["moving"] == [RIG])


def test_what_does_not_say_whether_it_moves_is_stopped(listener, tmp_path):
    asked = threading.Event()
    rig = Rig(tmp_path)
    try:
        reached(listener, RIG)
        rig.server.quick["status"] = lambda _: asked.wait(1.0)
        assert listener.ask("stop-moving")["moving"] is True
        until(lambda: rig.stops == 1)
    finally:
        asked.set()
        rig.close()


def test_where_the_rigs_process_hangs_the_supervisor_stops_the_stage(listener, tmp_path):
    hangs = threading.Event()
    rig = Rig(tmp_path, status=MOVES, answer=lambda: hangs.wait(MAX_S))
    supervisor = Rig(tmp_path, supervisor_name(RIG), {"state": "waits", "held": False})
    bench = Rig(tmp_path, supervisor_name(BENCH), {"state": "renders", "held": False})
    try:
        reached(listener, RIG, BENCH)
        answer = listener.ask("stop")
        assert (answer["ok"], {one["name"] for one in answer["stopped"]}) == (True, {RIG, BENCH})
        assert (supervisor.stops, bench.stops) == (1, 1)
    finally:
        hangs.set()
        for one in (rig, supervisor, bench):
            one.close()


def test_a_stop_that_nobody_confirms_fails_in_time_and_says_which(listener, tmp_path):
    hangs = threading.Event()
    rig = Rig(tmp_path, answer=lambda: hangs.wait(MAX_S))
    try:
        reached(listener, RIG)
        begun_s = time.monotonic()
        answer = listener.ask("stop")
        assert (answer["ok"], answer["failed"]) == (False, [{"name": RIG, "error": "no-answer"}])
        assert time.monotonic() - begun_s < stop_process.STOP_S + 1.0
    finally:
        hangs.set()
        rig.close()


def test_a_stop_that_reaches_nothing_fails(listener, rig):
    reached(listener, RIG)
    rig.close()
    until(lambda: listener.ask("state")["active"] == [])
    answer = listener.ask("stop")
    assert (answer["ok"], answer["failed"]) == (False, [{"name": "", "error": "not-reached"}])
    assert listener.ask("stop-moving")["moving"] is False


@pytest.mark.parametrize("token", ["", "x", None])
def test_nobody_without_the_token_stops_or_sees_anything(listener, rig, token):
    reached(listener, RIG)
    if token is None:
        token = listener.token[:-1]
    for do in ("state", "stop", "stop-moving"):
        answer = raw(listener.port, request_of(listener, do, token, Origin="http://elsewhere.example"))
        assert answer.startswith(b"HTTP/1.1 403")
        assert b"access-control" not in answer.lower()
        assert RIG.encode() not in answer
    assert rig.stops == 0


@pytest.mark.parametrize(
    "data",
    [b"GET / HTTP/1.1\r\n\r\n", b"OPTIONS / HTTP/1.1\r\nOrigin: http://elsewhere.example\r\n\r\n",
     b"\r\n\r\n", b"POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\n[1]", b"x" * 20_000,
     b"POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", b"\x16\x03\x01" + bytes(500) + b"\r\n\r\n",
     b"POST / HTTP/1.1\r\nContent-Length: 99999\r\n\r\n",
     b"POST / HTTP/1.1\r\nContent-Length: 4000\r\n\r\n" + 2000 * b"[["],
)  # fmt: skip
def test_what_is_no_request_is_refused_and_the_listener_goes_on(listener, rig, data):
    reached(listener, RIG)
    answer = raw(listener.port, data)
    assert answer == b"" or answer[9:12] in (b"403", b"413", b"431")
    assert b"access-control" not in answer.lower()
    assert listener.ask("stop")["ok"]


def test_a_page_with_the_token_may_read_the_answer_without_a_preflight(listener, rig):
    reached(listener, RIG)
    connection = http.client.HTTPConnection("127.0.0.1", listener.port, timeout=MAX_S)
    body = json.dumps({"token": listener.token, "do": "state"})
    for _ in range(3):  # over one connection
        connection.request("POST", "/", body, {"Origin": "http://localhost:8080"})
        answer = connection.getresponse()
        assert answer.getheader("Access-Control-Allow-Origin") == "http://localhost:8080"
        assert json.loads(answer.read())["active"] == [RIG]
    connection.close()


def test_half_open_requests_end_in_time_and_the_newest_is_always_served(quick_listener, rig):
    listener = quick_listener
    reached(listener, RIG)
    many = []
    try:
        begun_s = time.monotonic()
        for _ in range(stop_process.MAX_CONNECTIONS + 100):
            many.append(socket.create_connection(("127.0.0.1", listener.port), 5))
            many[-1].sendall(b"POST / HTTP/1.1\r\n")
        assert listener.ask("stop")["ok"]
        for one in (many[0], many[99]):  # the oldest went first
            one.settimeout(MAX_S)
            assert one.recv(1) == b""
        many[-1].settimeout(2 * stop_process.REQUEST_S)
        assert many[-1].recv(1) == b""
        assert time.monotonic() - begun_s > stop_process.REQUEST_S
    finally:
        for one in many:
            one.close()


def test_a_page_that_has_proven_the_token_is_kept_when_others_crowd_in(listener, rig):
    reached(listener, RIG)
    kept = http.client.HTTPConnection("127.0.0.1", listener.port, timeout=MAX_S)
    body = json.dumps({"token": listener.token, "do": "state"})
    kept.request("POST", "/", body)
    kept.getresponse().read()
    own = kept.sock
    many = [
        socket.create_connection(("127.0.0.1", listener.port), 5)
        for _ in range(stop_process.MAX_CONNECTIONS + 50)
    ]
    kept.request("POST", "/", body)
    assert json.loads(kept.getresponse().read())["ok"]
    assert kept.sock is own
    for one in (*many, kept):
        one.close()


def test_the_listener_outlives_its_server_until_nothing_is_left_to_stop(quick_listener, rig):
    listener = quick_listener
    reached(listener, RIG)
    listener.close()  # as when the server is killed: its end of the pipe is closed
    time.sleep(1.5 * stop_process.LINGER_S)
    assert listener.ask("stop")["ok"]
    rig.close()
    listener._process.wait(MAX_S)


def test_a_listener_that_is_killed_is_restarted_with_its_port_and_token(listener, rig):
    reached(listener, RIG)
    port, token, pid = listener.port, listener.token, listener.pid
    os.kill(pid, signal.SIGKILL)
    until(lambda: listener.pid != pid)
    reached(listener, RIG)
    assert (listener.port, listener.token) == (port, token)
    assert listener.ask("stop")["ok"]


def test_processes_belong_to_a_workspace_and_are_found_by_their_name_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    one, other = (workspace_folder(tmp_path / name) for name in ("one", "other"))
    assert one == workspace_folder(tmp_path / "x" / ".." / "one") != other
    assert shared_folder(one) == tmp_path / "run" / "palpate"
    assert shared_folder(tmp_path) == tmp_path
    assert find(RIG) is None
    rig = Rig(one)
    try:
        assert find(RIG, other) is None
        assert running("made", other) == []
        assert find(RIG, one) == find(RIG)  # a command that stops a rig by its name needs no workspace
        publish(Address(RIG, 1, "stale", 2**22 + 1))
        assert find(RIG) == find(RIG, one)
    finally:
        rig.close()
