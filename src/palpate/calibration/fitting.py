"""Calibration of a model on a run: pack, split, audit, fit, hold out, certify.

Work is kept in a folder beside the result (`.NAME.work`) until it is whole. Interrupted, the same command
goes on from there: the packed set, every finished fold and a network's last epoch are kept. Where the model's
code, the folds or palpate's version have changed since, it begins anew.

Where torchrun began several processes, the first does all this, and the others help it to train.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import ks_2samp

from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.certificate import CalibrationResult, write_certificate
from palpate.calibration.confounds import AuditedRows, ConfoundAudit, audit_confounds
from palpate.calibration.confounds.deciding_pixels import (
    DecidingPixels,
    deciding_pixels,
    mean_input,
    rows_of_fold,
)
from palpate.calibration.coverage.circular_scores import refuse_no_angles
from palpate.calibration.leakage import audit
from palpate.calibration.model_check import check_plugged_in
from palpate.calibration.robustness import Suite, try_changes
from palpate.calibration.sessions.order_check import ScoredSplit, order_card, split_beside
from palpate.calibration.sessions.session_findings import (
    check_sessions,
    held_out_sessions,
    interval_fit,
    refuse_copied_sessions,
    session_fields,
)
from palpate.calibration.training_data import LearningSet, learning_set, table_to_learn
from palpate.core import (
    ExistsError,
    Indices,
    InputError,
    PalpateError,
    PathText,
    Progress,
    Values,
    new_file,
    refuse_existing,
    sha256_of,
    silent,
    split_column,
    storage_errors,
)
from palpate.core.plugins import ERROR, plugin_calls
from palpate.estimators.certified import Intervals
from palpate.estimators.networks import MODELS, make_model, model_kind
from palpate.estimators.networks.distributed import ProcessGroup
from palpate.estimators.networks.model_interface import Fitted, TimeBoxed, predict_rows, refuse_unfit
from palpate.estimators.novelty import LearnsFromRendered, NoveltyDetector, fit_novelty_detector
from palpate.recordings import PackedSet, Run, Split, pack, split
from palpate.recordings.joined_runs import joined
from palpate.recordings.label_tables import refuse_reserved, targets_from
from palpate.recordings.preparation import Preparation
from palpate.recordings.reference_instruments import refuse_strangers
from palpate.version import __version__


def calibrate(
    run: Run | Sequence[Run], plan: CalibrationPlan, out: PathText, progress: Progress = silent
) -> Path:
    """Calibrate an estimator and write its certificate.

    Rows are predicted by a model that has not seen their group; the scores, the intervals and the report
    come from those predictions. The model that is kept has learnt from every row, or, where it is costly
    and one fold gives scores enough, from all but that fold.

    Args:
        run: frames and their labels; several runs are joined, see `recordings.joined_runs.JoinedRun`.
        plan: what to estimate and how.
        out: the calibration folder to make; must not exist.
        progress: called with what is being done and how far it is.

    Returns:
        `out`.

    Raises:
        ExistsError: `out` exists, or work towards another plan, or a file of others, lies in its work folder.
        LabelError, UnitError, SplitError, InputError: the plan does not fit the run, runs do not fit each
            other, or the model predicts what is no finite number.
    """
    run, out = joined(run), Path(out)
    refuse_existing(out)
    started = time.monotonic()
    parts = _split_rows(run, plan)
    processes = _process_group(plan)
    if not processes.first:  # train along, from the set that the first packs, and write nothing
        learning = _learning_set(run, plan, parts, _work_path(out), silent, processes)
        _fit(learning, parts, plan, _work_path(out), silent, processes)
        processes.wait()
        return out
    work = _work_folder(run, plan, parts, out)
    with storage_errors(work):
        learning = _learning_set(run, plan, parts, work, progress, processes)
        refuse_copied_sessions(learning.packed, parts.group_columns)
        leakage = audit(learning.packed, parts)
        held_out, fitted, pixels = _fit(learning, parts, plan, work, progress, processes)
        assert fitted is not None
        beside = _split_beside(learning, parts, plan, work, progress)
        detector = _novelty_detector(learning, parts, fitted, plan, progress)
        suite = Suite(run, learning, parts, held_out, fitted, plan)
        with plugin_calls(f"model {plan.model}: predict failed on a changed frame ({ERROR})", _passed(plan)):
            detector, robustness = try_changes(suite, detector, progress)
        confounds = _confounds(run, plan, learning, parts, held_out, pixels, progress)
        result = CalibrationResult(
            run, plan, learning, parts, leakage, held_out, fitted, detector, confounds=confounds
        )
        result = replace(result, seconds=time.monotonic() - started, robustness=robustness)
        sessions = held_out_sessions(learning.packed.table, parts, result.scored)

        def more(_: Path, intervals: Intervals) -> dict[str, Any]:
            return session_fields(result, sessions, intervals) | _order_fields(result, beside, intervals)

        write_certificate(result, out, fit=interval_fit(sessions), more=more)
        processes.wait()
        shutil.rmtree(work)
    return out


def _process_group(plan: CalibrationPlan) -> ProcessGroup:
    """The processes that shall train together.

    Raises:
        InputError: there are several, and the model is none that they can share.
    """
    processes = ProcessGroup.of_environment()
    if processes.size > 1 and not hasattr(make_model(plan.model, plan.options), "descent"):
        raise InputError(
            f"{processes.size} processes, and {plan.model} trains in one; run palpate without torchrun, or "
            "take one of the palm's networks that are trained with torch"
        )
    return processes


def _split_rows(run: Run, plan: CalibrationPlan) -> Split:
    """Split the rows to learn from, and refuse at once what would fail after an hour."""
    if len(run) < 10:
        raise InputError(f"{run.path} holds {len(run)} frames; a calibration needs 10 or more")
    refuse_reserved(list(run.manifest.labels), str(run.path))
    refuse_strangers(plan.instruments, tuple(run.manifest.labels), str(run.path))
    make_model(plan.model, plan.options)
    prepared = preparation_of(run, plan).apply(run.frame(0).image)
    table = table_to_learn(run.labels, plan)
    values = targets_from(table, plan.targets, str(run.path))
    for column, period, column_values in zip(plan.targets, plan.layout.periods, values.T, strict=True):
        if period is not None:
            refuse_no_angles(column, column_values, split_column(column)[1].symbol, period)
    parts = split(table, plan.split, folds=_folds(plan), seed=plan.seed)
    check_sessions(table, values, plan.targets, parts)
    check_plugged_in(plan, prepared.transpose(2, 0, 1).shape)
    return parts


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


WORK_FILE = re.compile(r"plan\.json|packed|beside|(kept|fold-\d+)\..+|tmp\w+\.npz|\..+\.partial")


def _work_folder(run: Run, plan: CalibrationPlan, parts: Split, out: Path) -> Path:
    """The folder of unfinished work towards this very plan, new or from an interrupted run."""
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
            "run that one again to finish it, remove the folder, or choose another --out"
        )
    with storage_errors(work):
        if work.exists():
            others = sorted(path.name for path in work.iterdir() if not WORK_FILE.fullmatch(path.name))
            if others:
                raise ExistsError(
                    f"{work} holds {others[0]}, which is not palpate's; move it away, or choose another --out"
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


def _learning_set(
    run: Run, plan: CalibrationPlan, parts: Split, work: Path, progress: Progress, processes: ProcessGroup
) -> LearningSet:
    folder = work / "packed"
    if processes.first and not folder.exists():
        prepare = preparation_of(run, plan)
        pack(run, folder, prepare, progress=lambda done, total: progress("packing", done, total))
    processes.wait()
    return learning_set(PackedSet.open(folder), plan, parts.groups, str(run.path))


def _fit(
    learning: LearningSet,
    parts: Split,
    plan: CalibrationPlan,
    work: Path,
    progress: Progress,
    processes: ProcessGroup,
    keep: bool = True,
) -> tuple[Values, Fitted | None, DecidingPixels | None]:
    """Held-out outputs, NaN where a row was in no scored fold, the model that is kept, and its pixels.

    Where every fold is held out in turn, the one kept has learnt from all rows. Where one is, it is the very
    model that was scored. Where none shall be kept, every fold is held out.
    """
    layout, model = plan.layout, make_model(plan.model, plan.options)
    labels = learning.data
    data = replace(labels, values=layout.encoded(labels.values), names=layout.names(labels.names))
    passed = _passed(plan)

    def fit(name: str, what: str, rows: Indices, seed: int) -> Fitted:
        def labelled(stage: str, done: int, total: int) -> None:
            progress(f"{what}: {stage}", done, total)

        learnt = np.isin(np.arange(len(data.values)), rows)[:, None]
        part = replace(data, values=np.where(learnt, data.values, np.nan))  # held-out labels show themselves
        with plugin_calls(f"model {plan.model}: fit failed on {what}, {len(rows)} rows ({ERROR})", passed):
            return model.fit(part, rows, seed=seed, progress=labelled, checkpoint=work / f"{name}.npz")

    def estimates(fitted: Fitted, k: int) -> Values:
        with plugin_calls(f"model {plan.model}: predict failed on fold {k + 1} ({ERROR})", passed):
            found = predict_rows(fitted, data, parts.folds[k])
        refuse_unfit(found, (len(parts.folds[k]), data.values.shape[1]), f"{plan.model}, fold {k + 1}")
        return found

    def pixels(fitted: Fitted, k: int, folds: int) -> DecidingPixels:
        nothing = mean_input(data, parts.training_rows(k))
        with plugin_calls(f"model {plan.model}: predict failed on fold {k + 1} ({ERROR})", passed):
            return deciding_pixels(
                fitted, data, parts.folds[k], nothing, rows_of_fold(folds, k), progress=progress
            )

    def held_out(k: int) -> Values:
        # All processes see the same here: the first writes it after they have trained this fold together.
        file_path = work / f"fold-{k}.npy"
        kept = _read_fold(file_path, (len(parts.folds[k]), data.values.shape[1]))
        if kept is not None:
            maps.append(DecidingPixels.kept(work / f"fold-{k}.pixels.npz"))
            return kept
        what = f"{'' if keep else f'by {parts.kind}, '}fold {k + 1} of {len(parts.folds)}"
        fitted = fit(f"fold-{k}", what, parts.training_rows(k), plan.seed + k + 1)
        predicted = estimates(fitted, k)
        if processes.first:
            if keep:
                found = pixels(fitted, k, count)
                found.keep(work / f"fold-{k}.pixels.npz")
                maps.append(found)
            file_path.unlink(missing_ok=True)
            with new_file(file_path) as path, path.open("wb") as file:
                np.save(file, predicted)
        return predicted

    predicted, maps = np.full_like(data.values, np.nan), list[DecidingPixels | None]()
    count, alone = folds_to_score(plan, parts), representative_fold(parts, labels.values)
    if not keep:
        for k in range(len(parts.folds)):
            predicted[parts.folds[k]] = held_out(k)
        return predicted, None, None
    if isinstance(model, TimeBoxed):
        model = model.shared_among(count + 1 if count > 1 else 1)
    for k in range(count) if count > 1 else ():
        predicted[parts.folds[k]] = held_out(k)
    rows = np.arange(len(data.values)) if count > 1 else parts.training_rows(alone)
    fitted = fit("kept", "the model that is kept", rows, plan.seed)
    if count == 1:
        predicted[parts.folds[alone]] = estimates(fitted, alone)
        if processes.first:
            maps.append(pixels(fitted, alone, 1))
    return predicted, fitted, DecidingPixels.joined([part for part in maps if part is not None])


def _confounds(
    run: Run,
    plan: CalibrationPlan,
    learning: LearningSet,
    parts: Split,
    held_out: Values,
    pixels: DecidingPixels | None,
    progress: Progress,
) -> ConfoundAudit:
    """Audit of what other than touch could have told the labels."""
    untouched = learning.whole.only(learning.untouched.rows)
    rows = AuditedRows(
        packed=learning.packed,
        values=plan.layout.encoded(learning.data.values),
        names=plan.layout.names(tuple(plan.targets)),
        split=parts,
        held_out=held_out,
        untouched=untouched,
        frame_px=run.frame(0).image.shape[:2],
    )
    skin_px = plan.skin_px or run.manifest.regions.get("skin")
    return audit_confounds(rows, skin_px=skin_px, pixels=pixels, progress=progress)


def _split_beside(
    learning: LearningSet, parts: Split, plan: CalibrationPlan, work: Path, progress: Progress
) -> ScoredSplit | None:
    """Shuffled folds beside blocks, or blocks beside shuffled folds; None where that is left out."""
    other = split_beside(learning.packed.table, parts, len(parts.folds), plan.seed)
    if other is None or _left_out(plan, parts):
        return None
    folder = work / "beside"
    folder.mkdir(exist_ok=True)
    predicted, *_ = _fit(learning, other, plan, folder, progress, ProcessGroup(), keep=False)
    return ScoredSplit(other, predicted)


def _left_out(plan: CalibrationPlan, parts: Split) -> str:
    """Why no other split is scored beside the plan's; empty where it is."""
    count = folds_to_score(plan, parts)
    takes_long = model_kind(plan.model).costly or isinstance(make_model(plan.model, plan.options), TimeBoxed)
    if count == len(parts.folds) and not takes_long:
        return ""
    other = "Blocks of the order in which rows were taken" if parts.groups is None else "Shuffled folds"
    return (
        f"{other} were left out, since {plan.model} takes long and {count} of {len(parts.folds)} folds were "
        "scored; a quick model shows what they would say (--model pca-ridge)."
    )


