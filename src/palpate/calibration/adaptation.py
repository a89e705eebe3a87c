"""The guard of an adapted calibration: it knows the frames of both copies, and lets the new one's pass.

The certificate of an adapted calibration: as any other's, and from which calibration it comes.

A calibration taken over to another copy of its sensor, from a few presses of that copy.

The network stays as it is. It reads the copy's own frames, less the copy's own untouched image where it is
differential, and a small correction is learnt behind it (see `calibration.correction`). All that the new
calibration says of itself, its scores, its intervals and its range, comes from the copy's presses alone.

The calibrated range is that of these presses, not joined with the former one: nothing was tested on this copy
beyond them, and the correction goes on there as a guess. Press as deep and as far out as will be used.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from palpate.calibration.calibration_plan import CalibrationPlan, ReferenceRule
from palpate.calibration.certificate import (
    Calibrated,
    agreement,
    file_card,
    pictures,
    predictions_table,
    reference_card,
    run_card,
    software,
    target_cards,
    write_predictions,
)
from palpate.calibration.conformal import GROUPS_FOR_SPREAD, conformal_quantile, fit_intervals
from palpate.calibration.correction import AS_IT_WAS, Adapted, Correction, correct
from palpate.calibration.leakage import audit
from palpate.calibration.training_data import (
    find_untouched,
    marked,
    prepared_images,
    rows_to_learn,
    training_data,
)
from palpate.core import (
    ImageError,
    Indices,
    InputError,
    LabelError,
    PathText,
    Tensor,
    Values,
    new_folder,
    refuse_existing,
    storage_errors,
)
from palpate.estimators.certified import CARD_FILE, Estimator, Intervals, checked_file, intervals_of
from palpate.estimators.model_card import Card, SplitCard, sealed
from palpate.estimators.networks.model_interface import Progress, TrainingData, silent
from palpate.estimators.novelty import (
    NoveltyDetector,
    RenderedImages,
    Thumbnails,
    fit_novelty_detector,
    thumbnails,
)
from palpate.recordings.exchange import image_files
from palpate.recordings.labels import targets_from
from palpate.recordings.packed_set import PackedSet, pack
from palpate.recordings.run_reader import Run
from palpate.recordings.splits import Split, group_names, split

TOGETHER = 12
"""Frames of the former calibration that are held out together: they lie in the order of its presses."""


def guard_with(
    former: NoveltyDetector, thumbs: Thumbnails, folds: Sequence[Indices], untouched: Indices
) -> NoveltyDetector:
    """A guard with another copy's frames added; drift is judged by that copy's own untouched frames.

    Its limits let the copy's frames pass, each held against the former calibration and the copy's other
    presses. Where the former frames are too unlike the copy's to help, they are left out.

    Args:
        former: of the calibration that is adapted.
        thumbs: thumbnails of all the copy's frames ``[n h w c]``.
        folds: their rows by press.
        untouched: which rows show the untouched copy; may be none.
    """
    known = former.seen.thumbs
    also = RenderedImages(known, np.arange(len(known)) // TOGETHER)
    return fit_novelty_detector(thumbs, folds, thumbs[untouched], also=also)


MAX_COVERAGE = 1 - 1e-9


def write_adapted(made: Calibrated, adapted: Adapted, former: Card, out: Path) -> Card:
    """Write the folder; `out` appears whole or not at all.

    Args:
        made: the copy's rows, the network with its correction, and the guard.
        adapted: what the correction is, and what it said of presses it had not learnt from.
        former: card of the calibration that was adapted.
        out: the folder to make.

    Raises:
        CertificateError: the exported model does not repeat the network and its correction.
        ExistsError: `out` exists.
    """
    with new_folder(out) as folder:
        onnx.save(made.fitted.to_onnx(), str(folder / "model.onnx"))
        agrees = agreement(made, folder / "model.onnx")
        made.guard.save(folder / "guard.npz")
        intervals = intervals_of_presses(made.held_out, made.data.values, made.data.groups, former.coverage)
        halves = intervals.half_widths(made.held_out)
        write_predictions(predictions_table(made, halves), folder)
        for name, image in pictures(made):
            (folder / name).write_bytes(image_files.encode(image).tobytes())
        card = _card(made, adapted, former, folder, intervals, halves, agrees)
        (folder / CARD_FILE).write_text(card.model_dump_json(indent=1))
    return card


def intervals_of_presses(predicted: Values, true: Values, groups: np.ndarray, coverage: float) -> Intervals:
    """Intervals that hold the truth at the rate `coverage` in presses not seen, where few were.

    Rows of one press err alike, so that the rank of the quantile is raised by one press and not by one row:
    of P presses, the rows' rate is coverage (P + 1) / P. With ten presses and 90 % that is 99 % of the rows.
    So the presses' distributions are pooled (R. Dunn, L. Wasserman and A. Ramdas, J. Am. Stat. Assoc. 118,
    2491 (2023), doi:10.1080/01621459.2022.2060112), which holds on average over presses.

    Where presses are too few for a width that follows the estimate, the one width is the errors' own
    quantile: scaling each by what the others' typical error is would only add their scatter.
    """
    presses = len(np.unique(groups))
    raised = min(coverage * (presses + 1) / presses, MAX_COVERAGE)
    found = replace(fit_intervals(predicted, true, groups, raised), coverage=coverage)
    if presses >= GROUPS_FOR_SPREAD:
        return found
    scores = np.abs(predicted - true) / found.spread.at(predicted)
    return replace(found, quantile=np.array([conformal_quantile(column, raised) for column in scores.T]))


def _card(
    made: Calibrated,
    adapted: Adapted,
    former: Card,
    folder: Path,
    intervals: Intervals,
    halves: Values,
    agreement: float,
) -> Card:
    others = sorted(p for p in folder.iterdir() if p.name not in ("model.onnx", "guard.npz"))
    return sealed(
        former.model_dump(exclude={"id"})
        | {
            "created_utc": datetime.now(UTC).isoformat(timespec="seconds"),
            "software": software(),
            "sensor": made.run.manifest.sensor,
            "targets": tuple(target_cards(made, intervals, halves)),
            "model": file_card(folder / "model.onnx"),
            "guard": file_card(folder / "guard.npz"),
            "files": tuple(file_card(path) for path in others),
            "reference": reference_card(made),
            "split": _adapted_split(made, adapted, former),
            "run": run_card(made),
            "agreement": agreement,
            "seconds": round(made.seconds, 1),
            "adapted_from": former.id,
        }
    )


def _adapted_split(made: Calibrated, adapted: Adapted, former: Card) -> SplitCard:
    changed = [c for c, d in zip(former.columns, adapted.choices, strict=True) if d.terms != AS_IT_WAS]
    return SplitCard(
        kind=made.split.kind,
        reason=(
            f"adapted from calibration {former.id}, whose network has seen none of this run; scored by "
            "corrections that had not learnt from the press they read; corrected: "
            f"{', '.join(changed) or 'nothing, since no correction was better than none'}"
        ),
        columns=made.split.group_columns,
        groups=len(np.unique(made.data.groups)),
        folds=len(made.split.folds),
        rows_learnt=len(made.packed),
        rows_scored=len(made.packed),
        clean=made.audit.clean,
        audit=made.audit.text,
        details=made.audit.to_dict() | {"correction": _said(made, adapted, former)},
    )


def _said(made: Calibrated, adapted: Adapted, former: Card) -> dict[str, Any]:
    """Of each target: the mean absolute error before and after, in its unit, and what was done."""
    before, after = (
        np.abs(values - made.data.values).mean(axis=0) for values in (adapted.estimates, adapted.held_out)
    )
    return {
        column: {
            "mae_before": float(before[j]),
            "mae_after": float(after[j]),
            "terms": choice.terms,
            "strength": choice.strength,
        }
        for j, (column, choice) in enumerate(zip(former.columns, adapted.choices, strict=True))
    }


GROUPS = ("press", "location")
"""Label columns that say which rows belong to one press, the first that is there; else each row is one."""

FEWEST = 10


def adapt(folder: PathText, run: Run, out: PathText, progress: Progress = silent) -> Card:
    """Adapt a calibration to another copy of its sensor.

    Args:
        folder: the calibration; nothing in it is changed.
        run: ten presses of the copy or more, labelled in the calibration's columns, with frames of the
            untouched copy marked by the calibration's own rule.
        out: the calibration folder to make; must not exist, and appears whole.
        progress: told what is being done and how far it is.

    Returns:
        The new calibration's card. Its scores are of presses that the correction had not learnt from;
        `split.details["correction"]` holds, for each target, the error before and what was done.

    Raises:
        ExistsError: `out` exists.
        CertificateError: the calibration is damaged.
        ImageError: frames are of another size.
        LabelError: a target, or the untouched sensor, is not among the labels.
        InputError: too few presses, or the very run that the calibration has learnt from.
    """
    out = Path(out)
    refuse_existing(out)
    started = time.monotonic()
    estimator = Estimator.open(folder)
    card = estimator.card
    plan = _plan(card, run)
    _check(card, run, plan)
    with storage_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", suffix=".work", dir=out.parent) as work:
            packed = _packed(run, Path(work), card, progress)
            made, adapted = _made(estimator, run, packed, plan, progress)
            progress("writing the calibration", 0, 1)
            return write_adapted(replace(made, seconds=time.monotonic() - started), adapted, card, out)


@dataclass(frozen=True)
class _Corrected:
    """A network and the correction behind it."""

    estimator: Estimator
    correction: Correction

    def predict(self, inputs: Tensor) -> Values:
        return self.correction.at(self.estimator.values(inputs))

    def to_onnx(self) -> onnx.ModelProto:
        card = self.estimator.card
        model = onnx.load(str(self.estimator.folder / card.model.file), load_external_data=False)
        return self.correction.appended(model, f"adapted-{card.id}")


def _plan(card: Card, run: Run) -> CalibrationPlan:
    """What the calibration was asked, of the copy's run."""
    return CalibrationPlan(
        targets=tuple(card.columns),
        split=_grouping(run),
        seed=card.seed,
        size_px=card.input.size_px,
        channels=card.input.channels,
        crop_px=card.input.crop_px,
        beside_px=card.input.beside_px,
        delta=card.input.delta,
        reference=_rule(card, run),
        learn_untouched=card.reference.learnt,
        coverage=card.coverage,
    )


