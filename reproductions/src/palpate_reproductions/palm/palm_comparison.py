"""The networks beside what they have to beat, on places not learnt from: tables 2 and 3, and figures.

What the source leaves open: leakage by grouping, representation against architecture, the mirror.

How long a frame takes, on this machine, all models in turns so that they share its moods.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from palpate.core import Frame
from palpate.estimators.certified import Estimator, read_card
from palpate.estimators.model_card import Card
from palpate.recordings.run_reader import Run
from palpate_reproductions.palm.palm_published import scores_of
from palpate_reproductions.palm.palm_setup import (
    LOCATIONS,
    CalibrationSetup,
    StudyFolder,
    baseline_setup,
    pressed_rows,
)

MAX_POINTS = 400  # of a figure
NEW_PLACES_SEED = 1000  # added to the seed for the places off the grid
WARM = 3  # calls at the start of a round that are not timed


def times_in_turn(
    calls: Sequence[Callable[[], object]], rounds: int, each: int, progress: Callable[[int, int], None]
) -> list[list[float]]:
    """Times of each call [s], so many in each round, so that all see the machine's other work.

    The first calls of a round are not timed.
    """
    seconds: list[list[float]] = [[] for _ in calls]
    for done in range(rounds):
        for call, times in zip(calls, seconds, strict=True):
            for i in range(-WARM, each):
                started = time.perf_counter()
                call()
                if i >= 0:
                    times.append(time.perf_counter() - started)
        progress(done + 1, rounds)
    return seconds


def record_both(study: StudyFolder) -> dict[str, Any]:
    """The protocol at the grid's places, and a campaign of its own at places off the grid."""
    protocol = study.recorded("protocol", study.scale.protocol())
    new = study.recorded("new-places", study.scale.new_places(study.seed), seed=study.seed + NEW_PLACES_SEED)
    return {name: _comparison_text(run) for name, run in (("protocol", protocol), ("new-places", new))}


def _comparison_text(run: Run) -> dict[str, Any]:
    pressed = run.labels.iloc[pressed_rows(run)]
    return {
        "frames": len(pressed),
        "places": int(pressed["location"].nunique()),
        "presses": int(pressed["press"].nunique()),
        "depth_mm": [float(pressed["depth_mm"].min()), float(pressed["depth_mm"].max())],
        "force_N": [float(pressed["force_N"].min()), float(pressed["force_N"].max())],
        "force_sd_N": float(pressed["force_N"].std()),
        "lateral_sd_N": [float(pressed[c].std()) for c in ("force_x_N", "force_y_N")],
        "hash": run.hash,
    }


def headline(study: StudyFolder, model: str) -> dict[str, Any]:
    """One model: its scores on held-out places of the grid and on the campaign off it, and its points."""
    setup = study.setups[model]
    table, card = study.held_out(setup), read_card(study.calibrated(setup))
    new = study.estimated(study.calibrated(setup), study.run("new-places"), "new places")
    columns = setup.columns
    return {
        "calibration": card.id,
        "seconds": card.seconds,
        "rows_learnt": card.split.rows_learnt,
        "options": card.options,
        "training": training_of(card),
        "grid": scores_of(table, columns),
        "new": scores_of(new, columns),
        "new_valid": float(new["valid"].mean()),
        "points": _points(table, columns),
    }


def _points(table: pd.DataFrame, columns: tuple[str, ...]) -> dict[str, list[float]]:
    """Truth and estimate of some frames, spread evenly."""
    rows = np.unique(np.linspace(0, len(table) - 1, min(MAX_POINTS, len(table))).astype(int))
    names = [name for c in columns for name in (c, f"estimate:{c}", f"half_width:{c}")]
    names += [c for c in ("x_mm", "y_mm") if c not in columns]
    return {name: [round(float(v), 5) for v in table[name].iloc[rows]] for name in names}


def one_frame(study: StudyFolder) -> dict[str, Any]:
    """The two-stage network on one held-out frame: what it is told, and what it says (figure 14)."""
    setup = study.setups["palm-two-stage"]
    table = study.held_out(setup)
    errors = (table["estimate:depth_mm"] - table["depth_mm"]).abs()
    typical = int((errors - errors.median()).abs().argmin())
    row = table.iloc[typical]
    columns = ("depth_mm", "x_mm", "y_mm", "force_N")
    run = study.run("protocol")
    pressed = pressed_rows(run)
    return {
        "frame": int(pressed[int(row["row"])]),
        "shot": str(row["shot"]),
        "true": {c: float(row[c]) for c in columns},
        "estimated": {c: float(row[f"estimate:{c}"]) for c in columns},
        "half_width": {c: float(row[f"half_width:{c}"]) for c in columns},
    }


def common_budget(study: StudyFolder) -> list[dict[str, Any]]:
    """Every network once more, all with the same number of steps and a rate that falls as a cosine.

    The MLP, which is scikit-learn's, keeps its rate as it is.
    """
    return [{"model": model, **_kept_on_both(study, setup)} for model, setup in study.common_setups.items()]


GROUPINGS = {
    "(row, column)": "group:location",
    "(row, column, cycle)": "group:location,cycle",
    "row of the table": "random",
}
MIRROR_SIGHTS: dict[str, dict[str, Any]] = {
    "visible": {},
    "out of the mirror": {"probe_in_mirror": False},
    "out of both views": {"probe_in_mirror": False, "probe_edge_on": False},
    "opaque underside": {"opaque_underside": True},
}
"""How the probe is seen: through the membrane, not at all with the skin's dimple left, or nothing below."""
CONTROLS = ("palm-moments", "kernel-ridge")
"""Models of recorded presses alone that no network of recorded presses alone is ahead of."""
NETWORK_ALONE = "palm-compact-network"


