"""Devices for rigs with a supervisor: a spring under a stage, in real time, whose every stand is on disk.

The stage and the force sensor live in the supervisor's process and share its memory; the test reads what
they wrote.
"""

import json
import math
import random
import time
from pathlib import Path

import numpy as np

from palpate.core import Frame, Position, Travel, Wrench

NS = 1_000_000_000
RATE_HZ = 500.0
STIFFNESS_N_M = 2e3  # of the skin, whose surface is z = 0
NOISE_N = 0.005


class World:
    """Where the probe was at any time: straight pieces (begun, from, to, speed)."""

    def __init__(self) -> None:
        self.pieces: list[tuple[int, Position, Position, float]] = [
            (0, (0.0, 0.0, -2e-3), (0.0, 0.0, -2e-3), 1.0)
        ]

    def place(self, at_ns: int) -> Position:
        begun, start, end, speed = next(one for one in reversed(self.pieces) if one[0] <= at_ns)
        length = math.dist(start, end)
        part = (at_ns - begun) / NS * speed / length if length else 1.0
        if part >= 1.0:
            return end
        x, y, z = (a + (b - a) * part for a, b in zip(start, end, strict=True))
        return x, y, z


WORLD = World()


class BenchStage:
    """Moves at once and at one speed; `log` is a file of one line for each move and each stand."""

    travel = Travel((-10e-3,) * 3, (10e-3,) * 3, 20e-3, 0.5, 0.005)

    def __init__(self, log: str, opens_s: float = 0.0, moving_s: float = 0.0) -> None:
        self._log, self._moving_s = Path(log), moving_s
        end_s = time.monotonic() + opens_s
        try:
            while time.monotonic() < end_s:
                self._note("opens", WORLD.place(time.monotonic_ns()))
                time.sleep(0.02)
        except BaseException:
            self._note("abandoned", WORLD.place(time.monotonic_ns()))
            raise

    def position_m(self) -> Position:
        return WORLD.place(time.monotonic_ns())

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        now = time.monotonic_ns()
        WORLD.pieces.append((now, WORLD.place(now), position_m, speed_m_s))
        self._note("move", position_m)

    def moving(self) -> bool:
        time.sleep(self._moving_s)
        return self.position_m() != WORLD.pieces[-1][2]

    def stop(self) -> None:
        now = time.monotonic_ns()
        at = WORLD.place(now)
        WORLD.pieces.append((now, at, at, 1.0))
        self._note("stop", at)

    def close(self) -> None:
        self.stop()
        self._note("close", self.position_m())

    def _note(self, what: str, place: Position) -> None:
        with self._log.open("a") as file:
            file.write(json.dumps({"what": what, "place": place, "time_ns": time.monotonic_ns()}) + "\n")


class BenchForce:
    """Samples a spring at a steady rate, from `dead_after_s` on with zeros."""

    rate_hz = RATE_HZ
    range_n = (50.0, 50.0, 50.0)

    def __init__(self, force_N: float = 0.0) -> None:
        self._more_n = force_N
        self._noise = random.Random(1)
        self._last_ns = time.monotonic_ns()
        self._newest = self._sample(self._last_ns)

    def latest(self) -> Wrench:
        if time.monotonic_ns() - self._newest.time_ns > 2 * NS / RATE_HZ:
            self._newest = self._sample(time.monotonic_ns())
        return self._newest

    def drain(self) -> list[Wrench]:
        now, step = time.monotonic_ns(), round(NS / RATE_HZ)
        samples = [self._sample(at) for at in range(self._last_ns + step, now, step)]
        if samples:
            self._last_ns, self._newest = samples[-1].time_ns, samples[-1]
        return samples

    def _sample(self, at_ns: int) -> Wrench:
        depth = max(WORLD.place(at_ns)[2], 0.0)
        normal = STIFFNESS_N_M * depth
        fx, fy, fz, tx, ty, tz = (self._noise.gauss(0.0, NOISE_N) for _ in range(6))
        return Wrench(at_ns, (fx, fy, fz + normal), (tx, ty, tz))

    def close(self) -> None:
        pass


class BenchCamera:
    """Frames of noise, and one that hangs for `hangs_s` from frame `hangs_at` on."""

    rate_hz = 100.0
    size_px = (8, 6)

    def __init__(self, hangs_at: int = 0, hangs_s: float = 0.0) -> None:
        self._count, self._hangs = 0, (hangs_at, hangs_s)
        self._random, self._last_ns = np.random.default_rng(0), time.monotonic_ns()

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        self._count += 1
        if self._count == self._hangs[0]:
            time.sleep(self._hangs[1])
        while not (frames := self.drain()):
            time.sleep(0.002)
        return frames[-1]

    def drain(self) -> list[tuple[int, Frame]]:
        now, step = time.monotonic_ns(), round(NS / self.rate_hz)
        stamps = range(self._last_ns + step, now, step)
        self._last_ns = stamps[-1] if stamps else self._last_ns
        return [
            (at, Frame(self._random.integers(0, 255, (6, 8), dtype=np.uint8), exposure_s=0.005))
            for at in stamps
        ]

    def close(self) -> None:
        pass
