"""Scaling with processes: rendering presses.

Run ``python benchmarks/estimators/palm_scaling.py``; ROUNDS in the environment says how many rounds. Every
process has one thread. Ways are measured in turn once all is compiled and begun, and the best of each is
compared, for other work on the machine only ever adds time. Processor time is beside it, which other work
adds little to: on a busy machine, the share that does not divide is better read from that.

- Rendering: 12 frames each of presses of 96 px a side, at 16 depths, whose pictures are marched anew in every
  round. As in a training set of 16,000 frames, drawing them takes about as long as marching.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

for threads in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import numpy as np  # noqa: E402 - it counts threads when it is imported

SIDE = 96
PRESSES, FRAMES_EACH, DEPTHS = 50, 12, 16
ROUNDS = int(os.environ.get("ROUNDS", "8"))
ONE, TWO = "one process", "two processes"

Taken = dict[str, list[tuple[float, float]]]  # by way: wall and processor seconds of each round


def clocked(work: Callable[[], object]) -> tuple[float, float]:
    """Wall and processor seconds of this process."""
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - processor


def best(taken: Taken, way: str) -> tuple[float, float]:
    return min(wall for wall, _ in taken[way]), min(processor for _, processor in taken[way])


def told(name: str, taken: Taken) -> None:
    cores = len(os.sched_getaffinity(0))
    print(f"{name}; {cores} cores, load {os.getloadavg()[0]:.1f}, {ROUNDS} rounds")
    alone = best(taken, ONE)[0]
    for way, times in taken.items():
        wall, processor = best(taken, way)
        median = np.median([one for one, _ in times])
        print(f"  {way:28s} best {wall:6.2f} s, median {median:6.2f} s, processor {processor:6.2f} s", end="")
        print(f" | {alone / wall:.2f} times as fast as one")


def render() -> None:
    from palpate.sensors import palm
    from palpate.sensors.palm import random_presses

    random_presses.DEPTHS = DEPTHS
    spec, seeds = palm.cropped(palm.palm(), SIDE, "scaling"), iter(range(10**6))

    def drawn(processes: int, count: int = PRESSES) -> None:
        rng = np.random.default_rng(next(seeds))  # other stiffness, and so other pictures
        random_presses.draw_presses(spec, count, FRAMES_EACH, rng, processes=processes)

    drawn(1, 1)
    begun, _ = clocked(lambda: drawn(2, 4))
    taken: Taken = {ONE: [], TWO: []}
    for _ in range(ROUNDS):
        taken[ONE].append(clocked(lambda: drawn(1)))
        taken[TWO].append(clocked(lambda: drawn(2)))
    told(f"{PRESSES * (1 + FRAMES_EACH)} frames of {SIDE} px", taken)
    (wall, processor), (wall_2, own) = best(taken, ONE), best(taken, TWO)
    print(f"  share that does not divide: {100 * own / processor:.1f} % by the processor time of the process")
    print(f"  that hands out and gathers, {100 * (2 * wall_2 / wall - 1):.0f} % by the clock (2 T2 / T1 - 1)")
    print(f"  beginning two workers, with their first frames: {begun:.1f} s\n")


if __name__ == "__main__":
    render()
