"""Adapt a calibration to another sensor unit from a few presses of that unit.

The network stays; a small correction behind it (`calibration.correction`) is fitted to the unit's presses.
Scores, intervals, and range come from these presses alone.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnx
import pandas as pd
from sklearn.covariance import ledoit_wolf
from sklearn.model_selection import GroupKFold
from sklearn.neighbors import NearestNeighbors

from palpate.calibration.calibration_job import CalibrationJob, refuse_other_size, rule_in_run, table_to_learn
from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.certificate import (
    CalibrationResult,
    file_card,
    intervals_by,
    split_card,
    write_certificate,
)
from palpate.calibration.correction import AS_IT_WAS, Adapted, Choice, Correction, correct
from palpate.calibration.coverage.conformal import GROUPS_FOR_SPREAD, fit_intervals, pooled_quantile
from palpate.calibration.evaluation import learnt_frames
from palpate.calibration.leakage import audit
from palpate.calibration.robustness.perturbation_suite import (
    CertifiedModel,
    Suite,
    former_frames,
    guard_of,
)
from palpate.calibration.sessions.session_findings import sessions_card
from palpate.core import (
    Float,
    Indices,
    InputError,
    PathText,
    Progress,
    Tensor,
    Values,
    refuse_existing,
    silent,
    storage_errors,
)
from palpate.estimators.certified import Estimator
from palpate.estimators.class_sets import Outputs, TargetLayout
from palpate.estimators.findings import CopyCard
from palpate.estimators.guard import CopyDiscriminator
from palpate.estimators.intervals import Intervals, intervals_of
from palpate.estimators.model_card import Card, SplitCard
from palpate.estimators.networks.model_interface import refuse_unfit
from palpate.recordings import PackedSet, Run, Split, pack, split
from palpate.recordings.joined_runs import SENSOR, check_instruments, run_names
from palpate.recordings.label_tables import targets_from
from palpate.recordings.manifest import ReferenceInstrument
from palpate.recordings.splits import group_names

COPY_FILE = "copy.npz"
MAX_REFUSED_OWN = 0.03  # ratio of the unit's own frames that may be assigned to the former unit
MIN_REFUSED_FORMER = 0.5  # ratio of the former unit's frames to detect, for a useful discriminator
FOLDS, NEAREST = 5, 8  # held-out parts; former frames compared with each of this unit's
ROUNDING = 1 / 12  # variance of a value in whole grey levels

Flat = Float[np.ndarray, "_ k"]


@dataclass(frozen=True, slots=True)
class CopiesToldApart:
    """Discriminator of two sensor units.

    Attributes:
        refused_own, refused_former: ratio of each unit's frames assigned to the former unit, each judged
            without its own group.
    """

    discriminator: CopyDiscriminator
    refused_own: float
    refused_former: float

    @property
    def useful(self) -> bool:
        """True if enough of the former copy's frames are told."""
        return self.refused_former >= MIN_REFUSED_FORMER


class _Frames(NamedTuple):
    """Flat thumbnails of a copy, and the group (press) that each is of."""

    thumbs: Flat
    groups: Indices

    def parts(self, count: int) -> np.ndarray:
        fold = np.empty(len(self.groups), np.int64)
        for k, (_, held) in enumerate(GroupKFold(count).split(self.groups, groups=self.groups)):
            fold[held] = k
        return fold


def tell_apart(
    own: np.ndarray, own_groups: Indices, former: np.ndarray, former_groups: Indices
) -> CopiesToldApart:
    """Train a discriminator of two sensor units, judged by the former frames most like this unit's.

    Args:
        own, former: thumbnails of the adapted unit ``[n h w c]`` and of the former one ``[m h w c]``.
        own_groups, former_groups: group (press) of each; two or more.
    """
    sides = [_Frames(_flat(own), own_groups), _Frames(_flat(former), former_groups)]
    count = min(FOLDS, *(len(np.unique(side.groups)) for side in sides))
    folds = [side.parts(count) for side in sides]
    places = [np.empty(len(side.thumbs)) for side in sides]
    for k in range(count):
        learnt = [side.thumbs[fold != k] for side, fold in zip(sides, folds, strict=True)]
        axis, offset = _fisher(*learnt)
        for side, fold, place in zip(sides, folds, places, strict=True):
            place[fold == k] = side.thumbs[fold == k] @ axis - offset
    places[1] = places[1][_most_alike(sides[1].thumbs, sides[0].thumbs)]
    limit = _limit(*places)
    axis, offset = _fisher(sides[0].thumbs, sides[1].thumbs)
    refused = [float(np.mean(place > limit)) for place in places]
    return CopiesToldApart(CopyDiscriminator(axis, offset, limit), *refused)


