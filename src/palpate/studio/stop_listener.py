"""Start of the emergency stop listener, and requests to it from the page server."""

from __future__ import annotations

import http.client
import json
import secrets
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from palpate.core import Closing, DeviceError
from palpate.devices.rpc import path_of, shared_folder, supervisor_name

SCRIPT = Path(__file__).with_name("stop_process.py")
ANSWER_S = 3.0
AGAIN_S = 0.5  # between the end of the listener and its restart

Targets = Mapping[str, list[Path]]


def rig_targets(rig: str, bench: str, folder: Path | None) -> Targets:
    """Return the address files of all processes that a page may move, by the name of what they move.

    Args:
        rig: name of the rig, as `rig_name` gives it.
    """
    shared = shared_folder(folder)
    return {
        rig: [path_of(rig, folder), path_of(supervisor_name(rig), shared)],
        bench: [path_of(supervisor_name(bench), shared)],
    }


class StopListener(Closing):
    """Emergency stop listener in a process of its own, which is restarted if it ends.

    It outlives the page server until every process that moves something has ended.

    Args:
        port: preferred port; if it is taken, the system chooses one.
    """

    def __init__(self, targets: Targets, host: str = "127.0.0.1", port: int = 0) -> None:
        self.port, self.token = port, secrets.token_urlsafe(24)
        self._host, self._targets = host, targets
        self._closing = threading.Event()
        self._process = self._start()
        self._watcher = threading.Thread(target=self._watch, name="palpate-stop-watch", daemon=True)
        self._watcher.start()

    @property
    def pid(self) -> int:
        """Id of the listener's process."""
        return self._process.pid

    def ask(self, do: str) -> dict[str, Any]:
        """Send a request, and return the answer."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self._host, self._host)  # noqa: S104 - compared with
        connection = http.client.HTTPConnection(host, self.port, timeout=ANSWER_S)
        try:
            connection.request("POST", "/", json.dumps({"token": self.token, "do": do}))
            answer = json.loads(connection.getresponse().read())
        except (OSError, http.client.HTTPException, ValueError) as e:
            raise DeviceError("The emergency stop listener does not answer.") from e
        finally:
            connection.close()
        return dict(answer)

    def close(self) -> None:
        """Leave the listener; it ends once nothing is left to stop."""
        self._closing.set()
        _stdin(self._process).close()

    def _start(self) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(  # noqa: S603 - our own script, by our own interpreter
            [sys.executable, "-I", "-S", str(SCRIPT)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        targets = [{"name": name, "paths": list(map(str, paths))} for name, paths in self._targets.items()]
        config = {"host": self._host, "port": self.port, "token": self.token, "targets": targets}
        stdin = _stdin(process)
        stdin.write(json.dumps(config).encode() + b"\n")
        stdin.flush()
        assert process.stdout is not None
        with process.stdout as said:
            line = said.readline()
        if not line:
            process.kill()
            process.wait()
            stdin.close()
            raise DeviceError("The emergency stop listener did not start.")
        self.port = int(json.loads(line)["port"])
        return process

    def _watch(self) -> None:
        while not self._closing.is_set():
            ended = self._process
            ended.wait()
            _stdin(ended).close()
            if not self._closing.wait(AGAIN_S):
                self._process = self._start()


def _stdin(process: subprocess.Popen[bytes]) -> IO[bytes]:
    assert process.stdin is not None
    return process.stdin
