"""Conditions that no model has learnt from, recorded on the virtual rig, and what becomes of the scores.

A user's own copy of the palm: what a calibration is worth on it as it is, and after a few presses.

Contacts that the source has none of: pulled, twisted, leaning, of other shapes, several at once.

Each kind is drawn for itself. The models, calibrated on one upright ball, read it as it comes: what they say
of the force, and whether they stand by it. Then a kernel ridge learns from the kind's own pictures what the
source could not: forces and moments that were put in on purpose.

Whether a calibration stands by the frames that it should, and by no others.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from sklearn.decomposition import PCA
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from palpate.calibration.adaptation import adapt
from palpate.calibration.coverage.grouped_rates import coverage_interval
from palpate.calibration.evaluation import zeros_of
from palpate.core import ManualClock
from palpate.core.provenance import Provenance
from palpate.estimators.certified import Estimator
from palpate.recordings import Manifest, Run, RunWriter
from palpate.recordings.label_tables import own_column
from palpate.recordings.manifest import LabelKind
from palpate.rig.plans import Dwell, Listed, StepHold
from palpate.rig.virtual.disturbances import Variation
from palpate.sensors.palm import PalmSpec
from palpate.sensors.palm.membrane_faults import Wear, worn
from palpate.sensors.palm.random_presses import SHAPES, Loads, draw_loads
from palpate.workflows.parameter_sweep import sweep
from palpate_reproductions.palm.palm_comparison import NEW_PLACES_SEED
from palpate_reproductions.palm.palm_published import scores_of
from palpate_reproductions.palm.palm_setup import (
    CalibrationSetup,
    Scale,
    StudyFolder,
    baseline_setup,
    noisier,
    pressed_rows,
)

RING_MM = 23.0
NOISES = (0.5, 1.0, 2.0, 4.0)
PRESSES = (100.0, 1000.0, 3000.0, 10_000.0, 30_000.0)

Change = Callable[[PalmSpec], tuple[PalmSpec, Variation]]


def only(**fields: Any) -> Change:
    """The palm with some fields changed, and the rig's usual variation."""
    return lambda spec: (replace(spec, **fields), Variation())


def _stiffer(by: float) -> Change:
    return lambda spec: (replace(spec, youngs_modulus_pa=by * spec.youngs_modulus_pa), Variation())


def _more_birefringent(by: float) -> Change:
    def change(spec: PalmSpec) -> tuple[PalmSpec, Variation]:
        law = replace(spec.stress_optic, coefficient_per_pa=by * spec.stress_optic.coefficient_per_pa)
        return replace(spec, stress_optic=law), Variation()

    return change


@dataclass(frozen=True, slots=True)
class PalmCondition:
    """Something that differs from the calibration.

    Attributes:
        change: of the palm and of what varies.
        where: "off" the grid, at the grid's "own" places, or "beyond" them.
    """

    name: str
    said: str
    change: Change = field(default_factory=only)
    campaign: int = NEW_PLACES_SEED
    where: Literal["off", "own", "beyond"] = "off"


CONDITIONS: tuple[PalmCondition, ...] = (
    PalmCondition("unchanged", "as calibrated"),
    PalmCondition("again", "the grid's own places, in cycles not seen", campaign=2000, where="own"),
    PalmCondition("beyond", "places beyond the grid, 23 mm from the middle", where="beyond"),
    PalmCondition("stiffer", "E 15 % higher", _stiffer(1.15)),
    PalmCondition("softer", "E 15 % lower", _stiffer(0.85)),
    PalmCondition("higher-c", "C 15 % higher", _more_birefringent(1.15)),
    PalmCondition("lower-c", "C 15 % lower", _more_birefringent(0.85)),
    PalmCondition("brighter", "the lamp 5 % brighter", only(lamp_gain=1.05)),
    PalmCondition("dimmer", "the lamp 20 % dimmer", only(lamp_gain=0.8)),
    PalmCondition("warmer", "the lamp warmer by 30 mired", only(lamp_mired=30.0)),
    PalmCondition("room-light", "room light of 5 % of the lamp's", only(ambient=0.05)),
    PalmCondition("hazy", "a membrane with 10 % haze", only(wear=Wear(haze=0.1))),
    PalmCondition("scratched", "a membrane with 8 scratches", only(wear=Wear(scratches=8))),
    PalmCondition(
        "yellowed", "a yellowed membrane (absorbance 0.1 at 450 nm)", only(wear=Wear(yellowing=0.1))
    ),
    PalmCondition("no-mirror-probe", "the probe out of the mirror's sight", only(probe_in_mirror=False)),
    PalmCondition(
        "no-probe", "the probe out of sight in both views", only(probe_in_mirror=False, probe_edge_on=False)
    ),
    PalmCondition("opaque", "an opaque underside", only(opaque_underside=True)),
)