def _grouping(run: Run) -> str:
    return f"leave-one-out:{next((column for column in GROUPS if column in run.labels), 'row')}"


def _rule(card: Card, run: Run) -> ReferenceRule | None:
    """The calibration's own rule; None where it has none, or the run no such rows and does without."""
    held = card.reference
    if held.column is None or held.value is None:
        return None
    rule = ReferenceRule(held.column, held.value, held.by)
    try:
        marked(run.labels, rule)
    except LabelError as e:
        if card.input.delta:
            raise LabelError(
                f"{run.path}: {e}; this calibration subtracts the untouched sensor, so each copy needs "
                f"frames of its own, labelled {rule.column}={rule.value}"
            ) from e
        return None
    return rule


def _check(card: Card, run: Run, plan: CalibrationPlan) -> None:
    """Refuse what cannot be learnt from, before anything is written."""
    if run.hash == card.run.hash:
        raise InputError(
            f"{run.path} is the run that this calibration has learnt from; record presses of your own copy"
        )
    table = run.labels.iloc[rows_to_learn(run.labels, plan)].reset_index(drop=True)
    targets_from(table, plan.targets, str(run.path))
    column = plan.split.partition(":")[2]
    presses = len(table) if column == "row" else len(np.unique(group_names(table, (column,))))
    if presses < _fewest(card.coverage):
        what = "rows" if column == "row" else f"groups in its column {column!r}"
        raise InputError(
            f"{run.path} holds {presses} {what}; adapting takes {_fewest(card.coverage)} presses or more, "
            f"since fewer cannot set intervals that hold {100 * card.coverage:g} % of new ones"
        )


