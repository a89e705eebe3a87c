"""Calibrate a model on a run: pack, split, audit, fit, hold out, certify.

Work is kept in a folder next to the result (`.NAME.work`), from which the same command resumes unless the
model's code, the folds, or the version have changed. Under torchrun the first process does all this; the
others help to train.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import sys
import time
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.calibration.calibration_job import CalibrationJob, table_to_learn
from palpate.calibration.calibration_plan import CalibrationPlan, check_vector_names
from palpate.calibration.certificate import CalibrationResult, intervals_by, scored_rows, write_certificate
from palpate.calibration.classes import (
    ClassLabels,
    check_learnable,
    class_labels,
    held_out_classes,
    target_values,
    with_classes,
)
from palpate.calibration.confounds.confound_audit import audit_confounds
from palpate.calibration.coverage.range_scores import refuse_no_angles
from palpate.calibration.fold_fits import (
    FoldFits,
    ScoredModel,
    fold_count,
    folds_to_score,
    passed_errors,
    representative_fold,
)
from palpate.calibration.leakage import audit
from palpate.calibration.model_check import check_plugged_in
from palpate.calibration.robustness.perturbation_suite import Suite, try_changes
from palpate.calibration.sessions.session_findings import (
    check_sessions,
    held_out_sessions,
    interval_fit,
    refuse_copied_sessions,
    result_sessions,
)
from palpate.core import (
    ExistsError,
    InputError,
    PathText,
    Progress,
    SplitError,
    new_file,
    refuse_existing,
    sha256_of,
    silent,
    split_column,
    storage_errors,
)
from palpate.core.plugins import ERROR, plugin_calls
from palpate.estimators.guard import LearnsFromRendered, NoveltyDetector, fit_novelty_detector
from palpate.estimators.networks import make_model, model_kind
from palpate.estimators.networks.distributed import ProcessGroup
from palpate.estimators.networks.model_interface import Fitted
from palpate.recordings import PackedSet, Run, Split, pack, split
from palpate.recordings.joined_runs import check_instruments, joined
from palpate.recordings.label_tables import refuse_reserved
from palpate.recordings.preparation import Preparation
from palpate.version import __version__

MIN_LEARNT = 5  # least rows to train on in each fold


def calibrate(
    run: Run | Sequence[Run], plan: CalibrationPlan, out: PathText, progress: Progress = silent
) -> Path:
    """Calibrate an estimator, write its certificate, and return `out`.

    Scores and intervals come from models that had not seen the row's group. The kept model is trained on
    every row or, where it is costly and one fold gives enough scores, on all but that fold.

    Args:
        run: frames and their labels; several runs are joined.
        out: calibration folder to make; must not exist.

    Raises:
        ExistsError: `out` exists, or its work folder holds another plan or other files.
        LabelError, UnitError, SplitError, InputError: the plan does not fit the run, runs do not fit each
            other, or predictions are not finite.
    """
    run, out = joined(run), Path(out)
    refuse_existing(out)
    started = time.monotonic()
    parts = _split_rows(run, plan)
    processes = _process_group(plan)
    if not processes.first:  # train along, from the set that the first packs, and write nothing
        work = _work_path(out)
        job = _job(run, plan, parts, work, silent, processes)
        _scored(FoldFits(job, make_model(plan.model, plan.options), work, silent, processes))
        processes.wait()
        return out
    work = _work_folder(run, plan, parts, out)
    with storage_errors(work):
        job = _job(run, plan, parts, work, progress, processes)
        refuse_copied_sessions(job.packed, parts.group_columns)
        leakage = audit(job.packed, parts, classes=plan.classes)
        outputs, fitted, pixels = _scored(
            FoldFits(job, make_model(plan.model, plan.options), work, progress, processes)
        )
        held_out, of_classes = np.split(outputs, [plan.layout.outputs], axis=1)
        classes = None
        if job.classes:
            classes = held_out_classes(job.classes, of_classes, job.data.groups, plan.coverage)
        sessions = held_out_sessions(job.table, parts, scored_rows(outputs))
        intervals = intervals_by(interval_fit(sessions), held_out, job.data, plan)
        suite = Suite(job, held_out, fitted, intervals)
        detector = _novelty_detector(job, fitted, progress)
        with plugin_calls(
            f"model {plan.model}: predict failed on a changed frame ({ERROR})", passed_errors(plan)
        ):
            detector, robustness = try_changes(suite, detector, progress)
        confounds = audit_confounds(job, outputs, pixels=pixels, progress=progress)
        result = CalibrationResult(
            job, leakage, held_out, intervals, fitted, detector, time.monotonic() - started, robustness,
            confounds, classes, pixels,
        )  # fmt: skip
        write_certificate(result, out, more=lambda _: {"sessions": result_sessions(result, sessions)})
        processes.wait()
        shutil.rmtree(work)
    return out


def _process_group(plan: CalibrationPlan) -> ProcessGroup:
    processes = ProcessGroup.of_environment()
    if processes.size > 1 and not hasattr(make_model(plan.model, plan.options), "descent"):
        raise InputError(
            f"{processes.size} processes, and {plan.model} trains in one; run palpate without torchrun, or "
            "take one of the palm's networks that are trained with torch",
            code="one-process",
        )
    return processes


def _split_rows(run: Run, plan: CalibrationPlan) -> Split:
    if len(run) < 10:
        raise InputError(
            f"{run.path} holds {len(run)} frames; a calibration needs 10 or more", code="few-frames"
        )
    refuse_reserved(list(run.manifest.labels), str(run.path))
    check_instruments(run, plan.targets, plan.instruments)
    check_vector_names(plan.vectors, run.manifest.labels, str(run.path))
    make_model(plan.model, plan.options)
    prepared = preparation_of(run, plan).apply(run.frame(0).image)
    table = table_to_learn(run.labels, plan)
    values = target_values(table, plan.targets, str(run.path))
    for column, period, column_values in zip(plan.targets, plan.layout.periods, values.T, strict=True):
        if period is not None:
            refuse_no_angles(column, column_values, split_column(column)[1].symbol, period)
    classes = _classes(run, plan, table)
    others = table.drop(columns=list(plan.classes)) if plan.split == "auto" else table
    parts = split(others, plan.split, folds=fold_count(plan), seed=plan.seed)
    _refuse_fewer_folds(plan, parts)
    check_learnable(classes, parts)
    names = tuple(name for one in classes for name in one.output_names)
    check_sessions(table, with_classes(values, classes), (*plan.targets, *names), parts)
    _refuse_few_to_learn(parts, len(table))
    check_plugged_in(plan, prepared.transpose(2, 0, 1).shape)
    return parts


def _classes(run: Run, plan: CalibrationPlan, table: pd.DataFrame) -> tuple[ClassLabels, ...]:
    hint = (
        ""
        if len(table) == len(run)
        else " (rows of the untouched sensor are learnt from by --learn-untouched)"
    )
    return class_labels(table, plan.classes, str(run.path), hint=hint)


def _refuse_fewer_folds(plan: CalibrationPlan, parts: Split) -> None:
    """Raise where a split makes fewer folds than were asked for; the default takes what there is."""
    made = len(parts.folds)
    if plan.folds is not None and plan.folds > made:
        column = f" of {' and '.join(parts.group_columns)}" if parts.group_columns else ""
        raise SplitError(
            f"{plan.folds} folds were asked for, and split {plan.split!r} makes {made} here, by {made} "
            f"groups{column}: ask for at most {made}, for none in particular, or for another split",
            code="few-groups",
        )


def _refuse_few_to_learn(parts: Split, rows: int) -> None:
    """Raise where a fold leaves next to nothing to learn from, as where all but one row is one session."""
    largest = max(len(fold) for fold in parts.folds)
    if rows - largest < MIN_LEARNT:
        raise SplitError(
            f"split {parts.kind}: one fold holds out {largest} of {rows} rows, and {rows - largest} are left "
            f"to train on; {MIN_LEARNT} or more are needed: record more of the other groups, or split "
            "otherwise",
            code="split-trains-few",
        )


def preparation_of(run: Run, plan: CalibrationPlan) -> Preparation:
    """Return the preparation a plan asks for.

    Without a size, the input has as many pixels as the model's own square one, in the proportions of frame or
    crop.
    """
    if plan.size_px is not None:
        return Preparation(plan.crop_px, plan.size_px, plan.channels, plan.beside_px, plan.lens)
    side = model_kind(plan.model).side_px
    if plan.beside_px is not None:
        return Preparation(plan.crop_px, (side, 2 * side), plan.channels, plan.beside_px, plan.lens)
    height, width = plan.crop_px[:1:-1] if plan.crop_px else run.frame(0).image.shape[:2]
    tall = math.sqrt(height / width)
    size = round(side * tall), round(side / tall)
    return Preparation(plan.crop_px, size, plan.channels, lens=plan.lens)


WORK_FILE = re.compile(r"plan\.json|packed|(kept|fold-\d+)[.-].+|tmp\w+\.npz|\..+\.partial")


def _work_folder(run: Run, plan: CalibrationPlan, parts: Split, out: Path) -> Path:
    work, request = _work_path(out), _request(run, plan, parts)
    note = work / "plan.json"
    try:
        earlier = json.loads(note.read_bytes())
    except (OSError, ValueError, RecursionError):
        earlier = None
    if earlier == request:
        return work
    if isinstance(earlier, dict) and any(earlier.get(key) != request[key] for key in ("run", "plan")):
        raise ExistsError(
            f"{work} holds unfinished work towards another calibration named {out.name}; "
            "run that one again to finish it, remove the folder, or choose another --out",
            code="other-work",
        )
    with storage_errors(work):
        if work.exists():
            others = sorted(path.name for path in work.iterdir() if not WORK_FILE.fullmatch(path.name))
            if others:
                raise ExistsError(
                    f"{work} holds {others[0]}, which is not palpate's; move it, or choose another --out",
                    code="foreign-file",
                )
            shutil.rmtree(work)
        work.mkdir(parents=True)
    with new_file(note) as path:
        path.write_text(json.dumps(request, sort_keys=True))
    return work


def _request(run: Run, plan: CalibrationPlan, parts: Split) -> Any:
    """All that kept work depends on, as JSON gives it back; the folds stand for a split of the user's own."""
    file_path = getattr(sys.modules[type(make_model(plan.model, plan.options)).__module__], "__file__", None)
    code = sha256_of(Path(file_path)) if file_path else str(time.time())  # a notebook has no file to compare
    folds = repr([[rows.tolist() for rows in parts.folds], np.asarray(parts.groups).tolist()])
    computed_by = {"palpate": __version__, "code": code, "folds": sha256(folds.encode()).hexdigest()}
    return json.loads(json.dumps({"run": run.hash, "plan": plan.to_dict()} | computed_by))