def _order_fields(
    result: CalibrationResult, beside: ScoredSplit | None, intervals: Intervals
) -> dict[str, Any]:
    """The card's part on order, where rows come one by one."""
    plan, parts, data = result.plan, result.split, result.data
    if split_beside(result.learning.packed.table, parts, len(parts.folds), plan.seed) is None:
        return {}
    own = ScoredSplit(parts, result.held_out)
    both = (own,) if beside is None else (own, beside)
    return {"order": order_card(both, data.values, plan.targets, intervals, _left_out(plan, parts))}


def _passed(plan: CalibrationPlan) -> type[Exception]:
    """Errors that are not a plug-in's: a fault of palpate's own models is no plug-in's."""
    return Exception if plan.model in MODELS else PalpateError


def _read_fold(path: Path, shape: tuple[int, int]) -> Values | None:
    """A fold's predictions as an interrupted run kept them; None where they are missing or damaged."""
    try:
        with path.open("rb") as file:
            kept = np.asarray(np.load(file, allow_pickle=False), dtype=np.float64)
    except Exception:  # numpy raises many kinds over damaged bytes
        return None
    return kept if kept.shape == shape and np.isfinite(kept).all() else None


def representative_fold(parts: Split, values: Values) -> int:
    """The fold whose targets are distributed most like all rows', since it stands for all.

    It is chosen by the labels alone, before anything is learnt: by the largest gap between the fold's and all
    rows' cumulative distributions (the Kolmogorov-Smirnov distance), summed over the targets.
    """
    gaps = [sum(ks_2samp(v[rows], v).statistic for v in values.T) for rows in parts.folds]
    return int(np.argmin(gaps))


