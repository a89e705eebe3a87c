"""How long a frame takes, on this machine, all models in turns so that they share its moods."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from palpate.core.frame import Frame
from palpate.estimators.certified import Estimator
from palpate.recordings.run_reader import Run
from palpate.studies.palm.scale import MODELS
from palpate.studies.palm.workshop import Workshop, ways

ROUNDS, EACH, WARM = 20, 10, 3
THREADS = 2


def latency(shop: Workshop) -> dict[str, Any]:
    """Of each model: onnxruntime alone on one frame, and from camera frame to readings."""
    run = Run.open(shop.folder / "runs" / "new-places")
    table = run.labels
    untouched = run.frame(int(np.flatnonzero(table["reference"].astype(bool))[0])).image
    frame = run.frame(int(np.flatnonzero(~table["reference"].astype(bool))[-1]))
    jobs: dict[tuple[str, str], Callable[[], Any]] = {}
    for model, way in ways(MODELS, shop.scale).items():
        estimator = Estimator.open(shop.calibrated(way), threads=THREADS)
        jobs[model, "network"] = _network(estimator)
        jobs[model, "reading"] = _reading(estimator, frame, untouched)
    taken: dict[tuple[str, str], list[float]] = {job: [] for job in jobs}
    for i in range(ROUNDS):
        for job, run_it in jobs.items():
            taken[job] += _timed(run_it)
        shop.progress("timing", i + 1, ROUNDS)
    return {
        model: {part: _told(taken[model, part]) for part in ("network", "reading")}
        for model in ways(MODELS, shop.scale)
    }


def _network(estimator: Estimator) -> Callable[[], Any]:
    card = estimator.card.input
    image = np.zeros((1, card.channels, *card.size_px), np.float32)
    return lambda: estimator.values(image)


def _reading(estimator: Estimator, frame: Frame, untouched: np.ndarray) -> Callable[[], Any]:
    zero = estimator.zero(untouched) if estimator.card.input.delta else None
    return lambda: estimator.read(frame, zero)


def _timed(job: Callable[[], Any]) -> list[float]:
    for _ in range(WARM):
        job()
    marks = [time.perf_counter()]
    for _ in range(EACH):
        job()
        marks.append(time.perf_counter())
    return [1e3 * (b - a) for a, b in pairwise(marks)]


def _told(ms: list[float]) -> dict[str, float]:
    p50, p95 = np.percentile(ms, [50, 95])
    return {"median_ms": round(float(p50), 3), "p95_ms": round(float(p95), 3)}
