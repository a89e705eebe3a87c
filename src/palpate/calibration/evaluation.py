"""Scores of estimates against labels, with the intervals' coverage and its own interval."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from palpate.calibration.calibration_job import rows_matching
from palpate.calibration.calibration_plan import SESSION, ReferenceRule
from palpate.calibration.classes import SEPARATOR, class_findings, known_codes, score_of_run, target_values
from palpate.calibration.coverage.conformal import joint_score
from palpate.calibration.coverage.grouped_rates import (
    ROW,
    counted_groups,
    grouped_coverage_interval,
    press_column,
    press_groups,
)
from palpate.calibration.coverage.range_scores import dispersion, range_scores, shortest, target_findings
from palpate.calibration.near_copies import LearntFrames, find_learnt_frames
from palpate.core import (
    Bool,
    CertificateError,
    LabelError,
    Progress,
    Readings,
    Shaped,
    Values,
    half_width_text,
    silent,
)
from palpate.estimators.certified import Estimator, Zero
from palpate.estimators.findings import ValidScoreCard
from palpate.estimators.intervals import intervals_of, layout_of, within
from palpate.estimators.model_card import Card, ScoreCard, TargetCard, TenthCard
from palpate.estimators.reference_uncertainty import untold, without_reference
from palpate.recordings import Run
from palpate.recordings.joined_runs import JoinedRun, sessions_of
from palpate.recordings.label_tables import own_column, with_own


def score(
    unit_: str,
    true: Shaped[np.ndarray, " n"],
    predicted: Shaped[np.ndarray, " n"],
    half: Shaped[np.ndarray, " n"],
    mean: float | Shaped[np.ndarray, " n"],
    groups: Shaped[np.ndarray, " n"],
    *,
    inside: Shaped[np.ndarray, " n"] | None = None,
    period: float | None = None,
) -> ScoreCard:
    """Score one target.

    Args:
        unit_: unit of everything given.
        true, predicted, half: labels, estimates, and half-widths of their intervals ``[n]``.
        mean: training mean, as an estimate of every row.
        inside: whether each interval covered the truth; None where estimates lie in their middles.
        period: of a circular target; errors are the shortest way round.
    """
    error, away = shortest(predicted - true, period), shortest(true - mean, period)
    inside = np.abs(error) <= half if inside is None else inside
    low, high = grouped_coverage_interval(inside, groups)
    variance = float(np.var(true)) if period is None else dispersion(true, period)
    return ScoreCard(
        unit=unit_,
        n=len(true),
        mae=float(np.abs(error).mean()),
        rmse=float(np.sqrt(np.mean(error**2))),
        bias=float(error.mean()),
        r2=1 - float(np.mean(error**2)) / variance if variance > 0 else 0.0,
        mean_mae=float(np.abs(away).mean()),
        coverage_90=float(inside.mean()),
        coverage_90_low=low,
        coverage_90_high=high,
        half_width=float(half.mean()),
    )


def valid_score(
    error: Shaped[np.ndarray, " n"],
    inside: Shaped[np.ndarray, " n"],
    groups: Shaped[np.ndarray, " n"],
    valid: Shaped[np.ndarray, " n"],
) -> ValidScoreCard:
    """Score the valid readings of one target alone.

    Args:
        error: absolute errors ``[n]``.
        inside, valid: whether each interval covered the truth, and each reading is valid ``[n]``.
    """
    if not valid.any():
        return ValidScoreCard(n=0)
    low, high = grouped_coverage_interval(inside[valid], groups[valid])
    return ValidScoreCard(
        n=int(valid.sum()),
        mae=float(error[valid].mean()),
        covered=float(inside[valid].mean()),
        low=low,
        high=high,
    )


def zeros_of(estimator: Estimator, run: Run) -> dict[int, Zero]:
    """Return the no-contact references in a run by the calibration's rule: row -> reference."""
    table = run.labels
    rule = ReferenceRule.of_card(estimator.card)
    by = [] if rule is None else list(rule.for_columns(table.columns).by)
    rows = _untouched_rows(estimator.card, table)
    groups = table.groupby(by, sort=False).ngroup().to_numpy() if by else np.zeros(len(table))
    zeros: dict[int, Zero] = {}
    for group in np.unique(groups[rows]):
        images = [run.frame(int(row)).image for row in rows[groups[rows] == group]]
        mean = np.mean(images, axis=0).round().astype(np.uint8)
        zero = estimator.zero(mean)
        zeros |= {int(row): zero for row in np.flatnonzero(groups == group)}
    return zeros