def _work_path(out: Path) -> Path:
    return out.with_name(f".{out.name}.work")


def _job(
    run: Run, plan: CalibrationPlan, parts: Split, work: Path, progress: Progress, processes: ProcessGroup
) -> CalibrationJob:
    folder = work / "packed"
    if processes.first and not folder.exists():
        prepare = preparation_of(run, plan)
        pack(run, folder, prepare, progress=lambda done, total: progress("packing", done, total))
    processes.wait()
    packed = PackedSet.open(folder)
    return CalibrationJob.of(
        run, plan, parts, packed, _classes(run, plan, table_to_learn(packed.table, plan))
    )


def _scored(fits: FoldFits) -> ScoredModel:
    job, plan = fits.job, fits.job.plan
    values = job.outputs.values if plan.classes else job.data.values
    if plan.fold_by:
        values = target_values(job.table, plan.fold_by, "fold_by", constant=True)
    return fits.scored(folds_to_score(plan, job.parts), representative_fold(job.parts, values))


def _novelty_detector(job: CalibrationJob, fitted: Fitted, progress: Progress) -> NoveltyDetector:
    progress("learning what frames look like", 0, 1)
    thumbs = job.thumbnails()
    also = fitted.rendered_images if isinstance(fitted, LearnsFromRendered) else None
    detector = fit_novelty_detector(
        thumbs, job.folds_of_whole(), thumbs[job.untouched.rows], also=also, seed=job.plan.seed
    )
    progress("learning what frames look like", 1, 1)
    return detector
