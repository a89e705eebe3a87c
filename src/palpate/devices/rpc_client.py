"""Client of a process that holds devices: starts it, asks it, and keeps the newest that it pushes."""

from __future__ import annotations

import base64
import contextlib
import itertools
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from palpate.core import Closing, DeviceError, PalpateError, ProtocolError, errors, storage_errors
from palpate.devices.rpc import SAID_BYTES, Address, Lines, decode_message, encode_message, find, path_of

HOST = "127.0.0.1"
CONNECT_S = 2.0
AGAIN_S = 0.3  # between two tries to reach the process
ANSWER_S = 60.0
LOOK_S = 0.01
CHUNK = 1 << 20

Answer = SimpleQueue[Mapping[str, Any] | None]


class RpcClient(Closing):
    """Asks one process that holds devices, and reaches for it again whenever it is gone.

    Args:
        name: of the process, as it published itself.
        folder: of the address file where it is not the user's own.

    Attributes:
        name: of the process.
        status: the newest that it told; None while it cannot be reached.
        told_s: when it told a status last [s, monotonic time]; None before the first. It outlives `status`.
        picture: the newest frame as ``(number, JPEG bytes, (width, height))``.
    """

    def __init__(self, name: str, folder: Path | None = None) -> None:
        self.name = name
        self._folder = folder
        self.status: dict[str, Any] | None = None
        self.told_s: float | None = None
        self.picture: tuple[int, bytes, tuple[int, int]] | None = None
        self._numbers = itertools.count(1)
        self._sending = threading.Lock()
        self._waiting: dict[int, Answer] = {}
        self._socket: socket.socket | None = None
        self._after = -1
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="palpate-rpc-client", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Go away; the process goes on."""
        self._closing.set()
        self._hang_up()
        self._thread.join(CONNECT_S + AGAIN_S)

    def leave(self) -> int:
        """Tell the process that this client goes soon; the number of clients that stay."""
        return int(self.ask("leave"))

    def reached(self, within_s: float) -> bool:
        """Wait for the process to answer; False where it does not in time."""
        try:
            self.wait_for(lambda status: True, within_s)
        except DeviceError:
            return False
        return True

    def wait_for(self, holds: Callable[[dict[str, Any]], object], timeout_s: float) -> dict[str, Any]:
        """The first status of which something holds, of those told after whatever was asked last."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            status = self.status
            if status is not None and status["serial"] > self._after and holds(status):
                return status
            time.sleep(LOOK_S)
        status = self.status or {}
        state = {k: status[k] for k in ("state", "message", "shots", "why") if k in status} or None
        raise DeviceError(
            f"what was waited for did not come within {timeout_s:g} s; {self.name} says {state}"
        )

    def ask(self, do: str, **fields: Any) -> Any:
        """Ask for something, and wait for what came of it."""
        return self.send(do, ANSWER_S, **fields)()

    def send(self, do: str, timeout_s: float, **fields: Any) -> Callable[[], Any]:
        """Ask at once; what is returned waits for the answer."""
        number, answer = self._begin(do, fields)
        return lambda: self._end(do, number, answer, timeout_s)

    def _begin(self, do: str, fields: Mapping[str, Any]) -> tuple[int, Answer]:
        number, answer = next(self._numbers), Answer()
        self._waiting[number] = answer
        try:
            self._send({"id": number, "do": do, **fields})
        except BaseException:
            self._waiting.pop(number, None)
            raise
        return number, answer

    def _end(self, do: str, number: int, answer: Answer, timeout_s: float) -> Any:
        try:
            reply = answer.get(timeout=timeout_s)
        except Empty:
            reply = None
        finally:
            self._waiting.pop(number, None)
        if reply is None:
            raise DeviceError(f"the process of {self.name} did not answer to {do!r}", code="process-silent")
        if not reply["ok"]:
            raise _error(str(reply["kind"]), str(reply["error"]), str(reply.get("code") or ""))
        self._after = max(self._after, int(reply["serial"]))
        return reply["result"]

    def _send(self, message: Mapping[str, Any]) -> None:
        line = encode_message(message)
        with self._sending:
            if self._socket is None:
                raise DeviceError(
                    f"the process of {self.name} cannot be reached; is it running?",
                    code="process-unreachable",
                )
            try:
                self._socket.sendall(line)
            except OSError as e:
                raise DeviceError(f"the process of {self.name} is gone: {e}", code="process-gone") from e

    def _run(self) -> None:
        while not self._closing.is_set():
            address = find(self.name, self._folder)
            if address is not None:
                with contextlib.suppress(OSError, PalpateError):
                    self._stay(address)
                self._hang_up()
            self._closing.wait(AGAIN_S)

    def _stay(self, address: Address) -> None:
        with socket.create_connection((HOST, address.port), CONNECT_S) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(encode_message({"token": address.token, "id": 0}))
            lines, admitted = Lines(SAID_BYTES), False
            while data := connection.recv(CHUNK):
                for line in lines.feed(data):
                    if line is None:
                        continue
                    message = decode_message(line)
                    if not admitted:
                        if not message.get("ok"):
                            raise ProtocolError(str(message.get("error")))
                        admitted = True
                        connection.settimeout(None)
                        with self._sending:
                            self._socket = connection
                    self._take(message)

    def _take(self, message: dict[str, Any]) -> None:
        match message.get("push"):
            case "status":
                self.status = message
                self.told_s = time.monotonic()
            case "picture":
                width, height = message["size_px"]
                self.picture = (message["number"], base64.b64decode(message["jpeg"]), (width, height))
            case _:
                answer = self._waiting.get(message.get("id") or 0)
                if answer is not None:
                    answer.put(message)

    def _hang_up(self) -> None:
        with self._sending:
            connection, self._socket = self._socket, None
        self.status, self._after = None, -1
        if connection is not None:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        for answer in list(self._waiting.values()):
            answer.put(None)


