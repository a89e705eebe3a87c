"""Long jobs of the pages, each in a process of its own: begun, watched, cancelled at the server's end."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import tempfile
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from palpate.core import Closing, InputError

MAX_RUNNING = 2
"""Jobs at once; more would only wait for the processor."""
MAX_KEPT = 50
MAX_LINE = 200_000  # bytes of what a job says in a line
MODULE = "palpate.studio.library.job_process"
ENDS_S = 3.0


@dataclass
class BackgroundJob:
    """Job in a process of its own."""

    number: int
    title: str
    out: Path
    process: subprocess.Popen[bytes]
    state: str = "running"
    step: str = "begins"
    done: int = 0
    total: int = 0
    found: dict[str, Any] = field(default_factory=dict)
    why: str = ""

    def hear(self) -> None:
        """Take in what the process says, until it ends."""
        said, last = self.process.stdout, ""
        assert said is not None
        with said:
            while line := said.readline(MAX_LINE):
                last = line.decode(errors="replace").strip() or last
                self._take(last)
        code = self.process.wait()
        if self.state == "running":
            self.why = self.why or ("" if code == 0 else f"it ended with status {code}: {last[-300:]}")
            self.state = "done" if code == 0 else "failed"

    def _take(self, line: str) -> None:
        try:
            told = json.loads(line)
        except ValueError:
            return
        if isinstance(told, dict):
            if "progress" in told:
                self.step, self.done, self.total = told["progress"]
            self.why = str(told.get("error", self.why))
            self.found = told.get("done", self.found)


class BackgroundJobs(Closing):
    """Jobs of one server."""

    def __init__(self, command: tuple[str, ...] = (sys.executable, "-m", MODULE)) -> None:
        self._command, self._turn = command, threading.Lock()
        self._numbers = itertools.count(1)
        self._folder = tempfile.TemporaryDirectory(prefix="palpate-studio-")
        self._jobs: dict[int, BackgroundJob] = {}
        self._ears: list[threading.Thread] = []

    def begin(
        self, title: str, do: str, *what: str | Path, suffix: str = "", out: Path | None = None
    ) -> BackgroundJob:
        """Start a job.

        Args:
            do: Name of the job in `job_process`.
            what: Folders and options of the job.
            suffix: Suffix of its result file, kept while the server runs.
        """
        with self._turn:
            if sum(job.state == "running" for job in self._jobs.values()) >= MAX_RUNNING:
                raise InputError(
                    f"{MAX_RUNNING} jobs are running; wait for one, or cancel it", code="too-many-jobs"
                )
            number = next(self._numbers)
            made = out or Path(self._folder.name) / f"{do}-{number}{suffix}"
            process = subprocess.Popen(  # noqa: S603 - our own module, by our own interpreter
                [*self._command, do, *map(str, what), str(made)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
            job = self._jobs[number] = BackgroundJob(number, title, made, process)
            for old in list(self._jobs)[:-MAX_KEPT]:
                if self._jobs[old].state != "running":
                    self._forget(old)
        ear = threading.Thread(target=job.hear, name=f"palpate-job-{number}", daemon=True)
        self._ears = [one for one in self._ears if one.is_alive()] + [ear]
        ear.start()
        return job

    def _forget(self, number: int) -> None:
        gone = self._jobs.pop(number)
        if gone.out.parent == Path(self._folder.name):
            gone.out.unlink(missing_ok=True)

    def get(self, number: int) -> BackgroundJob | None:
        """A job by its number; None of one that never was or is kept no longer."""
        return self._jobs.get(number)

    def cancel(self, number: int) -> None:
        """End a job that runs; of no consequence otherwise."""
        job = self._jobs.get(number)
        if job is not None and job.state == "running":
            job.state = "cancelled"
            job.process.terminate()

    def close(self) -> None:
        with self._turn:
            jobs = list(self._jobs.values())
        for job in jobs:
            self.cancel(job.number)
        for job in jobs:
            try:
                job.process.wait(ENDS_S)
            except subprocess.TimeoutExpired:
                job.process.kill()
        for ear in self._ears:
            ear.join(ENDS_S)
        self._folder.cleanup()
