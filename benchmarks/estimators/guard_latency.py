"""The guard's part of a reading, beside the whole reading and the guard that compares thumbnails alone.

Run ``OMP_NUM_THREADS=1 python benchmarks/estimators/guard_latency.py``. Frames are 445 x 440 px grey, in
memory; discs on a grid move with two labels. Calibrations are of `kernel-ridge` at 128 px a side and of
`pca-ridge` at 224, the side of `compact-cnn`, each of 400 frames. A whole reading is scaling, guard, model
and intervals. Before anything is timed, sizes of differences among the guard's features must be those of
numpy. No time is judged, only printed.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from palpate import CalibrationPlan, Estimator, Manifest, Run, RunWriter, calibrate
from palpate.estimators.guard import NoveltyDetector, frame_features, image_features, thumbnail

FRAMES, CALLS, ROUNDS = 400, 200, 5
HEIGHT, WIDTH = 440, 445
MODELS = {"kernel-ridge": 128, "pca-ridge": 224}


def recorded(folder: Path) -> Run:
    """A run of discs on a grid that a press pushes apart, with two labels."""
    rng = np.random.default_rng(0)
    labels = {"x_mm": "number", "depth_mm": "number"}
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    with RunWriter.create(folder, Manifest.new(sensor="discs", labels=labels), overflow="wait") as writer:
        for _ in range(FRAMES):
            at, depth = rng.uniform(-1, 1), rng.uniform(0, 1)
            push = 8 * depth * np.exp(-((x - 222 - 100 * at) ** 2 + (y - 220) ** 2) / 9000)
            away = np.hypot((x + push) % 24 - 12, (y + push) % 24 - 12)
            image = np.clip(255 * (6 - away) + rng.normal(0, 3, y.shape), 0, 255).astype(np.uint8)
            writer.frame(image, labels={"x_mm": at, "depth_mm": depth})
    return Run.open(folder)


def check(prepared: np.ndarray) -> None:
    """Sizes of differences between neighbours along rows and columns, as numpy gives them."""
    grey = prepared[..., 0].astype(float)
    found = image_features(prepared)
    for at, axis in ((0, 1), (2, 0)):
        plain = np.diff(grey, axis=axis)
        sizes = np.log(np.array([np.abs(plain).mean(), np.sqrt(np.mean(plain**2))]) + 0.02)
        np.testing.assert_allclose(found[at : at + 2], sizes, atol=1e-9)


def taken_ms(call: Callable[[], object]) -> float:
    """Median milliseconds of a call, after a few to warm up."""
    for _ in range(10):
        call()
    taken = np.empty(CALLS)
    for i in range(CALLS):
        started = time.perf_counter()
        call()
        taken[i] = time.perf_counter() - started
    return float(1e3 * np.median(taken))


def measured(estimator: Estimator, frame: np.ndarray) -> np.ndarray:
    """Rows of parts, columns of rounds [ms]."""
    guard = NoveltyDetector.load(estimator.folder / "guard.npz")
    changes = guard.changes
    assert changes is not None
    former = replace(guard, changes=None)
    prepare = estimator.card.input.preparation.apply
    prepared = prepare(frame)
    check(prepared)
    thumb = thumbnail(prepared)
    features = frame_features(prepared, thumb, changes.registration)
    calls = (
        lambda: estimator.read(frame),
        lambda: prepare(frame),
        lambda: guard.judge(prepared),
        lambda: former.judge(prepared),
        lambda: frame_features(prepared, thumb, changes.registration),
        lambda: changes.judge(features, 0.5),
    )
    return np.array([[taken_ms(call) for call in calls] for _ in range(ROUNDS)]).T


def main() -> None:
    cv2.setNumThreads(1)
    names = (
        "whole reading",
        "  scaling",
        "  guard",
        "    thumbnails alone",
        "    features",
        "    known changes",
    )
    with tempfile.TemporaryDirectory() as folder:
        run = recorded(Path(folder, "run"))
        frame = run.frame(7).image
        for model, side in MODELS.items():
            plan = CalibrationPlan(("x_mm", "depth_mm"), model, size_px=(side, side))
            estimator = Estimator.open(calibrate(run, plan, Path(folder, model)), threads=1)
            found = measured(estimator, frame)
            print(
                f"{model}, {WIDTH} x {HEIGHT} px to {side} a side, {CALLS} calls x {ROUNDS} rounds, "
                f"load {os.getloadavg()[0]:.1f} [ms, median and range of rounds]"
            )
            for name, each in zip(names, found, strict=True):
                print(f"{name:22s} {np.median(each):5.2f}  ({each.min():.2f} to {each.max():.2f})")
            print(f"guard / whole reading: {np.median(found[2] / found[0]):.2f}")


if __name__ == "__main__":
    main()
