"""Times from a request to stop to its byte on the wire, on the faked GRBL stage; writes a small JSON.

Three ways a stop is asked for: by the operator (`OperatorControl` and `MotionGuard.interrupt`, as the thread
of a supervisor calls them that hears of Ctrl-C), by the page (`StageProxy.hold`, which goes to the stage
itself), and by the guard (a force sample above its
limit). The fake at the other end of a real pseudo-terminal sits in a process of its own, so that it shares no
interpreter with what is measured; it notes when each byte came, on the computer's one monotonic clock. So the
time includes the way over the pseudo-terminal and the waking of its reader, and no serial line or firmware.
What the stage runs on after the byte is told apart: there it is the fake's, not a real one's.

Usage: python benchmarks/rig/stop_latency.py --stops 500 --busy 4 --out stops.json
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import select
import sys
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import NS_PER_S, MonotonicClock, PalpateError, Wrench
from palpate.devices import Limits, Mounting, OperatorControl
from palpate.devices.device_proxies import StageProxy
from palpate.devices.force_bias import ForceBias
from palpate.devices.motion_guard import MotionGuard
from palpate.devices.operator_control import OperatorCommand, OperatorInterrupt
from palpate.rig.real.grbl.grbl_stage import GrblStage
from palpate.rig.real.grbl.grbl_supervisor import GrblSpec

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.fakes.grbl_firmware import GrblFirmware
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters

STOPS = (b"\x85", b"!", b"\x18")
SPEED_M_S, TRAVEL_M, STEP_M = 5e-3, 30e-3, 20e-3
ACCELERATION_MM_S2 = 500.0
SWITCH_S = 0.001  # as the process that holds a rig sets it
ASKED_MS = {"idle": 20.0, "busy": 100.0}  # at the 99th percentile
WAYS = ("operator", "page", "guard")


def _fake(path_to: Any, asked: Any) -> None:
    """Serve the fake until asked to end; send when the first stop byte came, and how far it ran on."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    settings = {120: ACCELERATION_MM_S2, 121: ACCELERATION_MM_S2, 122: ACCELERATION_MM_S2}
    firmware = GrblFirmware(
        GrblParameters(homed=True, settings=settings), GrblFaults(), time.monotonic_ns() / NS_PER_S
    )
    path_to.send(os.ttyname(theirs))
    came_ns, begun_mm = 0, 0.0
    while True:
        select.select([ours, asked], [], [], 0.002)
        now_ns = time.monotonic_ns()
        firmware.run_to(now_ns / NS_PER_S)
        if select.select([ours], [], [], 0)[0]:
            data = os.read(ours, 4096)
            if not came_ns and any(byte in data for byte in STOPS):
                came_ns, begun_mm = now_ns, firmware.place_mm[0]
            firmware.receive(data)
        if out := firmware.take():
            os.write(ours, out)
        if asked.poll():
            word = asked.recv()
            if word == "end":
                return
            if word == "clear":
                came_ns = 0
            asked.send((came_ns, abs(firmware.place_mm[0] - begun_mm) if came_ns else 0.0))


def _burn() -> None:
    if hasattr(os, "setpriority"):
        os.setpriority(os.PRIO_PROCESS, 0, 0)  # as others have it, whatever the measured process was given
    while True:
        np.linalg.norm(np.random.default_rng(0).standard_normal(20_000))


class Quiet:
    """A force sensor of 1000 samples/s in the air; `pushed` makes its next sample exceed any limit."""

    rate_hz, range_n = 1000.0, (50.0, 50.0, 50.0)

    def __init__(self, clock: MonotonicClock) -> None:
        self._clock, self._n, self.pushed, self.pushed_ns = clock, 0, False, 0

    def latest(self) -> Wrench:
        self._n += 1
        push_n = 40.0 if self.pushed else 0.0
        if self.pushed and not self.pushed_ns:
            self.pushed_ns = self._clock.now_ns()
        return Wrench(self._clock.now_ns(), (1e-3 * (self._n % 7), 0.0, push_n))

    def drain(self) -> list[Wrench]:
        return [self.latest()]

    def close(self) -> None:
        pass