def network_setup(study: StudyFolder, tag: str = "", **changes: Any) -> CalibrationSetup:
    """palm-compact's network alone, which tells the place too: where it is trained many times over."""
    options = {
        **study.scale.common.get("palm-compact", {}), "steps": study.scale.control_steps, "moments": False,
    }  # fmt: skip
    return CalibrationSetup(f"{NETWORK_ALONE}{tag}", "palm-compact", **{"options": options, **changes})


def leakage(study: StudyFolder) -> list[dict[str, Any]]:
    """The same models on the same frames, held out by place, by place and cycle, and by row of the table."""
    results = []
    for grouping, split in GROUPINGS.items():
        tag = "" if split == LOCATIONS else f"-by-{split.partition(':')[2].replace(',', '-') or split}"
        setups = {m: baseline_setup(m, f"{m}{tag}", split=split) for m in CONTROLS}
        setups[NETWORK_ALONE] = network_setup(study, tag, split=split)
        for model, setup in setups.items():
            results.append({"grouping": grouping, "model": model, **_kept_on_both(study, setup)})
    return results


def factorial(study: StudyFolder) -> list[dict[str, Any]]:
    """Colour and difference, each with and without, in one architecture."""
    results = []
    for colour, channels in (("RGB", 3), ("grey", 1)):
        for seen, delta in (("raw", False), ("delta", True)):
            tag = "" if (colour, seen) == ("RGB", "delta") else f"-{colour.lower()}-{seen}"
            setup = network_setup(study, tag, channels=channels, delta=delta)
            results.append({"colour": colour, "seen": seen, **_kept_on_both(study, setup)})
    return results


def mirror(study: StudyFolder) -> list[dict[str, Any]]:
    """Models without a network, learning and tested with the probe in sight, out of sight, nothing in sight.

    Each setup of seeing is learnt from and tested on all of them: a model that was taught with the probe in
    sight, and is tested without, tells what it had relied on; one taught without tells what is left.
    """
    runs = {}
    for name, fields in MIRROR_SIGHTS.items():
        spec, tag = replace(study.spec, **fields), name.replace(" ", "-")
        if fields:
            study.recorded(f"protocol-{tag}", study.scale.protocol(), spec=spec)
            plan = study.scale.new_places(study.seed)
            study.recorded(f"new-places-{tag}", plan, spec=spec, seed=study.seed + NEW_PLACES_SEED)
        runs[name] = f"-{tag}" if fields else ""
    results = []
    for model in CONTROLS:
        for taught, tag in runs.items():
            setup = baseline_setup(model, f"{model}{tag}", run=f"protocol{tag}")
            for tested, other in runs.items():

                def scored(setup: CalibrationSetup = setup, other: str = other) -> dict[str, Any]:
                    run = study.run(f"new-places{other}")
                    return study.scored(study.calibrated(setup), run, f"new places{other}")

                scores = study.kept_part("mirror", (model, taught, tested), scored)
                results.append({"model": model, "taught": taught, "tested": tested, **scores})
    return results


def _kept_on_both(study: StudyFolder, setup: CalibrationSetup) -> dict[str, Any]:
    """Scores on both, of this very setup made once, whichever stages ask for it."""
    found: dict[str, Any] = study.kept_part("setup", (setup.name,), partial(_on_both, study, setup))
    return found


def _on_both(study: StudyFolder, setup: CalibrationSetup) -> dict[str, Any]:
    """Scores on held-out rows, and on places off the grid, which no split has touched."""
    card = read_card(study.calibrated(setup))
    new = study.scored(study.calibrated(setup), study.run("new-places"), "new places")
    return {
        "held_out": scores_of(study.held_out(setup), setup.columns),
        "new": new["targets"],
        "clean": card.split.clean,
        "audit": card.split.audit_text,
        "training": training_of(card),
        "seconds": card.seconds,
    }


def training_of(card: Card) -> dict[str, Any] | None:
    """How long a network has learnt; None for what learns without steps."""
    return None if card.training is None else card.training.model_dump()


ROUNDS, EACH = 20, 10
THREADS = 2


def latency(study: StudyFolder) -> dict[str, Any]:
    """Times of each model: onnxruntime alone on one frame, and from camera frame to readings."""
    run = study.run("new-places")
    untouched = run.frame(int(np.flatnonzero(run.labels["reference"].astype(bool))[0])).image
    frame = run.frame(int(pressed_rows(run)[-1]))
    jobs: dict[tuple[str, str], Callable[[], Any]] = {}
    for model, setup in study.sensing_setups.items():
        estimator = Estimator.open(study.calibrated(setup), threads=THREADS)
        jobs[model, "network"] = _network(estimator)
        jobs[model, "reading"] = _reading(estimator, frame, untouched)
    times = times_in_turn(list(jobs.values()), ROUNDS, EACH, partial(study.progress, "timing"))
    results: dict[str, Any] = {model: {} for model in study.sensing_setups}
    for (model, part), seconds in zip(jobs, times, strict=True):
        p50, p95 = (round(1e3 * float(p), 3) for p in np.percentile(seconds, [50, 95]))
        results[model][part] = {"median_ms": p50, "p95_ms": p95}
    return results


def _network(estimator: Estimator) -> Callable[[], Any]:
    card = estimator.card.input
    image = np.zeros((1, card.channels, *card.size_px), np.float32)
    return lambda: estimator.values(image)


def _reading(estimator: Estimator, frame: Frame, untouched: np.ndarray) -> Callable[[], Any]:
    zero = estimator.zero(untouched) if estimator.card.input.delta else None
    return lambda: estimator.read(frame, zero)