def _most_alike(former: Flat, own: Flat) -> Indices:
    search = NearestNeighbors(n_neighbors=min(NEAREST, len(former)), algorithm="brute").fit(former)
    return np.unique(search.kneighbors(own, return_distance=False))


def _flat(thumbs: np.ndarray) -> Flat:
    return np.asarray(thumbs, np.float64).reshape(len(thumbs), -1)


def _fisher(own: Flat, former: Flat) -> tuple[np.ndarray, float]:
    """Fisher's axis with Ledoit-Wolf covariance, means at 0 and 1 (doi:10.1016/S0047-259X(03)00096-4)."""
    within = np.concatenate([side - side.mean(axis=0) for side in (own, former)])
    covariance = ledoit_wolf(within, assume_centered=True)[0]
    covariance[np.diag_indices_from(covariance)] += ROUNDING
    axis = np.linalg.solve(covariance, former.mean(axis=0) - own.mean(axis=0))
    means = own.mean(axis=0), former.mean(axis=0)
    apart = float(axis @ (means[1] - means[0]))
    axis = axis / apart if apart > 0 else 0 * axis
    return axis, float(axis @ means[0])


def _limit(own: np.ndarray, former: np.ndarray) -> float:
    highest = float(np.quantile(own, 1 - MAX_REFUSED_OWN, method="higher"))
    lowest = float(np.quantile(former, MAX_REFUSED_OWN, method="lower"))
    return (highest + lowest) / 2 if lowest > highest else highest


def copy_card(found: CopiesToldApart, former: Card, run: Run, folder: Path) -> CopyCard:
    """Return the card's part on sensor units; the discriminator is written to `folder` where it is useful."""
    name, other = copy_names(former, run)
    if found.useful:
        found.discriminator.save(folder / COPY_FILE)
    own, seen = 100 * found.refused_own, 100 * found.refused_former
    told = (
        f"Adapted to {name}. Frames of {other}, which the network came from, are refused: {seen:.0f} % of "
        f"its frames most like this copy's, each judged without its neighbours, and {own:.1f} % of this "
        "copy's own by mistake."
    )
    untold = (
        f"Adapted to {name}. Its frames cannot be told from those of {other}, which the network came from: "
        f"no more than {seen:.0f} % of them. Make sure by other means which one is read."
    )
    return CopyCard(
        name=name,
        former=other,
        run_id=run.manifest.run_id,
        file=file_card(folder / COPY_FILE) if found.useful else None,
        refused_own=found.refused_own if found.useful else 0.0,
        refused_former=found.refused_former if found.useful else 0.0,
        text=told if found.useful else untold,
    )


def copy_names(former: Card, run: Run) -> tuple[str, str]:
    """Return the names of the adapted unit and the former one, with their runs if these are equal."""
    own = _labelled(run) or run.manifest.sensor or run_names((run,))[0]
    other = (former.copy_of.name if former.copy_of else former.sensor) or "the former copy"
    return (
        (own, other)
        if own != other
        else (f"{own} of {run_names((run,))[0]}", f"{other} of calibration {former.id}")
    )


def _labelled(run: Run) -> str:
    """The one value of a label ``copy`` or ``sensor``; nothing where there is none or several."""
    for column in ("copy", SENSOR):
        if column in run.labels:
            values = run.labels[column].dropna().astype(str).unique()
            return str(values[0]) if len(values) == 1 else ""
    return ""


MAX_COVERAGE = 1 - 1e-9


def intervals_of_presses(
    predicted: Outputs, true: Values, groups: np.ndarray, coverage: float, layout: TargetLayout | None = None
) -> Intervals:
    """Return intervals that cover the truth at the rate `coverage` in unseen presses, from few presses.

    Rows of one press have correlated errors: with P presses the rows' rate is coverage (P + 1) / P (R. Dunn,
    L. Wasserman and A. Ramdas, J. Am. Stat. Assoc. 118, 2491 (2023), doi:10.1080/01621459.2022.2060112).
    """
    presses = len(np.unique(groups))
    raised = min(coverage * (presses + 1) / presses, MAX_COVERAGE)
    intervals = replace(fit_intervals(predicted, true, groups, raised, layout), coverage=coverage)
    if presses >= GROUPS_FOR_SPREAD:
        return intervals
    scores = np.abs(intervals.errors(predicted, true)) / intervals.spread.at(predicted)
    return replace(
        intervals, quantile=np.array([pooled_quantile(column, groups, raised) for column in scores.T])
    )