def evaluate(
    estimator: Estimator, run: Run, *, zero: Zero | None = None, progress: Progress = silent
) -> dict[str, Any]:
    """Score a calibration on a run, one frame in memory at a time.

    Args:
        run: frames with labels in the calibration's target columns.
        zero: one reference for the whole run; None finds the run's own by the calibration's rule.

    Returns:
        By target column ``targets`` (unit, n, mae, rmse, bias, r2, coverage_90, ...), ``valid_readings``,
        ``tenths`` of its range, ``findings_of`` (sentences), ``frames_untold`` (intervals as wide as the
        range), ``coverage_with_instrument`` and ``instruments`` (labels by another instrument); ``vectors``
        and ``classes`` with scores; ``findings``; counts ``frames_scored``, ``frames_read``,
        ``frames_valid``, ``frames_all_valid``, ``frames_drifted``; ``learnt_frames`` (train/test overlap);
        ``same_session``; ``simulated``; ``counted_groups`` and ``counted_by``.

    Raises:
        LabelError: a target column is missing or unfit, or a row is of an unknown class.
        ImageError: the calibration is differential and the run has no reference.
        CertificateError: the network gives no finite number for a frame of its own size.
    """
    card = estimator.card
    rows = rows_to_score(card, run.labels)
    labels = run.labels.iloc[rows].reset_index(drop=True)
    true = target_values(labels, card.columns, str(run.path), constant=True)
    for one in card.classes or ():
        known_codes(labels, one.column, one.values, str(run.path))
    table, spread, valid = _read_run(estimator, run, zero, progress)
    finite = _read_rows(card, table)
    if any(run.frame(int(row)).image.shape[:2] == card.input.frame_px for row in rows[~finite]):
        raise CertificateError(
            f"{run.path}: calibration {card.id} gives no finite number for some of {np.sum(~finite)} frames, "
            "which scores would leave out; calibrate again",
            code="not-finite",
        )
    scores = _scores(card, run, true, table, spread, valid)
    outside = labels_outside(card, true)
    shifted = [] if run.manifest.order == "names" else shifted_labels(card, true, table)
    void = [sentence for column in outside for sentence in scores["findings_of"].pop(column, [])]
    found = learnt_frames(estimator, run)
    return scores | {
        "learnt_frames": {k: getattr(found, k) for k in ("compared", "equal", "presses", "repeated")},
        "findings": [*outside.values(), *shifted, *(one for one in scores["findings"] if one not in void)],
        "labels_outside": outside,
        "same_session": same_session(estimator, run, found) or "; ".join(outside.values()),
    }


def predictions(
    estimator: Estimator, run: Run, *, zero: Zero | None = None, progress: Progress = silent
) -> pd.DataFrame:
    """Return the estimates of a calibration for each frame of a run, one frame in memory at a time.

    Returns:
        Labels of the frames to score; per target ``estimate:``, ``half_width:``, ``low:``, and
        ``high:COLUMN`` in its unit, NaN where a frame could not be read; per vector component
        ``joint_half_width:COLUMN``; per class column ``estimate:`` and ``set:COLUMN``, names joined by ``|``;
        ``own:valid``, ``own:all_valid``, ``own:drifted``, ``own:why``.
    """
    return _read_run(estimator, run, zero, progress)[0]


def _read_run(
    estimator: Estimator, run: Run, zero: Zero | None, progress: Progress
) -> tuple[pd.DataFrame, Values, Bool[np.ndarray, "n t"]]:
    """Table of `predictions`, with expected error size and validity of each target's reading ``[n t]``."""
    card = estimator.card
    rows = rows_to_score(card, run.labels)
    error_spread, count = intervals_of(card).spread, layout_of(card).outputs
    zeros = {} if zero is not None else zeros_of(estimator, run)
    spread = np.full((len(rows), len(card.columns)), np.nan)
    valid = np.zeros(spread.shape, bool)
    cells: list[dict[str, Any]] = []
    own: list[dict[str, Any]] = []
    for i, row in enumerate(rows):
        readings, outputs = estimator.read_with_outputs(run.frame(int(row)), zero or zeros.get(int(row)))
        if outputs is not None and card.targets:
            spread[i] = error_spread.at(outputs[:, :count])[0]
        valid[i] = [readings[column].valid for column in card.columns]
        cells.append(_cells(card, readings))
        own.append(_own(card, readings))
        progress("evaluating", i + 1, len(rows))
    table = pd.concat([run.labels.iloc[rows].reset_index(drop=True), pd.DataFrame(cells)], axis=1)
    return with_own(table, {name: [one[name] for one in own] for name in OWN_COLUMNS}), spread, valid