def _fewest(coverage: float) -> int:
    """Presses: with n scores, the greatest is exceeded by a new one with probability 1 / (n + 1)."""
    return max(FEWEST, math.ceil(coverage / (1 - coverage) - 1e-9))


def _packed(run: Run, work: Path, card: Card, progress: Progress) -> PackedSet:
    height, width = card.input.frame_px
    for row in range(len(run)):
        shape = run.frame(row).image.shape
        if shape[:2] != (height, width):
            raise ImageError(
                f"{run.path}: frame {row} is {shape[1]}x{shape[0]} px, the calibration is for "
                f"{width}x{height} px; record the copy with the same camera settings, or calibrate anew"
            )
    return pack(run, work / "packed", card.input.preparation, lambda n, of: progress("packing", n, of))


def _made(
    estimator: Estimator, run: Run, whole: PackedSet, plan: CalibrationPlan, progress: Progress
) -> tuple[Calibrated, Adapted]:
    card, untouched = estimator.card, find_untouched(whole, plan)
    rows = rows_to_learn(whole.table, plan)
    packed = whole.only(rows)
    parts = _split(packed, plan)
    groups = np.arange(len(packed)) if parts.groups is None else parts.groups
    data = training_data(packed, plan, groups, untouched.of(rows), str(run.path))
    progress("learning the correction", 0, 1)
    estimates = _estimates(estimator, data)
    spread = intervals_of(card).spread
    presses = np.unique(groups, return_inverse=True)[1]
    start = Correction.none(spread.centre, spread.scale, estimates)
    adapted = correct(estimates, data.values, presses, start)
    progress("learning the correction", 1, 1)
    made = Calibrated(
        run=run,
        plan=plan,
        packed=packed,
        data=data,
        split=parts,
        audit=audit(packed, parts),
        untouched=untouched,
        held_out=adapted.held_out,
        fitted=_Corrected(estimator, adapted.correction),
        guard=_guard(estimator, whole, _all_folds(len(whole), rows, parts), untouched.rows),
    )
    return made, adapted


def _split(packed: PackedSet, plan: CalibrationPlan) -> Split:
    if plan.split.endswith(":row"):
        each = tuple(np.arange(len(packed))[:, None])
        return Split(plan.split, (), None, each, "no column says which rows are of one press")
    return split(packed.table, plan.split)


def _estimates(estimator: Estimator, data: TrainingData) -> Values:
    rows = np.arange(len(data.values))
    return np.concatenate([estimator.values(inputs) for _, inputs in data.batches(rows)])


def _all_folds(n: int, rows: Indices, parts: Split) -> list[Indices]:
    """The folds, in the whole run's rows; those that are not learnt from are dealt out to them."""
    others = np.setdiff1d(np.arange(n), rows)
    return [np.append(rows[held], others[k :: len(parts.folds)]) for k, held in enumerate(parts.folds)]


def _guard(
    estimator: Estimator, whole: PackedSet, folds: Sequence[Indices], untouched: Indices
) -> NoveltyDetector:
    thumbs = thumbnails(prepared_images(whole, np.arange(len(whole))))
    former = NoveltyDetector.load(checked_file(estimator.folder, estimator.card.guard))
    return guard_with(former, thumbs, folds, untouched)
