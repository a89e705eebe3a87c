"""What the studio's server keeps of first sessions: a process for each folder, and what it told last.

The session itself lies in its folder: whoever opens the page finds it as it stands, also after a restart.
"""

from __future__ import annotations

import base64
import json
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from palpate.core import Closing, InputError

MODULE = "palpate.studio.live.start_process"
MAX_LINE = 4 << 20  # bytes of a line, the longest of which is a picture
MAX_SESSIONS = 2
"""Sessions that go on at once: each opens a camera, and trains."""
ENDS_S = 15.0
"""Time for a process that is told to end to close what it records [s]; then it is killed."""


class StartRun:
    """Process of a session.

    Attributes:
        begun_s: Start, monotonic [s].
        session, collect: Newest reported status of the session and of the presses.
        at: Current step, also a repeated one; "" before the first report.
        picture: Number and JPEG bytes of the newest picture; None before the first.
        said: Result of the last typed weight.
        why: Reason why it ended, if it failed.
    """

    def __init__(self, command: list[str]) -> None:
        self.begun_s = time.monotonic()
        self.session: dict[str, Any] = {}
        self.collect: dict[str, Any] = {}
        self.step, self.done, self.total = "begins", 0, 0
        self.picture: tuple[int, bytes] | None = None
        self.said = self.why = self.at = ""
        self._process = subprocess.Popen(  # noqa: S603 - our own module, by our own interpreter
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        self._stopped = False
        self._ear = threading.Thread(target=self._hear, name="palpate-start", daemon=True)
        self._ear.start()

    @property
    def running(self) -> bool:
        """Whether it goes on."""
        return self._ear.is_alive()

    def weigh(self, force_n: float) -> None:
        """Tell it a weight that lies on the sensor now [N]."""
        pipe = self._process.stdin
        if pipe is not None and self.running:
            with suppress(OSError):
                pipe.write(json.dumps({"force_N": force_n}).encode() + b"\n")
                pipe.flush()

    def stop(self) -> None:
        """End it; what was recorded stays, and the next process goes on."""
        self._stopped = True
        self._process.terminate()

    def close(self) -> None:
        """End it, and wait for that."""
        self.stop()
        self._ear.join(ENDS_S)
        if self.running:
            self._process.kill()
            self._ear.join(ENDS_S)

    def _hear(self) -> None:
        said, last = self._process.stdout, ""
        assert said is not None
        with said:
            while line := said.readline(MAX_LINE):
                try:
                    told = json.loads(line)
                except ValueError:
                    last = line.decode(errors="replace").strip() or last
                    continue
                if isinstance(told, dict):
                    self._take(told)
        code = self._process.wait()
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        if code and not self.why:
            self.why = (
                "stopped; go on when you are ready" if self._stopped else f"status {code}: {last[-300:]}"
            )

    def _take(self, told: dict[str, Any]) -> None:
        if "picture" in told:
            number = 1 if self.picture is None else self.picture[0] + 1
            self.picture = number, base64.b64decode(told["picture"])
        if "progress" in told:
            self.step, self.done, self.total = told["progress"]
        self.session = told.get("session", told.get("done", {}).get("session", self.session))
        self.collect = told.get("collect", self.collect)
        self.said, self.at = str(told.get("said", self.said)), str(told.get("at", self.at))
        self.why = str(told.get("error", self.why))


class StartDesk(Closing):
    """First sessions of one server, by folder.

    Args:
        command: that goes through a session; another in tests.
    """

    def __init__(self, command: tuple[str, ...] = (sys.executable, "-m", MODULE)) -> None:
        self._command, self._turn = command, threading.Lock()
        self._runs: dict[Path, StartRun] = {}

    def run(self, folder: Path) -> StartRun | None:
        """The process of a folder's session, also one that has ended; None where none was begun here."""
        return self._runs.get(folder)

    def begin(
        self, folder: Path, camera: str, scale: str, presses: int, seed: int = 0, *,
        unit: str = "", real_time: bool = False, more: int = 0,
    ) -> StartRun:  # fmt: skip
        """Begin or resume a session; `more` presses in addition to those recorded, or anew without them."""
        with self._turn:
            going = [one for one in self._runs.values() if one.running]
            kept = self._runs.get(folder)
            if kept is not None and kept.running:
                raise InputError(
                    f"the session in {folder.name} goes on already; watch it, or stop it first",
                    code="session-running",
                )
            if len(going) >= MAX_SESSIONS:
                raise InputError(f"{MAX_SESSIONS} sessions go on; stop one first", code="too-many-sessions")
            words = [str(folder), "--camera", camera, "--scale", scale, "--presses", str(presses)]
            words += ["--seed", str(seed), *(["--unit", unit] if unit else [])]
            words += [*(["--real-time"] if real_time else []), *(["--more", str(more)] if more else [])]
            self._runs[folder] = StartRun([*self._command, *words])
            return self._runs[folder]

    def close(self) -> None:
        with self._turn:
            runs = list(self._runs.values())
        for one in runs:
            one.close()


def kept_session(folder: Path) -> dict[str, Any]:
    """A folder's session as it was kept; empty where there is none.

    Where the run of its presses was deleted, "gone" says what can be done, and no commands are told.
    """
    from palpate.workflows.stored_session import STATE, StoredSession

    if not (folder / STATE).is_file():
        return {}
    session = StoredSession(folder)
    if not session.presses_gone:
        return session.to_dict()
    told = {"step": session.step, "calibration": str(session.calibration), "gone": session.gone_text}
    return asdict(session.state) | told
