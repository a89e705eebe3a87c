"""Laws of the process that others ask: what it was asked last is answered, also where that ends it."""

import os
import resource
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.core import DeviceError
from palpate.devices import rpc
from palpate.devices.rpc import (
    MAX_TOKEN_BYTES,
    MAX_UNAUTHENTICATED,
    Address,
    decode_message,
    encode_message,
    publish,
    running,
)
from palpate.devices.rpc_client import RpcClient
from palpate.devices.rpc_server import ANSWERED_S, MAX_CLIENTS, RpcServer

ENDED_S = 0.05


def status() -> Mapping[str, Any]:
    return {"state": "waits", "message": "", "shots": 0}


@contextmanager
def served(folder: Path, **asked: Any) -> Iterator[tuple[RpcServer, RpcClient]]:
    """A server, and a client that it has let in."""
    server = RpcServer("one", status, lambda after: None, asked, {})
    publish(Address("one", server.port, server.token, os.getpid()), folder)
    with closing(server), RpcClient("one", folder) as client:
        assert client.reached(5.0)
        yield server, client


def test_a_request_that_ends_the_process_is_answered_before_its_line_is_cut(tmp_path) -> None:
    ends = threading.Event()

    def end(_: Mapping[str, Any]) -> str:
        ends.set()
        time.sleep(ENDED_S)  # the server is being closed meanwhile
        return "ended"

    with served(tmp_path, end=end) as (server, client):
        answer = client.send("end", 5.0)
        assert ends.wait(5.0)
        server.close()
        assert answer() == "ended"


def test_numpy_numbers_of_a_plug_in_are_sent_as_plain_ones_and_nothing_else_is() -> None:
    force_n = np.float32(0.5)
    line = encode_message({"force_n": force_n, "reached": force_n > 0.1, "count": np.int64(3)})
    assert decode_message(line.strip()) == {"force_n": 0.5, "reached": True, "count": 3}
    for value in (np.float32("nan"), object()):
        with pytest.raises((ValueError, TypeError)):
            encode_message({"value": value})


def test_a_client_that_reads_nothing_holds_up_no_end(tmp_path) -> None:
    with served(tmp_path, much=lambda _: "x" * 8_000_000) as (server, client):
        with socket.create_connection(("127.0.0.1", server.port)) as deaf:
            deaf.sendall(encode_message({"token": server.token}) + encode_message({"id": 1, "do": "much"}))
            time.sleep(0.2)
            begun_s = time.monotonic()
            server.close()
            assert time.monotonic() - begun_s < ANSWERED_S + 1.0
        with pytest.raises(DeviceError):
            client.ask("much")