def _error(kind: str, message: str, code: str) -> PalpateError:
    """Make the error that was raised in the process, or the nearest of its family."""
    family = getattr(errors, "SafetyError" if kind == "Tripped" else kind, None)
    if isinstance(family, type) and issubclass(family, PalpateError):
        return family(message, code=code)
    return DeviceError(f"the process failed: {kind}: {message}", code=code)


START_S = 120.0  # a virtual rig's first start compiles
START_LOOK_S = 0.05
TAIL = 400  # characters of what the process said


def launch_process(
    name: str, words: Sequence[str], folder: Path | None = None, variables: Mapping[str, str] | None = None
) -> tuple[subprocess.Popen[bytes], Address]:
    """Start the process and wait until it can be reached. It outlives its starter, and its terminal.

    Args:
        name: under which it publishes its address.
        words: what the Python interpreter is called with, such as ("-m", "a.module").
        folder: of the address file, where it is not the user's own.
        variables: of its environment, where the user's own says nothing of them.

    Raises:
        DeviceError: it ended at once, or did not begin to listen; the message says what it said.
    """
    log = path_of(name, folder, "log")
    with storage_errors(log):
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        process = subprocess.Popen(  # noqa: S603 - our own module, by our own interpreter
            [sys.executable, *words],
            stdin=subprocess.DEVNULL,
            stdout=handle,
            stderr=handle,
            start_new_session=True,
            env={**(variables or {}), **os.environ},
        )
    finally:
        os.close(handle)
    end_s = time.monotonic() + START_S
    while time.monotonic() < end_s and process.poll() is None:
        address = find(name, folder)
        if address is not None and address.pid == process.pid:
            return process, address
        time.sleep(START_LOOK_S)
    output = log.read_text(errors="replace").strip()[-TAIL:]
    if process.poll() is None:
        process.terminate()
    raise DeviceError(
        f"the process of {name} did not start: {output or 'it said nothing'}", code="process-not-started"
    )