@dataclass
class Lab:
    """The stage on the fake, its guard, and what asks it to stop."""

    stage: StageProxy
    force: Quiet
    guard: MotionGuard
    control: OperatorControl
    asked: Any

    def once(self, way: str, rng: np.random.Generator) -> tuple[float, float]:
        """One stop in the midst of a move: milliseconds to its byte, and millimetres after it."""
        self.tell("clear")
        asked_ns: list[int] = []

        def ask() -> None:
            time.sleep(float(rng.uniform(0.05, 0.15)))
            asked_ns.append(time.monotonic_ns())
            self.request(way)

        person = threading.Thread(target=ask)
        x, y, z = self.stage.position_m()
        aim = x + (STEP_M if x < -50e-3 else -STEP_M)
        person.start()
        try:
            self.guard.towards((aim, y, z), SPEED_M_S, step_m=STEP_M)
            raise SystemExit(f"a stop by {way} stopped nothing")
        except (PalpateError, OperatorInterrupt):
            person.join()
        self.stage.stop()
        came_ns, ran_on_mm = self.tell("came")
        begun = self.force.pushed_ns if way == "guard" else asked_ns[0]
        self.release()
        return (came_ns - begun) / 1e6, ran_on_mm

    def request(self, way: str) -> None:
        """Ask for a stop, in one of the ways."""
        if way == "operator":
            self.control.ask(OperatorCommand.ABORT)
            self.guard.interrupt(OperatorCommand.ABORT)
        elif way == "page":
            self.stage.hold()
        else:
            self.force.pushed = True

    def release(self) -> None:
        """Take the request back, for the next."""
        self.control._command = None
        self.force.pushed, self.force.pushed_ns = False, 0
        self.stage.release()

    def tell(self, word: str) -> tuple[int, float]:
        """Ask the fake."""
        self.asked.send(word)
        came: tuple[int, float] = self.asked.recv()
        return came


def summary(values: list[float], unit: str) -> dict[str, float]:
    """Median, 99th percentile and greatest."""
    p50, p99 = np.percentile(values, [50, 99])
    return {
        f"p50_{unit}": round(float(p50), 3),
        f"p99_{unit}": round(float(p99), 3),
        f"max_{unit}": round(max(values), 3),
    }


def measure(lab: Lab, stops: int, say: Callable[[str], None]) -> dict[str, Any]:
    """So many stops, the ways in turn."""
    rng = np.random.default_rng(0)
    times: dict[str, list[float]] = {way: [] for way in WAYS}
    after: list[float] = []
    told_s = time.monotonic()
    for i in range(stops):
        way = WAYS[i % len(WAYS)]
        ms, mm = lab.once(way, rng)
        times[way].append(ms)
        after.append(mm)
        if time.monotonic() - told_s > 5:
            told_s = time.monotonic()
            say(f"  {i + 1} of {stops} stops")
    every = [ms for one in times.values() for ms in one]
    return {
        "stops": stops,
        "to_byte": summary(every, "ms"),
        "by_way": {way: summary(one, "ms") for way, one in times.items()},
        "ran_on_after": summary(after, "mm"),
    }


def main() -> None:
    """Measure idle and beside busy processes, and write what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--stops", type=int, default=501)
    parser.add_argument("--busy", type=int, default=4, help="busy processes of the second part")
    parser.add_argument(
        "--nice", type=int, default=0, help="niceness of what is measured; below 0 needs root"
    )
    parser.add_argument("--out", type=Path, help="JSON to make; must not exist")
    options = parser.parse_args()
    if options.out and options.out.exists():
        raise SystemExit(f"{options.out} exists, and nothing is overwritten")
    context = multiprocessing.get_context("spawn")
    path_here, path_there = context.Pipe()
    asked_here, asked_there = context.Pipe()
    fake = context.Process(target=_fake, args=(path_there, asked_there), daemon=True)
    fake.start()
    if options.nice:
        os.nice(options.nice)
    sys.setswitchinterval(SWITCH_S)
    clock = MonotonicClock()
    port = path_here.recv()
    with GrblStage.open(GrblSpec(port, boot_s=0.1, latency_s=0.02), clock) as real:
        real.reference()
        result = {"speed_mm_s": SPEED_M_S * 1e3, "cores": os.cpu_count(), "load_before": os.getloadavg()[0]}
        for name, burners in (("idle", 0), ("busy", options.busy)):
            busy = [context.Process(target=_burn, daemon=True) for _ in range(burners)]
            for one in busy:
                one.start()
            time.sleep(2.0 * bool(burners))
            try:
                lab = lab_of(real, clock, asked_here)
                found = measure(lab, options.stops, lambda line: print(line, file=sys.stderr))
            finally:
                for one in busy:
                    one.terminate()
            found["asked_p99_ms"] = ASKED_MS[name]
            result[name] = found
            print(f"{name}: {json.dumps(found)}")
    asked_here.send("end")
    if options.out:
        options.out.write_text(json.dumps(result, indent=1) + "\n")


def lab_of(real: GrblStage, clock: MonotonicClock, asked: Any) -> Lab:
    """The measured parts, around an open stage."""
    force, control = Quiet(clock), OperatorControl()
    x, y, z = real.position_m()
    limits = Limits(
        (x - TRAVEL_M, y - 1e-3, z - 1e-3), (x + TRAVEL_M, y + 1e-3, z + 1e-3), age_s=0.5, overshoot_m=1e-3,
        step_m=STEP_M, force_rate_n_s=1e6,
    )  # fmt: skip
    stage = StageProxy(real, clock)
    guard = MotionGuard(stage, force, limits, ForceBias(Mounting()), clock, control)
    return Lab(stage, force, guard, control, asked)


if __name__ == "__main__":
    main()
