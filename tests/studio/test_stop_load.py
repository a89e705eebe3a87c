"""The emergency stop is in time while the page server is loaded, and the page server keeps its limits."""

import json
import os
import socket
import sys
import time

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.studio.conftest import REQUEST_S
from tests.studio.stop_load import Load, Stops, line, measured, started

from palpate.studio import page_limits

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are ended by POSIX signals")
STOP_MS = 50.0
"""Time of a stop at the 99th percentile, on a machine that does nothing else [ms]."""


@pytest.fixture
def served(plain_served):
    return plain_served


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_stop_is_in_time_while_pages_load_clients_never_read_and_requests_wait(tmp_path):
    process, address = started(tmp_path, 18461)
    try:
        stops = Stops(address)
        loaded = Load(stops)
        for fresh in (False, True):
            took = measured(stops, 300, fresh=fresh)
            print(line("fresh" if fresh else "kept", took))
            busy = os.getloadavg()[0] / (os.cpu_count() or 1)
            assert took[int(0.99 * len(took))] < STOP_MS * max(1.0, busy)
        assert loaded.close()
    finally:
        process.terminate()
        process.wait(60)


def closed_after_s(connection, most_s):
    """When the server closed a connection [s]; None where it did not."""
    begun_s = time.monotonic()
    connection.settimeout(most_s)
    try:
        while connection.recv(65536):
            pass
    except TimeoutError:
        return None
    except OSError:
        pass
    return time.monotonic() - begun_s


def request_of(served, path, *more):
    """A request with the token."""
    lines = [f"GET {path} HTTP/1.1", "Host: localhost", f"Authorization: Bearer {served.token}", *more]
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


def connected(served):
    return socket.create_connection(("127.0.0.1", served.port), 5)


@pytest.mark.parametrize(
    "part",
    [b"", b"GET / HTTP/1.1\r\nHost: loc", b"POST /estop HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\nab"],
)
def test_a_request_that_is_never_complete_is_closed_in_time(served, part):
    with connected(served) as one:
        one.sendall(part)
        took_s = closed_after_s(one, 3 * REQUEST_S)
        assert took_s is not None
        assert took_s > 0.5 * REQUEST_S


def test_more_connections_than_are_kept_close_the_oldest_that_waits(served):
    many = [connected(served) for _ in range(page_limits.MAX_CONNECTIONS + 20)]
    try:
        assert served.ask("GET", "/picture")[0] == 200
        assert all(closed_after_s(one, 5.0) is not None for one in many[:10])
    finally:
        for one in many:
            one.close()


def test_a_client_that_pipelines_and_never_reads_is_closed(served):
    with connected(served) as one:
        one.sendall(100 * request_of(served, "/picture"))
        assert closed_after_s(one, 10.0) is not None
    assert served.ask("GET", "/picture")[0] == 200


def test_pages_beyond_those_in_the_making_are_refused_for_now(served):
    many = [connected(served) for _ in range(4 * page_limits.MAX_PAGES)]
    for one in many:
        one.sendall(request_of(served, "/rig", "Connection: close"))
    status = []
    for one in many:
        with one:
            one.settimeout(60.0)
            status.append(one.recv(65536)[9:12])
    assert set(status) == {b"200", b"503"}
    end_s = time.monotonic() + 60.0
    while served.ask("GET", "/rig")[0] != 200:  # until the last of those pages is made
        assert time.monotonic() < end_s


def test_the_page_server_forwards_what_a_page_cannot_ask_the_listener(served):
    state = served.ask("POST", "/estop", body=b"state", x_palpate="estop")
    assert (state[0], json.loads(state[2])["active"]) == (200, ["made up"])
    moving = served.ask("POST", "/estop", body=b"stop-moving", x_palpate="estop")
    assert (moving[0], json.loads(moving[2])["moving"]) == (200, False)
    stop = served.ask("POST", "/estop", body=b"stop", x_palpate="estop")
    assert (stop[0], [one["name"] for one in json.loads(stop[2])["stopped"]]) == (200, ["made up"])
