"""Scaling with processes: rendering presses, and training palm-compact's network.

Run ``python benchmarks/estimators/palm_scaling.py``, or with ``render`` or ``train`` for one half of it;
ROUNDS in the environment says how many rounds. Every process has one thread, unless it says two. Ways are
measured in turn once all is compiled and begun, and the best of each is compared, for other work on the
machine only ever adds time. Processor time is beside it, which other work adds little to: on a busy machine,
the share that does not divide is better read from that.

- Rendering: 12 frames each of presses of 96 px a side, at 16 depths, whose pictures are marched anew in every
  round. As in a training set of 16,000 frames, drawing them takes about as long as marching.
- Training: epochs of palm-compact's network at 96 x 192 px in batches of 64, from frames in memory. Two
  processes share each batch, and gloo takes the mean of their gradients.
- Two trainings at once that share nothing say what the machine itself takes from each.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable

for threads in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import numpy as np  # noqa: E402 - it counts threads when it is imported

SIDE = 96
PRESSES, FRAMES_EACH, DEPTHS = 50, 12, 16
ROWS, BATCH = 320, 64
ROUNDS = int(os.environ.get("ROUNDS", "8"))
ONE, TWO = "one process", "two processes"
APART, THREADS = "two at once, each the whole", "one process of two threads"
AS_ONE_OF_TWO = "as-one-of-two"  # the argument of torchrun's processes

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


def train() -> None:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    env = os.environ | {"CUDA_VISIBLE_DEVICES": ""}
    done = subprocess.run([*command, __file__, AS_ONE_OF_TWO], env=env, stdout=subprocess.PIPE, check=True)
    said = json.loads(done.stdout)
    taken: Taken = said["taken"]
    told(f"{ROWS} frames in batches of {BATCH}, {said['weights']} weights", taken)
    (wall, processor), (wall_2, own) = best(taken, ONE), best(taken, TWO)
    shares = [100 * (2 * two / one - 1) for one, two in ((processor, own), (wall, wall_2))]
    print("  share that does not divide, 2 T2 / T1 - 1: ", end="")
    print(f"{shares[0]:.0f} % by processor time, {shares[1]:.0f} % by the clock\n")


def as_one_of_two() -> None:
    """All ways in turn, by both processes; the first tells."""
    import torch

    from palpate.estimators.networks.distributed import ProcessGroup
    from palpate.estimators.networks.model_interface import Scaler
    from palpate.estimators.networks.training_loop import TrainingLoop, TrainingTask
    from palpate.sensors.palm.networks.palm_compact import CompactPalmNetwork, _loss
    from palpate.sensors.palm.networks.palm_training import Scales

    processes, rng = ProcessGroup.of_environment(), np.random.default_rng(0)
    frames = rng.integers(0, 256, (ROWS, SIDE, 2 * SIDE, 3), np.uint8)
    wanted = rng.normal(0, 1, (ROWS, 4)).astype(np.float32)
    scales = Scales(SIDE, (128.0, 128.0), (74.0, 74.0), Scaler(np.zeros(4), np.ones(4)), (0, 1, 2, 3))

    def fetch(rows: np.ndarray) -> np.ndarray:
        return np.stack([frames[row].transpose(2, 0, 1).astype(np.float32) for row in rows])

    lesson = TrainingTask(fetch, wanted, _loss, np.arange(ROWS), np.arange(0))
    network = CompactPalmNetwork(3, SIDE, scales)

    def epoch(alone: bool, threads: int = 1) -> None:
        torch.set_num_threads(threads)
        os.environ["WORLD_SIZE"] = "1" if alone else str(processes.size)
        TrainingLoop(1, BATCH, 2e-3).train(network, lesson, seed=0)

    ways: dict[str, tuple[bool, Callable[[], None]]] = {
        ONE: (False, lambda: epoch(alone=True)),
        TWO: (True, lambda: epoch(alone=False)),
        THREADS: (False, lambda: epoch(alone=True, threads=2)),
        APART: (True, lambda: epoch(alone=True)),
    }
    taken: Taken = {way: [] for way in ways}
    for i in range(ROUNDS + 1):  # the first warms up
        for way, (both, work) in ways.items():
            processes.wait()
            times = clocked(work) if both or processes.first else (0.0, 0.0)
            wall = processes.sum(times[0]) / (2 if both else 1)
            if i:
                taken[way].append((wall, times[1]))
    if processes.first:
        print(json.dumps({"taken": taken, "weights": sum(p.numel() for p in network.parameters())}))


def main() -> None:
    asked = sys.argv[1:]
    if asked == [AS_ONE_OF_TWO]:
        as_one_of_two()
        return
    if asked != ["train"]:
        render()
    if asked == ["render"]:
        return
    try:
        import torch  # noqa: F401
    except ImportError:
        print("torch is not installed, so nothing is trained: pip install 'palpate[train]'")
        return
    train()


if __name__ == "__main__":
    main()
