"""From a run and a plan to a certificate: pack, split, audit, fit, hold out, certify.

Work is kept in a folder beside the result (`.NAME.work`) until it is whole. Interrupted, the same command
goes on from there: the packed set, every finished fold and a network's last epoch are kept.

Of several processes that torchrun began, the first does all this, and the others help it to train.
"""

from __future__ import annotations

import json
import math
import shutil
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.certificate import Calibrated, write_certificate
from palpate.calibration.leakage import audit
from palpate.calibration.model_check import check_plugged_in
from palpate.calibration.training_data import (
    Untouched,
    find_untouched,
    prepared_images,
    rows_to_learn,
    training_data,
)
from palpate.core import (
    ExistsError,
    Indices,
    InputError,
    PathText,
    Values,
    new_file,
    refuse_existing,
    storage_errors,
)
from palpate.estimators.networks import make_model, model_kind
from palpate.estimators.networks.distributed import ProcessGroup
from palpate.estimators.networks.model_interface import (
    Fitted,
    Model,
    Progress,
    TrainingData,
    predict_rows,
    silent,
)
from palpate.estimators.novelty import LearnsFromRendered, NoveltyDetector, fit_novelty_detector, thumbnails
from palpate.recordings.labels import refuse_reserved, targets_from
from palpate.recordings.packed_set import PackedSet, pack
from palpate.recordings.preparation import Preparation
from palpate.recordings.run_reader import Run
from palpate.recordings.splits import Split, split


def calibrate(run: Run, plan: CalibrationPlan, out: PathText, progress: Progress = silent) -> Path:
    """Calibrate an estimator and write its certificate.

    Rows are predicted by a model that has not seen their group; the scores, the intervals and the report
    come from those predictions. The model that is kept has learnt from every row, or, where it is costly
    and one fold gives scores enough, from all but that fold.

    Args:
        run: frames and their labels.
        plan: what to estimate and how.
        out: the calibration folder to make; must not exist.
        progress: told what is being done and how far it is.

    Returns:
        `out`.

    Raises:
        ExistsError: `out` exists, or work towards another plan lies beside it.
        LabelError, UnitError, SplitError, InputError: the plan does not fit the run.
    """
    out = Path(out)
    refuse_existing(out)
    started = time.monotonic()
    _check_plan(run, plan)
    crew = _crew(plan)
    if not crew.first:
        _help(run, plan, _work_path(out), crew)
        return out
    work = _work_folder(run, plan, out)
    with storage_errors(work):
        made = _made(run, plan, work, progress, crew)
        write_certificate(replace(made, seconds=time.monotonic() - started), out)
        crew.wait()
        shutil.rmtree(work)
    return out


def _crew(plan: CalibrationPlan) -> ProcessGroup:
    """The processes that shall train together.

    Raises:
        InputError: there are several, and the model is none that they can share.
    """
    crew = ProcessGroup.of_environment()
    if crew.size > 1 and not hasattr(make_model(plan.model, plan.options), "descent"):
        raise InputError(
            f"{crew.size} processes, and {plan.model} trains in one; run palpate without torchrun, or take "
            "one of the palm's networks that are trained with torch"
        )
    return crew


def _help(run: Run, plan: CalibrationPlan, work: Path, crew: ProcessGroup) -> None:
    """Train along with the first process, from the set that it packs, and write nothing."""
    ready = _ready(run, plan, work, silent, crew)
    _learnt(make_model(plan.model, plan.options), ready, plan, work, silent, crew)
    crew.wait()


@dataclass(frozen=True, slots=True)
class _Ready:
    """What there is before anything is learnt: all rows packed, and those to learn from, split."""

    whole: PackedSet
    rows: Indices
    untouched: Untouched
    packed: PackedSet
    parts: Split
    data: TrainingData


