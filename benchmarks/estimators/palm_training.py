"""Training of palm-joint-raw: torch's defaults against palpate's loop, in speed and in what is learnt.

Run ``python benchmarks/estimators/palm_training.py [--threads 2]``. Both loops see the same images in the
same order, with the same steps of Adam and the same clipped gradients. Torch's defaults are float32 and
contiguous memory; palpate's loop lays channels last and multiplies in bfloat16 where the processor does that
fast.

Speed is of single steps at 128 px a view, taken in turn. What is learnt is compared at 64 px a view, where a
training takes seconds: on rendered presses, the last ones held out, from several seeds each. A training this
short leaves errors that differ from seed to seed; the table shows by how much, beside the loops' ratio.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

SIDE, SMALL, BATCH, RATE, STEPS = 128, 64, 32, 1e-3, 10
SMALL_BATCH = 16  # for more steps of a short training
PRESSES, DEPTHS, HELD_OUT = 40, 8, 8  # presses, frames of each, presses held out
SHOWN = ("force_N", "x_mm", "y_mm")
ASKED = 1.6


def presses() -> tuple[np.ndarray, np.ndarray]:
    """Images ``[n c h w]``, grey levels, and values in the model's order; nothing pulls sideways."""
    from palpate.sensors import palm
    from palpate.sensors.palm.random_presses import draw_presses

    spec = palm.cropped(palm.preset("palm"), SMALL, "palm-rendered")
    drawn = draw_presses(spec, PRESSES, DEPTHS, np.random.default_rng(0))
    _, x, y, force = drawn.values.T
    values = np.stack([np.zeros_like(x), np.zeros_like(x), force, x, y], axis=1)
    return np.ascontiguousarray(drawn.images.transpose(0, 3, 1, 2), dtype=np.float32), values.astype(float)


def enlarged(images: np.ndarray) -> np.ndarray:
    """The first batch at the side that speed is measured at."""
    wide = [cv2.resize(i.transpose(1, 2, 0), (2 * SIDE, SIDE)).transpose(2, 0, 1) for i in images[:BATCH]]
    return np.ascontiguousarray(wide)


class Task:
    """What both loops shall learn."""

    def __init__(self, images: np.ndarray, values: np.ndarray, learn: np.ndarray) -> None:
        from palpate.estimators.networks.model_interface import Scaler
        from palpate.sensors.palm.networks.palm_report_networks import PalmJointRaw
        from palpate.sensors.palm.networks.palm_training import Scales

        half = images.shape[3] // 2
        views = images[learn][..., :half], images[learn][..., half:]
        level, contrast = ((float(f(views[0])), float(f(views[1]))) for f in (np.mean, np.std))
        scaler = Scaler.of(values[learn])
        self.scales = Scales(half, level, contrast, scaler, tuple(range(values.shape[1])))
        self.images, self.values, self.learn = images, values, learn
        self.wanted = scaler.scaled(values).astype(np.float32)
        self.loss = PalmJointRaw().loss

    def network(self, seed: int) -> Any:
        import torch

        from palpate.sensors.palm.networks.palm_report_networks import JointNetwork

        torch.manual_seed(seed)
        return JointNetwork(self.images.shape[1], self.scales)

    def errors(self, network: Any, rows: np.ndarray) -> np.ndarray:
        """Mean absolute errors of the targets that are shown."""
        import torch

        with torch.no_grad():
            said = network.eval().values(torch.from_numpy(self.images[rows])).numpy()
        return np.abs(said - self.values[rows]).mean(axis=0)[2:]


class Plain:
    """The loop as torch's tutorials write it."""

    def __init__(self, task: Task, plan: Any, seed: int) -> None:
        import torch

        self.task, self.plan, self.seed, self.epoch = task, plan, seed, 0
        self.network = task.network(seed)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=plan.learning_rate)

    def one_epoch(self) -> None:
        order = np.random.default_rng([self.seed, self.epoch]).permutation(self.task.learn)
        parts = [order[i : i + self.plan.batch] for i in range(0, len(order), self.plan.batch)]
        self.network.train()
        for i, part in enumerate(parts):
            self._step(part, self.plan.rate(i + self.epoch * len(parts), len(parts)))
        self.epoch += 1

    def _step(self, part: np.ndarray, rate: float) -> None:
        import torch

        self.optimiser.param_groups[0]["lr"] = rate
        answer = self.network(torch.from_numpy(self.task.images[part]))
        loss = self.task.loss(answer, torch.from_numpy(self.task.wanted[part]))
        self.optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.plan.clip)
        self.optimiser.step()


