"""Recordings that are killed -9 at random moments and begun again by the same call, until each is whole.

    python -m tests.rig.killed_recordings 1000 killed     # from the repository's root

A recording is a forked child, so that its first moments are the engine's and not those of Python's imports.
Three quarters of the kills are uniform over a recording's whole length, one quarter over its first tenth,
from before its folder is there. Moments are of the child's own processor time, so that a machine with other
work kills at the same places; a few milliseconds of the clock follow, so that waits for the disk are hit too.
What lay on disk at one kill must lie there at the next.
"""

import hashlib
import json
import os
import resource
import shutil
import signal
import sys
import time
import traceback
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tests.rig.rigs import near, quick

from palpate.core import ManualClock
from palpate.recordings import Run, check
from palpate.rig import State, record
from palpate.rig.virtual import Variation

FIRST, SHARE_FIRST = 0.1, 0.25
MAX_WAIT_S = 0.01
PLAN = quick(name="killed", frames=3, reference_frames=3)


@dataclass
class Tally:
    """Kills; those in the first tenth, before the folder, and without a frame; runs, and what was wrong."""

    kills: int = 0
    early: int = 0
    unbegun: int = 0
    empty: int = 0
    runs: int = 0
    wrong: list[str] = field(default_factory=list)


def recorded(out: Path) -> bool:
    variation = Variation(force_noise_n=2e-3, frame_jitter_s=0.0, relaxation=())
    rig = near(clock=ManualClock(time.monotonic_ns()), variation=variation)
    return record(rig, PLAN, out).state is State.DONE


def processor_s(child: int) -> float:
    """Processor time that a process has taken [s]; Linux names its clock so."""
    try:
        return time.clock_gettime((~child << 3) | 2)
    except OSError:
        return float("inf")  # it has ended


def recorded_in_child(out: Path, kill_after_s: float | None, wait_s: float = 0.0) -> str | None:
    """Record in a child; None where it was killed, after processor time and a wait, else how it ended."""
    child = os.fork()
    if child == 0:
        status = 9
        try:
            status = 0 if recorded(out) else 1
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    if kill_after_s is not None:
        while processor_s(child) < kill_after_s:
            pid, status = os.waitpid(child, os.WNOHANG)
            if pid:
                return _ended(status)
            time.sleep(0.001)
        time.sleep(wait_s)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return _ended(status)


def _ended(status: int) -> str | None:
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL:
        return None
    return "done" if os.waitstatus_to_exitcode(status) == 0 else f"status {status}"


def stored(out: Path) -> dict[str, str]:
    """Checksum of each file of a run."""
    files = sorted(out.iterdir()) if out.is_dir() else []
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def faults_of(out: Path) -> list[str]:
    """How the frames of a run differ from the plan's, and records without a frame."""
    run = Run.open(out)
    labels = run.labels.dropna(subset=["shot"])
    held = Counter(zip(labels["shot"], labels["frame_in_shot"].astype(int), strict=True))
    wanted = Counter((s.key, k) for press in PLAN.presses() for s, n in PLAN.shots(press) for k in range(n))
    found = [f"{key} is there {held[key]} times" for key in held | wanted if held[key] != wanted[key]]
    for index in range(len(run)):
        run.frame(index)
    report = check(out)
    return found + ([f"{report.orphan_records} records without a frame"] if report.orphan_records else [])


def killed_until_whole(out: Path, rng: np.random.Generator, length_s: float, most: int, tally: Tally) -> None:
    """One run, killed at random moments until it comes to its end by itself, or `most` kills are spent."""
    before: dict[str, str] = {}
    kills = 0
    while True:
        early = rng.random() < SHARE_FIRST
        after_s = float(rng.uniform(0.0, FIRST * length_s if early else length_s))
        wait_s = float(rng.uniform(0.0, MAX_WAIT_S))
        ended = recorded_in_child(out, after_s if kills < most else None, wait_s)
        now = stored(out)
        tally.wrong += [f"{out.name}: {name} was altered" for name in before if now.get(name) != before[name]]
        before = now
        if ended is not None:
            break
        kills += 1
        tally.early += after_s <= FIRST * length_s
        tally.unbegun += not out.exists()
        tally.empty += out.exists() and len(Run.open(out)) == 0
    if ended != "done":
        tally.wrong.append(f"{out.name}: after {kills} kills it ended with {ended}")
    tally.kills += kills
    tally.runs += 1
    tally.wrong += [f"{out.name}: {what}" for what in faults_of(out)]


def killed(kills: int, folder: Path) -> dict[str, Any]:
    """Kill so many recordings, and return what was met; runs that were right are thrown away."""
    folder.mkdir(parents=True, exist_ok=True)
    rng, tally = np.random.default_rng(kills), Tally()
    recorded(folder / "warm")  # so that nothing is built for the first time below
    before_s = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert recorded_in_child(folder / "whole", None) == "done"
    after_s = resource.getrusage(resource.RUSAGE_CHILDREN)
    length_s = sum(after_s[:2]) - sum(before_s[:2])
    while tally.kills < kills:
        out = folder / f"run-{tally.runs}"
        wrong = len(tally.wrong)
        killed_until_whole(out, rng, length_s, kills - tally.kills, tally)
        if len(tally.wrong) == wrong:
            shutil.rmtree(out)
    return asdict(tally)


if __name__ == "__main__":
    print(json.dumps(killed(int(sys.argv[1]), Path(sys.argv[2]))))