def _folds(plan: CalibrationPlan) -> int:
    """Number of parts: five, or eight where a costly model shall learn from as many rows as it can."""
    return plan.folds or (8 if model_kind(plan.model).costly else 5)


def folds_to_score(plan: CalibrationPlan, parts: Split) -> int:
    """Number of folds held out: all, unless the model is costly and the first gives scores enough.

    With 200 scores of 20 groups the rate that 90 % intervals really keep scatters by 2 %.
    """
    if plan.scored_folds is not None:
        return min(plan.scored_folds, len(parts.folds))
    first = parts.folds[0]
    groups = len(first) if parts.groups is None else len(np.unique(parts.groups[first]))
    enough = len(first) >= 200 and groups >= 20
    return 1 if model_kind(plan.model).costly and enough else len(parts.folds)


def _novelty_detector(
    learning: LearningSet, parts: Split, fitted: Fitted, plan: CalibrationPlan, progress: Progress
) -> NoveltyDetector:
    """A detector that knows every frame, untouched ones too, and rendered ones that the model has seen."""
    progress("learning what frames look like", 0, 1)
    thumbs = learning.thumbnails()
    also = fitted.rendered_images if isinstance(fitted, LearnsFromRendered) else None
    detector = fit_novelty_detector(
        thumbs, learning.folds_of_whole(parts), thumbs[learning.untouched.rows], also=also, seed=plan.seed
    )
    progress("learning what frames look like", 1, 1)
    return detector