def ours(task: Task, plan: Any, seed: int) -> Any:
    """Palpate's loop: what `palpate calibrate` trains by."""
    from palpate.estimators.networks.training_loop import TrainingRun, TrainingTask

    lesson = TrainingTask(task.images.__getitem__, task.wanted, task.loss, task.learn, task.learn[:0])
    return TrainingRun(plan, task.network(seed), lesson, seed)


def speed(task: Task, plan: Any) -> None:
    """Images a second of both, a step each in turn."""
    loops = {"torch's defaults": Plain(task, plan, 0), "palpate": ours(task, plan, 0)}
    seconds: dict[str, list[float]] = {name: [] for name in loops}
    for i in range(-1, STEPS):
        for name, loop in loops.items():
            started = time.perf_counter()
            loop.one_epoch()
            if i >= 0:
                seconds[name].append(time.perf_counter() - started)
    print(f"one step of {BATCH} images, {SIDE} px a view:")
    for name, taken in seconds.items():
        low, middle, high = BATCH / np.quantile(taken, [0.75, 0.5, 0.25])
        print(f"  {name:18s} {middle:6.1f} images/s, middle half {low:.1f} to {high:.1f}")
    each = np.divide(seconds["torch's defaults"], seconds["palpate"])
    low, middle, high = np.quantile(each, [0.25, 0.5, 0.75])
    print(f"  palpate / torch's defaults: {middle:.2f}, middle half {low:.2f} to {high:.2f} (asked: {ASKED})")


def learnt(task: Task, plan: Any, seeds: int, held: np.ndarray) -> None:
    """Held-out errors of both, trained from the same seeds."""
    begin: dict[str, Callable[[int], Any]] = {
        "torch's defaults": lambda seed: Plain(task, plan, seed),
        "palpate": lambda seed: ours(task, plan, seed),
    }
    found: dict[str, list[np.ndarray]] = {name: [] for name in begin}
    for seed in range(seeds):
        for name, make in begin.items():
            loop = make(seed)
            for _ in range(plan.epochs):
                loop.one_epoch()
            found[name].append(task.errors(loop.network, held))
    guess = np.abs(task.values[held] - task.values[task.learn].mean(axis=0)).mean(axis=0)[2:]
    print(f"after {plan.epochs} epochs of {len(task.learn)} images, {SMALL} px a view, {len(held)} held out:")
    print(f"  {'MAE':18s}" + "".join(f"{name:>26s}" for name in SHOWN))
    for name, errors in found.items():
        cells = [f"{e.mean():.3f} ({e.min():.3f} to {e.max():.3f})" for e in np.transpose(errors)]
        print(f"  {name:18s}" + "".join(f"{cell:>26s}" for cell in cells))
    print(f"  {'saying the mean':18s}" + "".join(f"{g:26.3f}" for g in guess))
    plain, other = (np.mean(errors, axis=0) for errors in found.values())
    print(
        "  palpate's MAE / torch's: "
        + ", ".join(f"{n} {r:.2f}" for n, r in zip(SHOWN, other / plain, strict=True))
    )


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    asked.add_argument("--threads", type=int, default=2)
    asked.add_argument("--epochs", type=int, default=6)
    asked.add_argument("--seeds", type=int, default=2)
    given = asked.parse_args()
    try:
        import torch
    except ImportError:
        print("torch is not installed, so there is nothing to train with: pip install 'palpate[train]'")
        return
    from palpate.estimators.networks.compact_cnn import fast_bfloat16
    from palpate.estimators.networks.training_loop import TrainingLoop

    torch.set_num_threads(given.threads)
    print(
        f"palm-joint-raw, {given.threads} threads, load {os.getloadavg()[0]:.1f}, this processor multiplies "
        f"bfloat16 {'fast' if fast_bfloat16() else 'slowly: both loops compute in float32'}"
    )
    images, values = presses()
    one_batch = Task(enlarged(images), values[:BATCH], np.arange(BATCH))
    speed(one_batch, TrainingLoop(1, BATCH, RATE))
    first_held = (PRESSES - HELD_OUT) * DEPTHS
    task = Task(images, values, np.arange(first_held))
    learnt(
        task,
        TrainingLoop(given.epochs, SMALL_BATCH, RATE, cosine=True),
        given.seeds,
        np.arange(first_held, len(images)),
    )


if __name__ == "__main__":
    main()
