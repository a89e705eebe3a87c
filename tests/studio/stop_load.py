"""Measures the emergency stop of a studio under load.

The studio runs with the virtual rig in processes of its own. A further process loads it: pages that are
loaded over and over, clients that request and never read, and requests that are never completed, at the
port of the pages and at that of the stop. Meanwhile stops are sent as a page sends them.
"""

import asyncio
import http.client
import json
import os
import re
import socket
import subprocess
import sys
import time
from contextlib import suppress

PAGES, SILENT, HALF_OPEN = 300, 100, 1500
AGAIN_S = 0.2  # between two loads of one page
MAX_S = 120.0
CODE = "import typer; from palpate.cli.study.study_verbs import studio; typer.run(studio)"


def started(folder, port):
    """A studio with the virtual rig, once it answers; the process, and the address that it printed."""
    words = ["--port", str(port), "--workspace", str(folder), "--rig", "virtual:palm"]
    process = subprocess.Popen(
        [sys.executable, "-c", CODE, *words],
        env={**os.environ, "XDG_RUNTIME_DIR": str(folder)},
        stdout=subprocess.PIPE,
        text=True,
    )
    address = ""
    while not address.startswith("http"):
        address = process.stdout.readline()
        assert address, "the studio ended"
    end_s = time.monotonic() + MAX_S
    while time.monotonic() < end_s:
        with suppress(OSError):
            socket.create_connection(("127.0.0.1", port), 5).close()
            return process, address.split()[0]
        time.sleep(0.1)
    raise AssertionError("the studio does not listen")


class Stops:
    """Sends stops as a page of this studio does, and measures until the answer has come [s].

    Args:
        address: that the studio printed.
    """

    def __init__(self, address):
        self.port = int(re.search(r":(\d+)/", address).group(1))
        token = re.search(r"token=([\w-]+)", address)
        self.cookie = f"palpate-token-{self.port}={token.group(1)}" if token else "none=0"
        self.confirmed_ms = []  # from the listener's receipt of a stop to the rig's confirmation
        page = self._page()
        about = re.search(r'const listener = (\{"port".*?\})', page)
        self.listener = json.loads(about.group(1)) if about else None

    def _page(self):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=MAX_S)
        connection.request("GET", "/rig", headers={"Cookie": self.cookie})
        return connection.getresponse().read().decode()

    def connect(self):
        """A connection as a page keeps it."""
        port = self.listener["port"] if self.listener else self.port
        return http.client.HTTPConnection("127.0.0.1", port, timeout=MAX_S)

    def stop(self, connection):
        """Time of a stop, which has to be confirmed [s]."""
        begun_s = time.perf_counter()
        if self.listener:
            connection.request("POST", "/", json.dumps({"token": self.listener["token"], "do": "stop"}))
        else:
            headers = {"x-palpate": "estop", "Cookie": self.cookie}
            connection.request("POST", "/estop", headers=headers)
        answer = json.loads(connection.getresponse().read())
        took_s = time.perf_counter() - begun_s
        assert answer.get("stopped") or "stood_ns" in answer, answer
        if self.listener:
            self.confirmed_ms.append(answer["stopped"][0]["ms"])
        return took_s


async def _load_page(port, cookie):
    while True:
        with suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(f"GET /rig HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nCookie: {cookie}\r\n"
                         "Connection: close\r\n\r\n".encode())  # fmt: skip
            head = await reader.read(1 << 20)
            COUNTS[head[9:12].decode() or "closed"] = COUNTS.get(head[9:12].decode() or "closed", 0) + 1
            while await reader.read(1 << 20):
                pass
            writer.close()
        await asyncio.sleep(AGAIN_S)


COUNTS = {}


async def _hold(port, sent, buffer=0):
    """Send bytes, read nothing, and begin anew when the connection is closed."""
    while True:
        connection = socket.socket()
        connection.setblocking(False)
        if buffer:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        loop = asyncio.get_running_loop()
        with suppress(OSError):
            await loop.sock_connect(connection, ("127.0.0.1", port))
            await loop.sock_sendall(connection, sent)
            while not buffer and await loop.sock_recv(connection, 1):
                pass
            await asyncio.sleep(1.0 if not buffer else MAX_S)
        connection.close()
        await asyncio.sleep(AGAIN_S)


async def load(port, cookie, ports, pages, silent, half_open):
    """Load a studio until this is ended; a line is printed once it is under way."""
    request = f"GET /rig HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nCookie: {cookie}\r\n\r\n".encode()
    partial = b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100\r\n"
    tasks = [
        asyncio.create_task(_hold(one, partial)) for one in ports for _ in range(half_open // len(ports))
    ]
    tasks += [asyncio.create_task(_hold(port, 20 * request, 2048)) for _ in range(silent)]
    await asyncio.sleep(2.0)
    tasks += [asyncio.create_task(_load_page(port, cookie)) for _ in range(pages)]
    await asyncio.sleep(1.0)
    print("loaded", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    print(json.dumps(COUNTS), flush=True)
    os._exit(0)


def measured(stops, count, *, fresh, every_s=0.05):
    """Times of stops over a connection that is kept, or over a fresh one for each [ms]."""
    took, kept = [], stops.connect()
    for _ in range(count):
        connection = stops.connect() if fresh else kept
        took.append(1e3 * stops.stop(connection))
        if fresh:
            connection.close()
        time.sleep(every_s)
    return sorted(took)


def line(name, took):
    """Percentiles of times, with the load of the machine."""
    at = lambda share: took[min(int(share * len(took)), len(took) - 1)]  # noqa: E731
    return (f"{name}: n {len(took)}, median {at(0.5):.1f}, p95 {at(0.95):.1f}, p99 {at(0.99):.1f}, "
            f"max {took[-1]:.1f} ms; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")  # fmt: skip


class Load:
    """Processes that load a studio, until it is closed."""

    def __init__(self, stops, pages=PAGES, silent=SILENT, half_open=HALF_OPEN):
        ports = [stops.port, *([stops.listener["port"]] if stops.listener else [])]
        words = ["--load", str(stops.port), stops.cookie, ",".join(map(str, ports))]
        words += list(map(str, (pages, silent, half_open)))
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.studio.stop_load", *words],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout.readline().strip() == "loaded"

    def close(self):
        """End it; how many pages were answered, by their status."""
        said, _ = self.process.communicate("")
        return json.loads(said)
