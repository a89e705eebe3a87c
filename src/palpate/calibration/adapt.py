"""A calibration taken over to another copy of its sensor, from a few presses of that copy.

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
from pathlib import Path

import numpy as np
import onnx

from palpate.calibration.adapted_certificate import write_adapted
from palpate.calibration.adapted_guard import guard_with
from palpate.calibration.correction import Adapted, Correction, correct
from palpate.calibration.data import find_untouched, marked, prepared_images, rows_to_learn, training_data
from palpate.calibration.leakage import audit
from palpate.calibration.made import Calibrated
from palpate.calibration.plan import CalibrationPlan, Reference
from palpate.core.errors import ImageError, InputError, LabelError
from palpate.core.files import PathText, refuse_existing, storage_errors
from palpate.core.shapes import Indices, Tensor, Values
from palpate.estimators.certified import Estimator, checked_file, intervals_of
from palpate.estimators.model_card import Card
from palpate.estimators.networks.model_interface import Progress, TrainingData, silent
from palpate.estimators.novelty import NoveltyDetector, thumbnails
from palpate.recordings.labels import targets_from
from palpate.recordings.packed_set import PackedSet, pack
from palpate.recordings.run_reader import Run
from palpate.recordings.splits import Split, group_names, split

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


def _rule(card: Card, run: Run) -> Reference | None:
    """The calibration's own rule; None where it has none, or the run no such rows and does without."""
    held = card.reference
    if held.column is None or held.value is None:
        return None
    rule = Reference(held.column, held.value, held.by)
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
