"""How others on this machine ask a rig's process: requests, and the newest of what it tells."""

from __future__ import annotations

import base64
import contextlib
import itertools
import socket
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from palpate.core import errors
from palpate.core.errors import DeviceError, PalpateError, ProtocolError
from palpate.rig.service.address import Address, find
from palpate.rig.service.wire import SAID_BYTES, Lines, decode, encode

HOST = "127.0.0.1"
CONNECT_S = 2.0
AGAIN_S = 0.3  # between two tries to reach the process
ANSWER_S = 60.0
ESTOP_S = 5.0
LOOK_S = 0.01
CHUNK = 1 << 20

Answer = SimpleQueue[Mapping[str, Any] | None]


class RigClient:
    """Asks one rig's process, and reaches for it again whenever it is gone.

    Attributes:
        status: the newest that it told; None while it cannot be reached.
        picture: the newest frame as ``(number, JPEG bytes, (width, height))``.

    Example:
        >>> with RigClient("virtual:palm") as rig:  # doctest: +SKIP
        ...     rig.plan("palm-reduced")
        ...     rig.start("first")
    """

    def __init__(self, rig: str, folder: Path | None = None) -> None:
        """Args: the rig's name, and the folder of the address file where it is not the user's own."""
        self._rig = rig
        self._folder = folder
        self.status: dict[str, Any] | None = None
        self.picture: tuple[int, bytes, tuple[int, int]] | None = None
        self._numbers = itertools.count(1)
        self._sending = threading.Lock()
        self._waiting: dict[int, Answer] = {}
        self._socket: socket.socket | None = None
        self._after = -1
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="palpate-rig-client", daemon=True)
        self._thread.start()

    def __enter__(self) -> RigClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Go away; the rig's process goes on."""
        self._closing.set()
        self._hang_up()
        self._thread.join(CONNECT_S + AGAIN_S)

    def plan(self, what: str | Mapping[str, Any]) -> dict[str, Any]:
        """Set what is recorded next."""
        return self._ask("plan", plan=what if isinstance(what, str) else dict(what))

    def start(self, out: str) -> dict[str, Any]:
        """Record it into a run of this name, or go on with that run."""
        return self._ask("start", out=out)

    def pause(self) -> None:
        """Stop moving, lift the probe, wait."""
        self._ask("pause")

    def resume(self) -> None:
        """Go on after a pause."""
        self._ask("resume")

    def stop(self) -> None:
        """End after this press."""
        self._ask("stop")

    def abort(self) -> None:
        """Stop moving, lift the probe, end."""
        self._ask("abort")

    def estop(self) -> dict[str, Any]:
        """Emergency stop. When it was asked for and when the stage stood, on the rig's clock [ns]."""
        return self.send_estop()()

    def send_estop(self) -> Callable[[], dict[str, Any]]:
        """Emergency stop, asked for at once; what is returned waits for the answer."""
        number, answer = self._begin("estop", {})
        return lambda: self._end("estop", number, answer, ESTOP_S)

    def release(self) -> None:
        """Take the emergency stop back."""
        self._ask("release")

    def shutdown(self) -> None:
        """End the process, unless it records."""
        self._ask("shutdown")

    def ask_status(self) -> dict[str, Any]:
        """The status now."""
        return self._ask("status")

    def reached(self, within_s: float) -> bool:
        """Whether the process answers, or comes to within some time."""
        try:
            self.wait_for(lambda status: True, within_s)
        except DeviceError:
            return False
        return True

    def wait_for(self, holds: Callable[[dict[str, Any]], object], timeout_s: float) -> dict[str, Any]:
        """The first status of which something holds, of those told after whatever was asked last.

        Raises:
            DeviceError: none came in time.
        """
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            status = self.status
            if status is not None and status["serial"] > self._after and holds(status):
                return status
            time.sleep(LOOK_S)
        said = None if self.status is None else {k: self.status[k] for k in ("state", "message", "shots")}
        raise DeviceError(f"what was waited for did not come within {timeout_s:g} s; the rig says {said}")

    def _ask(self, do: str, **fields: Any) -> Any:
        number, answer = self._begin(do, fields)
        return self._end(do, number, answer, ANSWER_S)

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
            raise DeviceError(f"the process of the rig {self._rig} did not answer to {do!r}")
        if not reply["ok"]:
            raise _error(str(reply["kind"]), str(reply["error"]))
        self._after = max(self._after, int(reply["serial"]))
        return reply["result"]

    def _send(self, message: Mapping[str, Any]) -> None:
        line = encode(message)
        with self._sending:
            if self._socket is None:
                raise DeviceError(f"the process of the rig {self._rig} cannot be reached; is it running?")
            try:
                self._socket.sendall(line)
            except OSError as e:
                raise DeviceError(f"the process of the rig {self._rig} is gone: {e}") from e

    def _run(self) -> None:
        while not self._closing.is_set():
            address = find(self._rig, self._folder)
            if address is not None:
                with contextlib.suppress(OSError, PalpateError):
                    self._stay(address)
                self._hang_up()
            self._closing.wait(AGAIN_S)

    def _stay(self, address: Address) -> None:
        with socket.create_connection((HOST, address.port), CONNECT_S) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(encode({"token": address.token, "id": 0}))
            lines, admitted = Lines(SAID_BYTES), False
            while data := connection.recv(CHUNK):
                for line in lines.feed(data):
                    if line is None:
                        continue
                    message = decode(line)
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


def _error(kind: str, message: str) -> PalpateError:
    """As it was raised in the process, or the nearest of its family."""
    found = getattr(errors, "SafetyError" if kind == "Tripped" else kind, None)
    if isinstance(found, type) and issubclass(found, PalpateError):
        return found(message)
    return DeviceError(f"the rig's process failed: {kind}: {message}")