OWN_COLUMNS = ("valid", "why", "all_valid", "drifted")


def _cells(card: Card, readings: Readings) -> dict[str, Any]:
    """Columns of `predictions` for one frame."""
    cells: dict[str, Any] = {}
    for column in card.columns:
        one = readings[column]
        cells |= {f"estimate:{column}": one.value, f"half_width:{column}": (one.high - one.low) / 2}
        cells |= {f"low:{column}": one.low, f"high:{column}": one.high}
    for vector in card.vectors or ():
        reach = readings[vector.column].region.half_widths
        cells |= {f"joint_half_width:{p}": r for p, r in zip(vector.columns, reach, strict=True)}
    for named in card.classes or ():
        cells[f"estimate:{named.column}"] = readings[named.column].value
        cells[f"set:{named.column}"] = SEPARATOR.join(readings[named.column].members)
    return cells


def _own(card: Card, readings: Readings) -> dict[str, Any]:
    """Whether a frame told something valid, and all of it, whether it drifted, and why not."""
    each = [(readings[t.column], t) for t in card.targets]
    named = [readings[one.column] for one in card.classes or ()]
    of_read = [*(one for one, t in each if not t.is_never_valid), *named]
    told = [one for one, t in each if not untold(t, one.low, one.high)]
    told += [one for one in named if 0 < len(one.members) < len(one.classes)]
    said = told or [*(one for one, _ in each), *named]
    why = "; ".join(sorted({one.why for one in said if one.why}))
    return {
        "valid": not why,
        "why": why,
        "all_valid": bool(of_read) and all(one.valid for one in of_read),
        "drifted": any(one.drift is not None and one.drift.drifted for one in readings.values()),
    }


def _read_rows(card: Card, table: pd.DataFrame) -> np.ndarray:
    """Rows for which the network gave finite numbers, as a mask."""
    read = np.isfinite(table[[f"estimate:{column}" for column in card.columns]].to_numpy(float)).all(axis=1)
    for one in card.classes or ():
        read &= (table[f"estimate:{one.column}"] != "").to_numpy()
    return read


def rows_to_score(card: Card, table: pd.DataFrame) -> np.ndarray:
    """Return all rows but no-contact rows that the calibration was not trained on."""
    untouched = _untouched_rows(card, table)
    return np.arange(len(table)) if card.reference.learnt else np.setdiff1d(np.arange(len(table)), untouched)


def _untouched_rows(card: Card, table: pd.DataFrame) -> np.ndarray:
    """Rows that the calibration's own rule says show the untouched sensor; none where it has no rule."""
    rule = ReferenceRule.of_card(card)
    nothing = np.empty(0, np.int64)
    try:
        return (
            nothing if rule is None else np.flatnonzero(rows_matching(table, rule.for_columns(table.columns)))
        )
    except LabelError:
        return nothing


def _scores(
    card: Card, run: Run, true: Values, table: pd.DataFrame, spread: Values, valid: Bool[np.ndarray, "n t"]
) -> dict[str, Any]:
    read = _read_rows(card, table)
    if not read.any():
        raise LabelError(f"{run.path}: no frame could be read, every one is of another size than calibrated")
    counted, counted_by = counted_groups(card, table[read])
    groups = counted
    if len(np.unique(groups)) == 1:
        groups, counted_by = press_groups(table[read]), press_column(table) or ROW
    scored = {
        t.column: _target_scores(card, t, true[read, j], table[read], valid[read, j], groups)
        for j, t in enumerate(card.targets)
    }
    targets, tenths = ({column: one[part] for column, one in scored.items()} for part in ("score", "tenths"))
    tenths = {column: parts for column, parts in tenths.items() if parts is not None}
    with_instrument = {
        t.column: scored[t.column]["with_instrument"]
        for t in card.targets
        if _stated_by_others(card, t, run) is not None
    }
    classes = {
        one.column: score_of_run(one, table[read], groups, card.coverage, str(run.path))
        for one in card.classes or ()
    }
    about_classes = [
        sentence
        for one in card.classes or ()
        for sentence in class_findings(one, classes[one.column], card.coverage)
    ]
    findings_of = _findings(card, targets, tenths)
    estimates = _told(card, table[read], "estimate")
    return {
        "targets": targets,
        "valid_readings": {column: one["valid"] for column, one in scored.items()},
        "tenths": tenths,
        "classes": {column: found.model_dump() for column, found in classes.items()},
        "findings": [*(one for of_target in findings_of.values() for one in of_target), *about_classes],
        "findings_of": findings_of,
        "coverage_with_instrument": with_instrument,
        "instruments": {
            t.column: _instrument_sentence(card, t, run, with_instrument[t.column])
            for t in card.targets
            if t.column in with_instrument
        },
        "vectors": {
            v.column: joint_score(v, card.columns, estimates - true[read], spread[read], groups)
            for v in card.vectors or ()
        },
        **_counts(card, run, table, read),
        "groups": len(np.unique(counted)),
        "counted_groups": len(np.unique(groups)),
        "counted_by": counted_by,
    }