def _adapted_split(result: CalibrationResult, adapted: Adapted, former: Card) -> SplitCard:
    choices = _choices(result, adapted)
    changed = [c for c, d in zip(former.columns, choices, strict=True) if d.terms != AS_IT_WAS]
    reason = (
        f"adapted from calibration {former.id}, whose network has seen none of this run; scored by "
        "corrections that had not learnt from the press they read; corrected: "
        f"{', '.join(changed) or 'nothing, since no correction was better than none'}"
    )
    card = split_card(result)
    corrections = {"correction": _correction_records(result, adapted, former)}
    return card.model_copy(update={"reason": reason, "details": card.details | corrections})


def _correction_records(result: CalibrationResult, adapted: Adapted, former: Card) -> dict[str, Any]:
    layout, true, choices = result.layout, result.data.values, _choices(result, adapted)
    before, after = (
        np.abs(layout.differences(layout.decoded(outputs), true)).mean(axis=0).tolist()
        for outputs in (adapted.estimates, adapted.held_out)
    )
    return {
        column: {"mae_before": was, "mae_after": now, "terms": choice.terms, "strength": choice.strength}
        for column, was, now, choice in zip(former.columns, before, after, choices, strict=True)
    }


def _choices(result: CalibrationResult, adapted: Adapted) -> tuple[Choice, ...]:
    """The correction of each target; of a circular one that of its cosine, or else of its sine."""
    found = []
    for j in range(len(result.layout.periods)):
        first, *others = adapted.choices[result.layout.outputs_of(j)]
        found.append(next((one for one in (first, *others) if one.terms != AS_IT_WAS), first))
    return tuple(found)


GROUPS = ("press", "location")  # label columns of the press, first match; else each row is one
MIN_PRESSES = 10


def adapt(
    folder: PathText,
    run: Run,
    out: PathText,
    progress: Progress = silent,
    *,
    instruments: Mapping[str, ReferenceInstrument] | None = None,
) -> Card:
    """Adapt a calibration to another unit of its sensor.

    Args:
        folder: calibration; it is not changed.
        run: ten presses or more, labeled in the calibration's columns, with no-contact frames by its rule.
        out: calibration folder to make; must not exist, and appears whole.
        instruments: reference instruments of label columns; precede the run's manifest.

    Returns:
        The new card, with scores of presses that the correction had not seen; `split.details["correction"]`
        holds each target's error before, and what was done.

    Raises:
        ExistsError, CertificateError: `out` exists; the calibration is damaged.
        ImageError, LabelError: frames or labels do not fit the calibration.
        InputError: too few presses, or the run that the calibration was trained on.
    """
    out = Path(out)
    refuse_existing(out)
    started = time.monotonic()
    estimator = Estimator.open(folder)
    card = estimator.card
    _refuse_classes(card)
    check_instruments(run, card.columns, instruments or {})
    stated = run.manifest.instruments | dict(instruments or {})
    plan = CalibrationPlan.of_card(card, rule_in_run(card, run), _grouping(run), stated)
    _check(estimator, run, plan)
    with storage_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", suffix=".work", dir=out.parent) as work:
            refuse_other_size(run, card, range(len(run)))
            prepare, told = card.input.preparation, lambda n, of: progress("packing", n, of)
            packed = pack(run, Path(work) / "packed", prepare, told)
            result, adapted = _result(estimator, run, packed, plan, progress)
            progress("writing the calibration", 0, 1)
            result = replace(result, seconds=time.monotonic() - started)
            held_out = _adapted_split(result, adapted, card)
            copies = _told_apart(estimator, result)

            def more(folder: Path) -> dict[str, Any]:
                own = {"sessions": sessions_card(run, None, {}, card.coverage)}
                return own | {"interval_reset": None, "copy_of": copy_card(copies, card, run, folder)}

            return write_certificate(result, out, former=card, split=held_out, more=more)