def conditions(study: StudyFolder) -> dict[str, Any]:
    """Scores of the models studied under each condition."""
    return {one.name: {"said": one.said, "models": _models(study, one)} for one in CONDITIONS}


def noise(study: StudyFolder) -> list[dict[str, Any]]:
    """Every model, taught at the rig's own noise, on places off the grid at so many times that noise."""

    def one(times: float) -> PalmCondition:
        return PalmCondition(f"noise-{times:g}", f"{times:g} times the noise", partial(noisier, times=times))

    return [{"times": times, "models": _models(study, one(times))} for times in NOISES]


def durability(study: StudyFolder) -> list[dict[str, Any]]:
    """Every model on a membrane that has been pressed so often, by the law of wear that is assumed."""

    def one(n: float) -> PalmCondition:
        return PalmCondition(f"pressed-{n:g}", f"after {n:g} presses", only(wear=worn(n)))

    return [{"presses": presses, "models": _models(study, one(presses))} for presses in PRESSES]


def record_condition(study: StudyFolder, one: PalmCondition) -> Run:
    """A condition's recording."""
    spec, variation = one.change(study.spec)
    plan = _plan(study.scale, study.seed, one)
    return study.recorded(one.name, plan, spec, variation, study.seed + one.campaign)


def _models(study: StudyFolder, one: PalmCondition) -> dict[str, Any]:
    recorded = cache(partial(record_condition, study, one))

    def scored(setup: CalibrationSetup) -> dict[str, Any]:
        return study.scored(study.calibrated(setup), recorded(), one.said)

    return {
        model: study.kept_part("condition", (one.name, model), partial(scored, setup))
        for model, setup in study.studied_setups.items()
    }


