"""Laws of the process that others ask: what it was asked last is answered, also where that ends it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from palpate.core import DeviceError
from palpate.devices.rpc import Address, encode_message, publish, running
from palpate.devices.rpc_client import RpcClient
from palpate.devices.rpc_server import ANSWERED_S, RpcServer

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