def _ready(run: Run, plan: CalibrationPlan, work: Path, progress: Progress, crew: ProcessGroup) -> _Ready:
    whole = _packed(run, plan, work, progress, crew)
    untouched = find_untouched(whole, plan)
    rows = rows_to_learn(whole.table, plan)
    packed = whole.only(rows)
    parts = split(packed.table, plan.split, folds=_folds(plan), seed=plan.seed)
    groups = parts.groups if parts.groups is not None else np.arange(len(packed))
    data = training_data(packed, plan, groups, untouched.of(rows), str(run.path))
    return _Ready(whole, rows, untouched, packed, parts, data)


def _made(run: Run, plan: CalibrationPlan, work: Path, progress: Progress, crew: ProcessGroup) -> Calibrated:
    ready = _ready(run, plan, work, progress, crew)
    model = make_model(plan.model, plan.options)
    held_out, fitted = _learnt(model, ready, plan, work, progress, crew)
    return Calibrated(
        run=run,
        plan=plan,
        packed=ready.packed,
        data=ready.data,
        split=ready.parts,
        audit=audit(ready.packed, ready.parts),
        untouched=ready.untouched,
        held_out=held_out,
        fitted=fitted,
        guard=_guard(ready, fitted, plan, progress),
    )


def _check_plan(run: Run, plan: CalibrationPlan) -> None:
    """Refuse at once what would fail after an hour."""
    if len(run) < 10:
        raise InputError(f"{run.path} holds {len(run)} frames; a calibration needs 10 or more")
    refuse_reserved(list(run.manifest.labels), str(run.path))
    make_model(plan.model, plan.options)
    prepared = preparation_of(run, plan).apply(run.frame(0).image)
    table = run.labels.iloc[rows_to_learn(run.labels, plan)].reset_index(drop=True)
    targets_from(table, plan.targets, str(run.path))
    split(table, plan.split, folds=_folds(plan), seed=plan.seed)
    check_plugged_in(plan, prepared.transpose(2, 0, 1).shape)


def preparation_of(run: Run, plan: CalibrationPlan) -> Preparation:
    """The preparation a plan asks for.

    Where it names no size, the input has as many pixels as the model's own square one, in the frame's
    (or the crop's) proportions; with two crops, each has as many, and is square.
    """
    if plan.size_px is not None:
        return Preparation(plan.crop_px, plan.size_px, plan.channels, plan.beside_px)
    side = model_kind(plan.model).side_px
    if plan.beside_px is not None:
        return Preparation(plan.crop_px, (side, 2 * side), plan.channels, plan.beside_px)
    height, width = plan.crop_px[:1:-1] if plan.crop_px else run.frame(0).image.shape[:2]
    tall = math.sqrt(height / width)
    return Preparation(plan.crop_px, (round(side * tall), round(side / tall)), plan.channels)


def _work_folder(run: Run, plan: CalibrationPlan, out: Path) -> Path:
    """The folder of unfinished work towards this very plan, made or found again."""
    work = _work_path(out)
    wanted = json.dumps({"run": run.hash, "plan": plan.to_dict()}, sort_keys=True)
    note = work / "plan.json"
    if note.is_file():
        if note.read_text() != wanted:
            raise ExistsError(
                f"{work} holds unfinished work towards another calibration named {out.name}; "
                "run that one again to finish it, remove the folder, or choose another --out"
            )
        return work
    with storage_errors(work):
        if work.exists():
            shutil.rmtree(work)
        work.mkdir(parents=True)
    with new_file(note) as path:
        path.write_text(wanted)
    return work


def _work_path(out: Path) -> Path:
    return out.with_name(f".{out.name}.work")


def _packed(run: Run, plan: CalibrationPlan, work: Path, progress: Progress, crew: ProcessGroup) -> PackedSet:
    folder = work / "packed"
    if crew.first and not folder.exists():
        made = preparation_of(run, plan)
        pack(run, folder, made, progress=lambda done, total: progress("packing", done, total))
    crew.wait()
    return PackedSet.open(folder)


