"""Single-frame latency of the compact CNN as `palpate read` runs it, beside torch eager, in one run.

The network's weights are those of one epoch on random images: its speed does not depend on them. Frames
are 445 x 440 px grey, in memory; reading includes the guard, scaling, inference and the intervals.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

FRAMES, ROUNDS = 200, 5


def recorded(folder: Path) -> Path:
    """A run of random blots with two labels."""
    from palpate import Manifest, RunWriter

    rng = np.random.default_rng(0)
    labels = {"x_mm": "number", "y_mm": "number"}
    with RunWriter.create(
        folder / "run", Manifest.new(sensor="noise", labels=labels), overflow="wait"
    ) as writer:
        for _ in range(64):
            image = (rng.random((440, 445)) > 0.7).astype(np.uint8) * 255
            writer.frame(image, labels={"x_mm": rng.normal(), "y_mm": rng.normal()})
    return folder / "run"


def timed(call: Callable[[], object]) -> np.ndarray:
    """Milliseconds of each call, after a few to warm up."""
    for _ in range(10):
        call()
    taken = np.empty(FRAMES)
    for i in range(FRAMES):
        started = time.perf_counter()
        call()
        taken[i] = time.perf_counter() - started
    return 1e3 * taken


def main() -> None:
    try:
        import torch
    except ImportError:
        print("torch is not installed, so there is no baseline: pip install 'palpate[train]'")
        return
    from palpate import CalibrationPlan, Estimator, Run, calibrate
    from palpate.estimators.networks.compact_cnn import CompactCnn, Network
    from palpate.estimators.networks.model_interface import Scaler

    with tempfile.TemporaryDirectory() as folder:
        run = Run.open(recorded(Path(folder)))
        plan = CalibrationPlan(("x_mm", "y_mm"), model="compact-cnn", folds=2, options={"epochs": 1})
        estimator = Estimator.open(calibrate(run, plan, Path(folder, "cal")))
        frame = run.frame(0)
        height, width = estimator.card.input.size_px
    scaler, like = Scaler(np.zeros(2), np.ones(2)), CompactCnn()
    shape = (1, height, width)
    networks = [Network(shape, like.widths, like.hidden, scaler).eval() for _ in range(like.members)]
    batch = torch.zeros(1, *shape)

    def eager() -> None:
        with torch.no_grad():
            for network in networks:
                network(batch)

    load = os.getloadavg()[0]
    print(
        f"compact-cnn, {like.members} members, {height} x {width} px, {FRAMES} frames x {ROUNDS} rounds, "
        f"load {load:.1f}"
    )
    ratios = []
    for _ in range(ROUNDS):
        ours, network, theirs = (
            timed(lambda: estimator.read(frame)),
            timed(lambda: estimator.values(batch.numpy())),
            timed(eager),
        )
        ratios.append(np.median(theirs) / np.median(network))
        print(
            f"  palpate read: median {np.median(ours):.2f} ms, p95 {np.percentile(ours, 95):.2f} ms"
            f" | network alone, onnxruntime: {np.median(network):.2f} ms"
            f" | torch eager: {np.median(theirs):.2f} ms"
        )
    print(f"torch eager / onnxruntime: {np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


if __name__ == "__main__":
    main()
