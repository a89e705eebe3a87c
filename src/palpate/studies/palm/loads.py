"""Contacts that the source has none of: pulled, twisted, leaning, of other shapes, several at once.

Each kind is drawn for itself. The five models, calibrated on one upright ball, read it as it comes: what they
say of the force, and whether they stand by it. Then the study's small network learns from the kind's own
pictures what the source could not: forces and moments that were put in on purpose.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.decomposition import PCA
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from palpate.core.clock import ManualClock
from palpate.estimators.certified import Estimator, Zero
from palpate.estimators.networks.model_interface import Progress
from palpate.recordings.manifest import LabelKind, Manifest
from palpate.recordings.run_reader import Run
from palpate.recordings.run_writer import RunWriter
from palpate.sensors.palm.loads import SHAPES, Loads, draw_loads
from palpate.sensors.palm.spec import PalmSpec
from palpate.studies.palm.headline import small_way
from palpate.studies.palm.scale import MODELS
from palpate.studies.palm.scores import scores_of
from palpate.studies.palm.workshop import Way, Workshop, ways
from palpate.studies.sweep import sweep

BLOCK = 15  # pictures that one process draws at a time
LESSONS: dict[str, tuple[str, ...]] = {
    "lateral": ("force_N", "force_x_N", "force_y_N", "moment_z_Nmm"),
    "inclined": ("force_N", "moment_x_Nmm", "moment_y_Nmm"),
    "grasp": ("force_N", "moment_x_Nmm", "moment_y_Nmm"),
}
"""What is learnt from a kind's own pictures."""
KINDS = ("lateral", "inclined", "shapes", "two-contacts", "grasp")
COMPONENTS = 40


@dataclass(frozen=True, slots=True)
class Block:
    """Some pictures of a kind."""

    spec: PalmSpec
    kind: str
    count: int


def drawn(block: Block, rng: np.random.Generator) -> Loads:
    """One block's pictures."""
    return draw_loads(block.spec, block.kind, block.count, rng)


def record_loads(shop: Workshop, kind: str) -> Run:
    """A kind's pictures as a run: of each contact the untouched skin, and the contact."""
    path = shop.folder / "runs" / f"loads-{kind}"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        counts = np.diff(np.append(np.arange(0, shop.scale.loads, BLOCK), shop.scale.loads)).tolist()
        blocks = [Block(shop.spec, kind, count) for count in counts]
        told = partial(_told, shop.progress, f"drawing {kind}")
        parts = sweep(
            drawn, blocks, seed=shop.seed + KINDS.index(kind), processes=shop.processes, progress=told
        )
        half = path.with_name(f".{path.name}.part")
        shutil.rmtree(half, ignore_errors=True)  # what a try that was stopped has left
        _write(shop, half, kind, parts)
        half.rename(path)
    return Run.open(path)


def _told(progress: Progress, what: str, done: int, total: int) -> None:
    progress(what, done, total)


def _write(shop: Workshop, path: Path, kind: str, parts: list[Loads]) -> None:
    names = parts[0].names
    # A grasp of three has no fourth ball: what not all contacts have is left out.
    kept = [i for i in range(len(names)) if all(np.isfinite(part.values[:, i]).all() for part in parts)]
    labels: dict[str, LabelKind] = {"location": "text", "press": "text", "reference": "flag"}
    labels |= dict.fromkeys([names[i] for i in kept], "number")
    manifest = Manifest.new(
        sensor=f"virtual {shop.spec.name}",
        rig=f"drawn: {kind}",
        licence="CC0-1.0",
        origin="rendered by palpate; virtual, not measured",
        labels=labels,
        regions={"fringes": shop.spec.fringes.box_px, "mirror": shop.spec.mirror.box_px},
        seed=shop.seed,
    )
    clock, count = ManualClock(), 0
    with RunWriter.create(path, manifest, clock=clock, overflow="wait") as writer:
        for part in parts:
            for image, untouched, values in zip(part.images, part.hanging, part.values, strict=True):
                told = {names[i]: float(values[i]) for i in kept}
                who = {"location": f"c{count}", "press": f"c{count}"}
                for picture, reference in ((untouched, True), (image, False)):
                    clock.sleep(1 / 30)
                    writer.frame(picture, labels={**who, "reference": reference, **told})
                count += 1


def loads(shop: Workshop) -> dict[str, Any]:
    """Of each kind: what the five models make of it, and what a network can learn of it."""
    found: dict[str, Any] = {}
    for kind in KINDS:
        run = record_loads(shop, kind)
        found[kind] = {
            "models": {m: _as_it_comes(shop, way, run, kind) for m, way in ways(MODELS, shop.scale).items()},
            "learnt": _learnt(shop, kind),
        }
    found["shapes"]["told apart"] = told_apart(Run.open(shop.folder / "runs" / "loads-shapes"))
    return found


def _as_it_comes(shop: Workshop, way: Way, run: Run, kind: str) -> dict[str, Any]:
    """The whole force as a model reads it, with the untouched skin beside it as the reference."""
    estimator, table = Estimator.open(shop.calibrated(way)), run.labels
    zero: Zero | None = None
    errors, stood = [], []
    for row in range(len(table)):
        if table["reference"].iloc[row]:
            zero = estimator.zero(run.frame(row).image)
            continue
        readings = estimator.read(run.frame(row), zero)
        errors.append(readings["force_N"].value - float(table["force_N"].iloc[row]))
        stood.append(all(reading.valid for reading in readings.values()))
        shop.progress(f"{way.name} on {kind}", row + 1, len(table))
    held = np.abs(np.array(errors)[np.array(stood)])
    return {
        "force_mae_N": float(np.abs(errors).mean()),
        "stood_by": float(np.mean(stood)),
        "force_mae_stood_by_N": float(held.mean()) if len(held) else None,
    }


def _learnt(shop: Workshop, kind: str) -> dict[str, Any]:
    if kind not in LESSONS:
        return {}
    way = small_way(shop, f"small-network-{kind}", run=f"loads-{kind}", targets=LESSONS[kind])
    table = shop.held_out(way)
    spread = {c: float(np.abs(table[c] - table[c].mean()).mean()) for c in LESSONS[kind]}
    return {"targets": scores_of(table, LESSONS[kind]), "spread": spread}


def told_apart(run: Run, seed: int = 0) -> dict[str, Any]:
    """Which of five shapes it was, by a linear classifier of the differences' main components.

    Five folds of contacts; no contact is in two.
    """
    table = run.labels
    pressed = np.flatnonzero(~table["reference"].astype(bool).to_numpy())
    images = np.stack(
        [
            (run.frame(int(i)).image.astype(np.float32) - run.frame(int(i) - 1).image)[::2, ::2].ravel()
            for i in pressed
        ]
    )
    shape = table["shape"].iloc[pressed].to_numpy(int)
    folds = StratifiedKFold(5, shuffle=True, random_state=seed)
    parts = min(COMPONENTS, len(images) // 2)
    model = make_pipeline(PCA(parts, random_state=seed), StandardScaler(), LogisticRegression(max_iter=2000))
    said = cross_val_predict(model, images, shape, cv=folds)
    right = {
        name: float((said[shape == k] == k).mean()) for k, name in enumerate(SHAPES) if (shape == k).any()
    }
    often = float(max((shape == k).mean() for k in range(len(SHAPES))))
    return {"right": float((said == shape).mean()), "of each": right, "commonest": often, "n": len(shape)}