def _target_scores(
    card: Card,
    t: TargetCard,
    truth: Shaped[np.ndarray, " n"],
    table: pd.DataFrame,
    valid: Bool[np.ndarray, " n"],
    groups: Shaped[np.ndarray, " n"],
) -> dict[str, Any]:
    """One target over the frames read: score, that of valid readings, tenths of its range, coverage."""
    estimate, half, low, high = (
        table[f"{kind}:{t.column}"].to_numpy(float) for kind in ("estimate", "half_width", "low", "high")
    )
    ends = without_reference(t, estimate, low, high)  # labels are what it shows
    inside = None if t.over_range is None else within(truth, *ends)
    of_labels = half if t.measured_by is None else (ends[1] - ends[0]) / 2
    error = shortest(estimate - truth, t.period)
    held = np.abs(error) <= of_labels if inside is None else inside
    whole = score(t.unit, truth, estimate, of_labels, t.training_mean, groups, inside=inside, period=t.period)
    tenths = None
    if inside is not None:
        reach = (t.least, t.greatest)
        parts = range_scores(truth, estimate - truth, inside, groups, reach, card.coverage)
        tenths = [part.model_dump() for part in parts]
    off = shortest(truth - estimate, t.period)
    return {
        "score": whole.model_dump(),
        "valid": valid_score(np.abs(error), held, groups, valid).model_dump(),
        "tenths": tenths,
        "with_instrument": float(within(off, low - estimate, high - estimate).mean()),
    }


def _counts(card: Card, run: Run, table: pd.DataFrame, read: Bool[np.ndarray, " n"]) -> dict[str, Any]:
    """What was scored: the run, its frames, sessions and groups' columns."""
    low, high = (_told(card, table[read], kind) for kind in ("low", "high"))
    return {
        "calibration": card.id,
        "run": {"run_id": run.manifest.run_id, "hash": run.hash, "frames": len(run)},
        "frames_scored": len(table),
        "frames_read": int(read.sum()),
        "frames_untold": {
            t.column: int(sum(untold(t, *ends) for ends in zip(low[:, j], high[:, j], strict=True)))
            for j, t in enumerate(card.targets)
        },
        "frames_valid": int(own_column(table, "valid").sum()),
        "frames_all_valid": int(own_column(table, "all_valid").sum()),
        "frames_drifted": int(own_column(table, "drifted").sum()),
        "group_columns": list(card.split.columns),
        "learnt_from_this_run": learnt_from(card, run),
        "simulated": card.is_simulated or run.manifest.is_simulated,
        "session": sorted(set(sessions_of(run).tolist())),
    }


def _told(card: Card, table: pd.DataFrame, kind: str) -> Values:
    return np.asarray(table[[f"{kind}:{column}" for column in card.columns]].to_numpy(float))


def _findings(
    card: Card, targets: dict[str, Any], tenths: dict[str, list[dict[str, Any]]]
) -> dict[str, list[str]]:
    """Sentences on each target's range, as on the card, by this run's scores; only where there are some."""
    found = {}
    for t in card.targets:
        scored: dict[str, Any] = {"score": ScoreCard(**targets[t.column])}
        if t.over_range is not None:
            parts = tuple(TenthCard(**part) for part in tenths[t.column])
            scored["over_range"] = t.over_range.model_copy(update={"tenths": parts})
        found[t.column] = list(target_findings(t.model_copy(update=scored), card.coverage))
    return {column: sentences for column, sentences in found.items() if sentences}


def _stated_by_others(card: Card, target: TargetCard, run: Run) -> str | None:
    """Instrument of a run's labels, empty where it states none; None where the card's own applies or adds
    nothing.
    """
    own, stated = target.measured_by, run.manifest.instruments.get(target.column)
    if own is None or own.half_width == 0 or learnt_from(card, run):
        return None
    if stated is None:
        return ""
    same = own.instrument == stated.instrument or own.instrument.startswith(f"{stated.instrument}, the least")
    return None if same else stated.instrument