def _plan(scale: Scale, seed: int, one: PalmCondition) -> StepHold:
    plan = scale.new_places(seed, coarse=True)
    if one.where == "own":
        return plan.model_copy(update={"places": scale.protocol().places})
    if one.where == "beyond":
        return plan.model_copy(update={"places": Listed(kind="listed", at_mm=_ring(scale.places // 2))})
    return plan


def _ring(count: int) -> tuple[tuple[float, float], ...]:
    angles = [math.tau * (i + 0.5) / count for i in range(count)]
    return tuple((round(RING_MM * math.cos(a), 3), round(RING_MM * math.sin(a), 3)) for a in angles)


def sustained(study: StudyFolder, seconds: float = 60.0) -> dict[str, Any]:
    """One press held: what every model says of depth and force while the skin relaxes."""
    plan = StepHold(
        name="palm-sustained",
        places=Listed(kind="listed", at_mm=((3.0, -4.0),)),
        cycles=1,
        frames=1,
        reference_frames=1,
        depth_mm=4.0,
        step_mm=1.0,
        dwell=Dwell(depths_mm=(4.0,), seconds=seconds, frames=60),
    )
    run = study.recorded("sustained", plan, seed=study.seed + 3000)
    return {"seconds": seconds, "models": _held(study, run)}


def _held(study: StudyFolder, run: Run) -> dict[str, Any]:
    results: dict[str, Any] = {}
    for model, setup in study.studied_setups.items():
        table = study.estimated(study.calibrated(setup), run, "a press held")
        held = table[table["phase"] == "hold"]
        names = [c for c in ("depth_mm", "force_N") if f"estimate:{c}" in held]
        results[model] = {
            name: [round(float(v), 5) for v in held[name]] for c in names for name in (c, f"estimate:{c}")
        }
    return results


COPIED = ("palm-moments", "palm-compact")
ADAPTATION_PRESSES = (10, 20, 50)  # presses
COPY = 4000  # added to the seed for all that is recorded of the copy

STIFFER, DIMMER, WARMER_MIRED = 1.15, 0.9, 15.0
"""How the copy differs: silicone of another batch, and a lamp of another."""


def copy_of(spec: PalmSpec) -> PalmSpec:
    """Another palm of the same make."""
    return replace(
        spec,
        youngs_modulus_pa=STIFFER * spec.youngs_modulus_pa,
        lamp_gain=DIMMER * spec.lamp_gain,
        lamp_mired=WARMER_MIRED,
    )


def adaptation(study: StudyFolder) -> list[dict[str, Any]]:
    """Scores on the copy after no, 10, 20 and 50 presses of it; "0" has the copy's own untouched frame."""
    spec, seed = copy_of(study.spec), study.seed + COPY
    plan = study.scale.new_places(study.seed, coarse=True)

    def scored(setup: CalibrationSetup, presses: int) -> dict[str, Any]:
        test = study.recorded("copy", plan, spec, seed=seed)
        out = study.calibrated(setup)
        if presses:
            run = study.recorded(f"copy-{presses}", _lesson(study.scale, presses), spec, seed=seed)
            before, out = out, study.folder / "calibrations" / f"{setup.name}-copy-{presses}"
            if not out.exists():
                adapt(before, run, out, study.progress)
        return study.scored(out, test, "a copy")

    return [
        {
            "model": model,
            "presses": presses,
            **study.kept_part("copy", (model, str(presses)), partial(scored, study.setups[model], presses)),
        }
        for model in COPIED
        for presses in (0, *ADAPTATION_PRESSES)
    ]


def _lesson(scale: Scale, presses: int) -> StepHold:
    """Presses at places of their own."""
    plan = scale.new_places(1000 + presses, coarse=True)
    places = plan.places.model_copy(update={"count": presses})
    return plan.model_copy(update={"name": f"palm-lesson-{presses}", "places": places})


BLOCK = 15  # contacts that one process draws at a time
LOAD_PRESSES: dict[str, tuple[str, ...]] = {
    "lateral": ("force_N", "force_x_N", "force_y_N", "moment_z_Nmm"),
    "inclined": ("force_N", "moment_x_Nmm", "moment_y_Nmm"),
    "grasp": ("force_N", "moment_x_Nmm", "moment_y_Nmm"),
}
"""What is learnt from a kind's own pictures."""
KINDS = ("lateral", "inclined", "shapes", "two-contacts", "grasp")
COMPONENTS = 40


def record_loads(study: StudyFolder, kind: str) -> Run:
    """A kind's pictures as a run: of each contact the untouched skin, and the contact."""
    path = study.folder / "runs" / f"loads-{kind}"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        counts = np.diff(np.append(np.arange(0, study.scale.loads, BLOCK), study.scale.loads)).tolist()
        parts = sweep(
            partial(draw_loads, study.spec, kind),
            counts,
            seed=study.seed + KINDS.index(kind),
            processes=study.processes,
            progress=partial(study.progress, f"drawing {kind}"),
        )
        half = path.with_name(f".{path.name}.part")
        shutil.rmtree(half, ignore_errors=True)  # what a try that was stopped has left
        _write(study, half, kind, parts)
        half.rename(path)
    return Run.open(path)


def _write(study: StudyFolder, path: Path, kind: str, parts: list[Loads]) -> None:
    names = parts[0].names
    # A grasp of three has no fourth ball: what not all contacts have is left out.
    kept = [i for i in range(len(names)) if all(np.isfinite(part.values[:, i]).all() for part in parts)]
    labels: dict[str, LabelKind] = {"location": "text", "press": "text", "reference": "flag"}
    labels |= dict.fromkeys([names[i] for i in kept], "number")
    manifest = Manifest.new(
        sensor=f"virtual {study.spec.name}",
        rig=f"drawn: {kind}",
        licence="CC0-1.0",
        origin="rendered by palpate",
        provenance=Provenance.SIMULATED,
        labels=labels,
        regions={"fringes": study.spec.fringes.box_px, "mirror": study.spec.mirror.box_px},
        seed=study.seed,
    )
    clock, count = ManualClock(), 0
    with RunWriter.create(path, manifest, clock=clock, overflow="wait") as writer:
        for part in parts:
            for image, untouched, values in zip(part.images, part.hanging, part.values, strict=True):
                numbers = {names[i]: float(values[i]) for i in kept}
                who = {"location": f"c{count}", "press": f"c{count}"}
                for picture, reference in ((untouched, True), (image, False)):
                    clock.sleep(1 / 30)
                    writer.frame(picture, labels={**who, "reference": reference, **numbers})
                count += 1


def loads(study: StudyFolder) -> dict[str, Any]:
    """Results of each kind: what the models make of it, and what a kernel ridge can learn of it."""
    results: dict[str, Any] = {}
    for kind in KINDS:
        results[kind] = {
            "models": {
                model: study.kept_part("loads", (kind, model), partial(_as_it_comes, study, setup, kind))
                for model, setup in study.studied_setups.items()
            },
            "learnt": study.kept_part("loads", (kind, "learnt"), partial(_learnt, study, kind)),
        }
    results["shapes"]["told apart"] = shape_classification(study.run("loads-shapes"))
    return results


def _as_it_comes(study: StudyFolder, setup: CalibrationSetup, kind: str) -> dict[str, Any]:
    """The whole force as a model reads it, with the untouched skin beside it as the reference."""
    table = study.estimated(study.calibrated(setup), record_loads(study, kind), kind)
    errors = (table["estimate:force_N"] - table["force_N"]).abs().to_numpy()
    valid = table["valid"].to_numpy(bool)
    return {
        "force_mae_N": float(errors.mean()),
        "stood_by": float(valid.mean()),
        "force_mae_stood_by_N": float(errors[valid].mean()) if valid.any() else None,
    }


def _learnt(study: StudyFolder, kind: str) -> dict[str, Any]:
    if kind not in LOAD_PRESSES:
        return {}
    record_loads(study, kind)
    name = f"kernel-ridge-{kind}"
    setup = baseline_setup("kernel-ridge", name, run=f"loads-{kind}", targets=LOAD_PRESSES[kind])
    table = study.held_out(setup)
    spread = {c: float(np.abs(table[c] - table[c].mean()).mean()) for c in LOAD_PRESSES[kind]}
    return {"targets": scores_of(table, LOAD_PRESSES[kind]), "spread": spread}


def shape_classification(run: Run, seed: int = 0) -> dict[str, Any]:
    """Which of five shapes it was, by a linear classifier of the differences' main components.

    Five folds of contacts; no contact is in two.
    """
    table = run.labels
    pressed = pressed_rows(run)
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


FOREIGN: tuple[PalmCondition, ...] = (
    PalmCondition("lamp-dim", "the lamp 30 % dimmer", only(lamp_gain=0.7)),
    PalmCondition("lamp-bright", "the lamp 30 % brighter", only(lamp_gain=1.3)),
    PalmCondition("lamp-warm", "the lamp warmer by 60 mired", only(lamp_mired=60.0)),
    PalmCondition("lamp-cold", "the lamp colder by 60 mired", only(lamp_mired=-60.0)),
    PalmCondition("room-bright", "room light of 20 % of the lamp's", only(ambient=0.2)),
    PalmCondition("no-membrane", "no membrane", only(membrane=False)),
)


SEVERAL = {"two-contacts": "two contacts at once", "grasp": "three or four contacts at once"}


def validity(study: StudyFolder) -> list[dict[str, Any]]:
    """Shares of frames that each calibration says are not of its kind, or out of its range.

    Beside them the force's error: what is not flagged may do no harm.
    """
    frames: dict[tuple[str, str], Callable[[], Run]] = {
        ("new-places", "places off the grid"): partial(study.run, "new-places")
    }
    frames |= {(kind, said): partial(record_loads, study, kind) for kind, said in SEVERAL.items()}
    frames |= {(one.name, one.said): partial(record_condition, study, one) for one in FOREIGN}
    good = {"held-out", "new-places"}

    def rate(name: str, setup: CalibrationSetup) -> dict[str, float | None]:
        if name == "held-out":
            return {**_rate(_held_out(study, setup))}
        table = study.estimated(study.calibrated(setup), runs[name](), name)
        errors_n = (table["estimate:force_N"] - table["force_N"]).abs()
        error_n = None if errors_n.isna().all() else float(errors_n.mean())
        return {**_rate(~table["valid"].to_numpy(bool)), "force_mae_N": error_n}

    runs = {name: cache(run) for (name, _), run in frames.items()}
    return [
        {
            "said": said,
            "good": name in good,
            "models": {
                model: study.kept_part("validity", (name, model), partial(rate, name, setup))
                for model, setup in study.studied_setups.items()
            },
        }
        for name, said in (("held-out", "held-out places of the grid"), *frames)
    ]


def _rate(flagged: np.ndarray) -> dict[str, float]:
    low, high = coverage_interval(int(flagged.sum()), len(flagged))
    return {"flagged": float(flagged.mean()), "low": low, "high": high, "n": len(flagged)}


def _held_out(study: StudyFolder, setup: CalibrationSetup) -> np.ndarray:
    """Flags of the rows that the calibration was scored by, each with its own press's untouched frame."""
    estimator = Estimator.open(study.calibrated(setup))
    run = study.run(setup.run)
    pressed, zeros = pressed_rows(run), zeros_of(estimator, run)
    held_out = pressed[own_column(study.held_out(setup), "row").to_numpy(int)].tolist()
    readings = (estimator.read(run.frame(row), zeros[row]) for row in held_out)
    return np.array([not all(one.valid for one in each.values()) for each in readings])