def test_processes_that_run_are_named_by_their_prefix_and_those_that_are_gone_are_not(tmp_path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    for name, pid in (
        ("live b", os.getpid()),
        ("live a", os.getpid()),
        ("rig", os.getpid()),
        ("live c", gone.pid),
    ):
        publish(Address(name, 1, "token", pid), tmp_path)
    (tmp_path / "devices-broken.json").write_text("[]")
    assert running("live ", tmp_path) == ["live a", "live b"]


SILENT = 600
STOPPED_S = 0.5  # on a machine that does other work as well; 1 to 5 ms when idle


@contextmanager
def silent_sockets(port: int, count: int) -> Iterator[list[socket.socket]]:
    """Connections that send nothing."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = count + MAX_UNAUTHENTICATED + 500
    if soft < wanted:
        if hard < wanted:
            pytest.skip(f"{wanted} open files are needed, {hard} are permitted")
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    opened: list[socket.socket] = []
    try:
        opened.extend(socket.create_connection(("127.0.0.1", port), 5.0) for _ in range(count))
        yield opened
    finally:
        for one in opened:
            one.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def first_line(connection: socket.socket) -> bytes:
    with connection.makefile("rb") as lines:
        return lines.readline()


def test_a_client_stops_while_hundreds_of_silent_sockets_wait(tmp_path) -> None:
    server = RpcServer("one", status, lambda after: None, {"stop": lambda _: "stopped"}, {})
    publish(Address("one", server.port, server.token, os.getpid()), tmp_path)
    with closing(server), silent_sockets(server.port, SILENT) as waiting:
        begun_s = time.monotonic()
        with RpcClient("one", tmp_path) as client:
            assert client.reached(5.0)
            assert client.ask("stop") == "stopped"
        assert time.monotonic() - begun_s < STOPPED_S
        for one in waiting[: SILENT // 2]:  # evicted long before their deadline
            one.settimeout(1.0)
            assert one.recv(1) == b""


def test_clients_keep_coming_through_while_silent_sockets_keep_coming(tmp_path) -> None:
    server = RpcServer("one", status, lambda after: None, {"stop": lambda _: "stopped"}, {})
    token = encode_message({"token": server.token, "id": 0})
    ended = threading.Event()

    def flood() -> None:
        kept: list[socket.socket] = []
        while not ended.is_set():
            kept.append(socket.create_connection(("127.0.0.1", server.port), 5.0))
            if len(kept) > 200:
                kept.pop(0).close()
        for one in kept:
            one.close()

    flooding = threading.Thread(target=flood)
    with closing(server):
        flooding.start()
        try:
            for _ in range(15):
                with (
                    socket.create_connection(("127.0.0.1", server.port), 5.0) as one,
                    one.makefile("rb") as lines,
                ):
                    one.sendall(token + encode_message({"id": 1, "do": "stop"}))
                    assert decode_message(lines.readline())["ok"]
                    answers = (decode_message(line) for line in lines)
                    assert next(a for a in answers if "push" not in a)["result"] == "stopped"
        finally:
            ended.set()
            flooding.join()


def test_a_silent_socket_has_no_thread_and_no_slot_and_ends_at_its_deadline(monkeypatch) -> None:
    auth_s = 0.5
    monkeypatch.setattr(rpc, "AUTH_S", auth_s)
    server = RpcServer("one", status, lambda after: None, {}, {})
    with closing(server):
        threads = threading.active_count()
        with silent_sockets(server.port, MAX_UNAUTHENTICATED) as waiting:
            begun_s = time.monotonic()
            waiting[-1].settimeout(auth_s + 3.0)
            assert threading.active_count() <= threads
            assert waiting[-1].recv(1) == b""
            assert 0.5 * auth_s < time.monotonic() - begun_s < auth_s + 2.0


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b'{"token": "guess", "id": 0}\n', "rpc-token"),
        (b"x" * (MAX_TOKEN_BYTES + 1), "rpc-token"),
        (b"no JSON\n", "protocol"),
    ],
)
def test_a_first_line_without_the_token_is_refused_by_code(line: bytes, code: str) -> None:
    server = RpcServer("one", status, lambda after: None, {}, {})
    with closing(server), socket.create_connection(("127.0.0.1", server.port), 5.0) as stranger:
        stranger.sendall(line)
        answer = decode_message(first_line(stranger))
        assert (answer["ok"], answer["code"]) == (False, code)


def test_an_authenticated_client_beyond_the_limit_is_refused_by_code_and_the_others_go_on() -> None:
    server = RpcServer("one", status, lambda after: None, {"stop": lambda _: "stopped"}, {})
    token = encode_message({"token": server.token, "id": 0})
    with closing(server):
        clients = [socket.create_connection(("127.0.0.1", server.port), 5.0) for _ in range(MAX_CLIENTS + 1)]
        try:
            answers = []
            for one in clients:
                one.sendall(token)
                answers.append(decode_message(first_line(one)))
            assert all(answer["ok"] for answer in answers[:MAX_CLIENTS])
            assert (answers[-1]["ok"], answers[-1]["code"]) == (False, "rpc-clients")
        finally:
            for one in clients:
                one.close()