def _learnt(
    model: Model, ready: _Ready, plan: CalibrationPlan, work: Path, progress: Progress, crew: ProcessGroup
) -> tuple[Values, Fitted]:
    """Predictions of rows by a model that has not seen their fold (NaN where none was), and what is kept.

    Where every fold is held out in turn, what is kept has learnt from all rows. Where one is, what is kept
    is the very model that was scored.
    """
    data, parts = ready.data, ready.parts
    predicted = np.full_like(data.values, np.nan)
    count, alone = folds_to_score(plan, parts), most_like_the_rest(parts, data.values)
    if count > 1:
        for k in range(count):
            predicted[parts.folds[k]] = _fold(model, ready, plan, k, work, progress, crew)
    fitted = model.fit(
        data,
        np.arange(len(data.values)) if count > 1 else parts.training_rows(alone),
        seed=plan.seed,
        progress=_named(progress, "the model that is kept"),
        checkpoint=work / "kept.npz",
    )
    if count == 1:
        predicted[parts.folds[alone]] = predict_rows(fitted, data, parts.folds[alone])
    return predicted, fitted


def most_like_the_rest(parts: Split, values: Values) -> int:
    """The fold whose targets are spread most like all rows': one fold stands for all, so chance is held low.

    It is chosen by the labels alone, before anything is learnt: by the largest gap between the fold's and all
    rows' cumulative distributions (the Kolmogorov-Smirnov distance), summed over the targets.
    """
    gaps = [sum(ks_2samp(v[rows], v).statistic for v in values.T) for rows in parts.folds]
    return int(np.argmin(gaps))


def _folds(plan: CalibrationPlan) -> int:
    """How many parts: five, or eight where a costly model shall learn from as many rows as it can."""
    return plan.folds or (8 if model_kind(plan.model).costly else 5)


def folds_to_score(plan: CalibrationPlan, parts: Split) -> int:
    """How many folds are held out: all, unless the model is costly and the first gives scores enough.

    With 200 scores of 20 groups the rate that 90 % intervals really keep scatters by 2 %.
    """
    if plan.scored_folds is not None:
        return min(plan.scored_folds, len(parts.folds))
    first = parts.folds[0]
    groups = len(first) if parts.groups is None else len(np.unique(parts.groups[first]))
    enough = len(first) >= 200 and groups >= 20
    return 1 if model_kind(plan.model).costly and enough else len(parts.folds)


def _fold(
    model: Model,
    ready: _Ready,
    plan: CalibrationPlan,
    k: int,
    work: Path,
    progress: Progress,
    crew: ProcessGroup,
) -> Values:
    # All processes see the same here: the first writes it only after they have trained this fold together.
    kept = work / f"fold-{k}.npy"
    if kept.exists():
        return np.asarray(np.load(kept, allow_pickle=False))
    rows: Indices = ready.parts.folds[k]
    fitted = model.fit(
        ready.data,
        ready.parts.training_rows(k),
        seed=plan.seed + k + 1,
        progress=_named(progress, f"fold {k + 1} of {len(ready.parts.folds)}"),
        checkpoint=work / f"fold-{k}.npz",
    )
    predicted = predict_rows(fitted, ready.data, rows)
    if crew.first:
        with new_file(kept) as path, path.open("wb") as file:
            np.save(file, predicted)
    return predicted


def _guard(ready: _Ready, fitted: Fitted, plan: CalibrationPlan, progress: Progress) -> NoveltyDetector:
    """A guard that knows every frame, those of the untouched sensor too; they are dealt out to all folds.

    What the model has learnt from besides, it knows as well.
    """
    progress("learning what frames look like", 0, 1)
    whole, rows, held_out = ready.whole, ready.rows, ready.parts.folds
    thumbs = thumbnails(prepared_images(whole, np.arange(len(whole))))
    others = np.setdiff1d(np.arange(len(whole)), rows)
    folds = [np.append(rows[held], others[k :: len(held_out)]) for k, held in enumerate(held_out)]
    also = fitted.also_seen if isinstance(fitted, LearnsFromRendered) else None
    guard = fit_novelty_detector(thumbs, folds, thumbs[ready.untouched.rows], also=also, seed=plan.seed)
    progress("learning what frames look like", 1, 1)
    return guard


def _named(progress: Progress, what: str) -> Progress:
    def named(stage: str, done: int, total: int) -> None:
        progress(f"{what}: {stage}", done, total)

    return named