def _instrument_sentence(card: Card, target: TargetCard, run: Run, share: float) -> str:
    own, other = target.measured_by, _stated_by_others(card, target, run)
    assert own is not None
    half = f"±{half_width_text(own.half_width)} {target.unit}"
    return (
        f"{target.quantity.replace('_', ' ')}: scored without the {half} of {own.instrument}, while the "
        f"labels are by {other or 'an instrument that is not stated'}; with it, as readings have it, "
        f"{100 * share:.1f} % of rows lay within their intervals"
    )


def learnt_from(card: Card, run: Run) -> bool:
    """Return whether a calibration was trained on this run, or has set its intervals by it."""
    return run.hash in _recordings(card)


def _recordings(card: Card) -> dict[str, str]:
    return {one.hash: one.run_id for one in card.runs}


def same_session(estimator: Estimator, run: Run, found: LearntFrames | None = None) -> str:
    """Return why a run tests no day other than those trained on; empty where it is another session.

    Sessions are compared by name where the run labels them, and frames with those that the guard keeps.
    """
    card = estimator.card
    if learnt_from(card, run):
        return "it is a run that the calibration has learnt from"
    parts = run.runs if isinstance(run, JoinedRun) else (run,)
    if any(part.hash in _recordings(card) for part in parts):
        return "a part of it is a run that the calibration has learnt from"
    if why := (found or learnt_frames(estimator, run)).why:
        return why
    if {part.manifest.run_id for part in parts} & set(_recordings(card).values()):
        return "it is another copy of a recording that the calibration has learnt from"
    known = set(card.sessions.names) if card.sessions and card.sessions.column == SESSION else set()
    if card.interval_reset:
        known.add(card.interval_reset.session)
    both = sorted(known & set(sessions_of(run).tolist())) if SESSION in run.manifest.labels else []
    return f"session {', '.join(both)} is one that the calibration has learnt from" if both else ""


def learnt_frames(estimator: Estimator, run: Run) -> LearntFrames:
    """Return the overlap of a run's touch frames with the training data."""
    touched = np.setdiff1d(np.arange(len(run)), _untouched_rows(estimator.card, run.labels))
    return find_learnt_frames(estimator, run, touched)


MAX_INSIDE = 0.05  # ratio of labels in the calibrated range up to which a run does not test it


def labels_outside(card: Card, true: Values) -> dict[str, str]:
    """Return sentences on targets whose labels ``[n t]`` lie outside the calibrated range, by column."""
    found = {}
    for target, labels in zip(card.targets, true.T, strict=True):
        room = 0.05 * (target.greatest - target.least)
        inside = (labels >= target.least - room) & (labels <= target.greatest + room)
        if target.circular is None and inside.mean() <= MAX_INSIDE:
            found[target.column] = (
                f"labels of {target.column} run from {labels.min():.4g} to {labels.max():.4g} {target.unit} "
                f"and lie outside what was calibrated ({target.least:.4g} to {target.greatest:.4g} "
                f"{target.unit}): check their unit; these scores say nothing of the model"
            )
    return found


MAX_LAG, SHIFT_GAIN, MIN_SHIFTED_ROWS = 5, 0.5, 60  # lags tried; squared-error ratio of a shift; least rows


def shifted_labels(card: Card, true: Values, table: pd.DataFrame) -> list[str]:
    """Return a sentence if estimates fit the labels ``[n t]`` of other rows much better."""
    for j, target in enumerate(card.targets):
        estimate, label = table[f"estimate:{target.column}"].to_numpy(float), true[:, j]
        if target.circular is not None or len(label) < MIN_SHIFTED_ROWS or not np.ptp(label) > 0:
            continue
        middle = np.arange(MAX_LAG, len(label) - MAX_LAG)
        middle = middle[np.isfinite(estimate[middle])]
        if not len(middle):
            continue
        lags = range(-MAX_LAG, MAX_LAG + 1)
        errors = {lag: float(np.mean((estimate[middle] - label[middle + lag]) ** 2)) for lag in lags}
        best = min(errors, key=lambda lag: errors[lag])
        if best and errors[best] < SHIFT_GAIN * min(errors[0], float(np.var(label))):
            beside = f"row i {'+' if best > 0 else '-'} {abs(best)}"
            share = 100 * errors[best] / errors[0]
            text = (
                f"labels and images look shifted against each other: the estimate of image i fits "
                f"{target.column} of {beside} with {share:.0f} % of the squared error of its own row; check "
                "the order before you trust these scores"
            )
            return [text]
    return []