@dataclass(frozen=True)
class _CorrectedNetwork:
    """A network and the correction behind it."""

    estimator: Estimator
    correction: Correction

    def predict(self, inputs: Tensor) -> Values:
        return self.correction.at(self.estimator.values(inputs))

    def to_onnx(self) -> onnx.ModelProto:
        model = CertifiedModel(self.estimator).to_onnx()
        return self.correction.appended(model, f"adapted-{self.estimator.card.id}")


def _refuse_classes(card: Card) -> None:
    if card.classes:
        raise InputError(
            f"calibration {card.id} tells classes ({', '.join(one.column for one in card.classes)}), which a "
            "correction from a few presses is not built for; calibrate on presses of your own copy",
            code="has-classes",
        )


def _grouping(run: Run) -> str:
    return f"leave-one-out:{next((column for column in GROUPS if column in run.labels), 'row')}"


def _check(estimator: Estimator, run: Run, plan: CalibrationPlan) -> None:
    card = estimator.card
    if run.hash == card.run.hash:
        raise InputError(
            f"{run.path} is the run that this calibration has learnt from; record presses of your own copy",
            code="trained-on",
        )
    table = table_to_learn(run.labels, plan)
    targets_from(table, plan.targets, str(run.path))
    column = plan.split.partition(":")[2]
    presses = len(table) if column == "row" else len(np.unique(group_names(table, (column,))))
    if presses < _min_presses(card.coverage):
        what = "rows" if column == "row" else f"groups in its column {column!r}"
        raise InputError(
            f"{run.path} holds {presses} {what}; adapting takes {_min_presses(card.coverage)} presses or "
            f"more, since fewer cannot set intervals that hold {100 * card.coverage:g} % of new ones",
            code="few-groups",
        )
    if why := learnt_frames(estimator, run).why:
        raise InputError(
            f"{run.path} shows no copy of its own: {why}; record presses of your own copy", code="trained-on"
        )


def _min_presses(coverage: float) -> int:
    """Presses: with n scores, the greatest is exceeded by a new one with probability 1 / (n + 1)."""
    return max(MIN_PRESSES, math.ceil(coverage / (1 - coverage) - 1e-9))


def _result(
    estimator: Estimator, run: Run, whole: PackedSet, plan: CalibrationPlan, progress: Progress
) -> tuple[CalibrationResult, Adapted]:
    table = table_to_learn(run.labels, plan)
    parts = _split(table, plan)
    job = CalibrationJob.of(run, plan, parts, whole)
    data = job.data
    progress("learning the correction", 0, 1)
    estimates = np.concatenate([estimator.values(x) for _, x in data.batches(np.arange(len(data.values)))])
    labels = plan.layout.encoded(data.values)
    refuse_unfit(estimates, labels.shape, f"of calibration {estimator.card.id}")
    spread = intervals_of(estimator.card).spread
    presses = np.unique(data.groups, return_inverse=True)[1]
    start = Correction.none(spread.centre, spread.scale, estimates)
    periods = enumerate(plan.layout.periods)
    turning = [
        k for j, period in periods if period for k in range(labels.shape[1])[plan.layout.outputs_of(j)]
    ]
    adapted = correct(estimates, labels, presses, start, linear=tuple(turning))
    progress("learning the correction", 1, 1)
    fitted = _CorrectedNetwork(estimator, adapted.correction)
    intervals = intervals_by(intervals_of_presses, adapted.held_out, data, plan)
    suite = Suite(job, adapted.held_out, fitted, intervals)
    novelty, robustness = guard_of(suite, progress, former_frames(estimator))
    result = CalibrationResult(
        job=job,
        audit=audit(job.packed, parts),
        held_out=adapted.held_out,
        intervals=intervals,
        fitted=fitted,
        novelty=novelty,
        robustness=robustness,
    )
    return result, adapted


def _split(table: pd.DataFrame, plan: CalibrationPlan) -> Split:
    if plan.split.endswith(":row"):
        each = tuple(np.arange(len(table))[:, None])
        return Split(plan.split, (), None, each, "no column says which rows are of one press")
    return split(table, plan.split)


def _told_apart(estimator: Estimator, result: CalibrationResult) -> CopiesToldApart:
    former = former_frames(estimator)
    job, fold = result.job, np.zeros(len(result.job.whole), np.int64)
    for k, rows in enumerate(job.folds_of_whole()):
        fold[rows] = k
    return tell_apart(job.thumbnails(), fold, former.thumbs, former.groups)
