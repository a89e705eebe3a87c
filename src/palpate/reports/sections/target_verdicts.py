"""What a target's scores mean, in sentences: the answer that stands first, and the verdict by the figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from palpate.calibration.coverage.grouped_rates import grouped_coverage_interval
from palpate.calibration.coverage.range_scores import target_findings
from palpate.calibration.sessions import EvaluationRecord
from palpate.core import rounded
from palpate.estimators.findings import SessionsCard
from palpate.estimators.model_card import Card, ScoreCard, TargetCard
from palpate.estimators.reference_uncertainty import too_unsure, with_reference
from palpate.reports.calibration_figures import errors_of, held_rows, interval_ends, target_columns
from palpate.reports.terminal_text import mean_error_half_width, percent, width_text

OUTER_SHARE = 0.1  # ratio of the scored rows in an outer range
MIN_OUTER_ROWS = 20  # with fewer, rates of 90 and 70 % are indistinguishable
MIN_TOLD = 0.7  # lower bound for the interval of a range's coverage


@dataclass(frozen=True, slots=True)
class OuterRange:
    """Held-out rows at one end of a target's range.

    Attributes:
        where: range in words with its unit, e.g. "above 5.5 mm".
        n, covered: rows, and those whose interval covered the truth.
        low, high: 95 % interval of the covered ratio over groups.
        bias: mean signed error [the target's unit].
    """

    where: str
    n: int
    covered: int
    low: float
    high: float
    bias: float


def outer_ranges(target: TargetCard, table: pd.DataFrame, groups: np.ndarray) -> tuple[OuterRange, ...]:
    """Return the lowest and highest tenth of a target's scored rows by the truth; none where rows are few.

    Args:
        table: held-out predictions, one row per frame.
        groups: group of each row ``[n]``.
    """
    true, estimate, _ = target_columns(target, table)
    error = errors_of(target, true, estimate)
    inside = held_rows(target, table)
    count = max(int(OUTER_SHARE * len(true)), MIN_OUTER_ROWS)
    if target.circular is not None or 2 * count > len(true):
        return ()
    lowest, highest = np.sort(true)[[count - 1, -count]]
    ranges = []
    # Rows that share the limit's truth belong to the range too, as with a few dead weights.
    for word, limit, rows in (("below", lowest, true <= lowest), ("above", highest, true >= highest)):
        low, high = grouped_coverage_interval(inside[rows], groups[rows])
        at = rounded(limit, target.score.half_width)
        where, covered = f"{word} {at} {target.unit}", int(inside[rows].sum())
        ranges.append(OuterRange(where, int(rows.sum()), covered, low, high, float(error[rows].mean())))
    return tuple(ranges)


def others(evaluations: Sequence[EvaluationRecord]) -> tuple[EvaluationRecord, ...]:
    """Return evaluations on sessions that were not trained on."""
    return tuple(one for one in evaluations if one.of_another_session)


def fails(
    card: Card, target: TargetCard, ends: Sequence[OuterRange], evaluations: Sequence[EvaluationRecord]
) -> bool:
    """Return whether a target's intervals cover less than promised, over all rows, a part, or elsewhere."""
    scores = [target.score, *(found.targets[target.column] for found in others(evaluations))]
    return (
        any(one.coverage_90_high < card.coverage for one in scores)
        or any(end.high < card.coverage for end in ends)
        or bool(target_findings(target, card.coverage))
        or bool(found_elsewhere(target, evaluations))
    )


def found_elsewhere(target: TargetCard, evaluations: Sequence[EvaluationRecord]) -> tuple[str, ...]:
    """Return where a target did not keep its promise on other sessions, a sentence each."""
    name = target.quantity.replace("_", " ")
    return tuple(
        f"on {', '.join(one.session)} {sentence.removeprefix(f'{name}: ')}"
        for one in others(evaluations)
        for sentence in one.findings_of(target.column)
    )


def answer(card: Card, target: TargetCard, ends: Sequence[OuterRange], groups: int, tested: str) -> str:
    """Return how well a target is read, where, and on which day, in one sentence.

    Args:
        tested: other recordings it was tested on, see `tested_text`.
    """
    s, name = target.score, target.quantity.replace("_", " ")
    # Two digits are enough of a sentence, and fewer where the groups bear out no more.
    typical = rounded(s.mae, max(s.mae, mean_error_half_width(s, groups)))
    wide = width_text(s.half_width, target.period, s.unit)
    if s.says_nothing:
        return (
            f"{name}: not read by this model: {typical} {s.unit} off on average, no better than always "
            "saying the mean"
        )
    if why := too_unsure(target):
        return f"{name}: not read by this model: {why}"
    held = f"its own intervals, {wide} on average, held {_held(s, card.coverage)}"
    but = _but(s, ends, card.coverage)
    return f"{name}: {typical} {s.unit} typical; {held} {_where(target)}{but}; {tested}"


def _where(target: TargetCard) -> str:
    s = target.score
    if target.period is not None and target.greatest - target.least >= target.period:
        return f"all the way round ({target.period:g} {s.unit})"
    return f"from {rounded(target.least, s.half_width)} to {rounded(target.greatest, s.half_width)} {s.unit}"


def _held(s: ScoreCard, coverage: float) -> str:
    share = percent(s.coverage_90, s.coverage_90_low, s.coverage_90_high)
    return f"{'only ' if s.coverage_90_high < coverage else ''}{share} %"


def _but(s: ScoreCard, ends: Sequence[OuterRange], coverage: float) -> str:
    failed = [end for end in ends if end.high < coverage]
    if not failed or s.coverage_90_high < coverage:
        return ""
    named = [f"{end.where} only {end.covered} of {end.n}" for end in failed]
    return ", but " + " and ".join(named)


def verdict(target: TargetCard, ends: Sequence[OuterRange] = (), groups: int | None = None) -> str:
    """Return the meaning of a target's scores, in one sentence.

    Args:
        groups: number of scored groups; None counts every row as one.
    """
    s = target.score
    off = mean_error_half_width(s, s.n if groups is None else groups)
    mae, mean = rounded(s.mae, off), rounded(s.mean_mae, off)
    if s.says_nothing:
        return (
            f"This model does not read {target.quantity.replace('_', ' ')} from these images: the error, "
            f"{mae} {s.unit}, is no better than always saying the mean ({mean} {s.unit}). "
            "Do not use this reading; another model may read it."
        )
    ends_of = (s.coverage_90_low, s.coverage_90_high)
    covered, low, high = (percent(share, *ends_of) for share in (s.coverage_90, *ends_of))
    return (
        f"Off by {mae} {s.unit} on average{_times(s)}. The 90 % intervals are "
        f"{width_text(s.half_width, target.period, s.unit)} wide on average and covered the truth in "
        f"{covered} % of rows (95 % interval {low} to {high} %), {_promise(target, ends)}."
    )


def _times(s: ScoreCard) -> str:
    return f", {s.mean_mae / s.mae:.1f} times less than always saying the mean" if s.mae > 0 else ""


def _promise(target: TargetCard, ends: Sequence[OuterRange]) -> str:
    s = target.score
    failed = [end for end in ends if end.high < 0.9]
    unsure = [end for end in ends if end.low <= MIN_TOLD and end not in failed]
    named = "; ".join(
        f"{end.where} only {_covered(end)}, with a mean error of {_signed(end.bias, s.half_width)} {s.unit}"
        for end in failed
    )
    told = f"; too few rows or groups to judge {', '.join(f'{e.where}: {_covered(e)}' for e in unsure)}"
    more = told if unsure else ""
    if s.coverage_90_high < 0.9:
        return f"less often than they promise{'; ' if named else ''}{named}{more}"
    if s.coverage_90_low <= MIN_TOLD:
        return "which so few groups cannot judge"
    if failed:
        return f"but not over the whole range: {named}{more}"
    if s.coverage_90_low > 0.9:
        return f"more often than they promise: they are wide{more}"
    if target.circular is not None:
        return "as promised over all rows"
    if not ends:
        return "as promised over all rows; there are too few to judge the ends of the range"
    return f"as promised over all rows{more}" if unsure else "as promised, at both ends of the range too"


def _covered(end: OuterRange) -> str:
    low, high = (percent(share, end.low, end.high) for share in (end.low, end.high))
    return f"{end.covered} of {end.n} (95 % interval {low} to {high} %)"


def _signed(value: float, half_width: float) -> str:
    shown = rounded(value, half_width)
    return shown if shown.startswith("-") or float(shown) == 0 else f"+{shown}"


def reading_half_width(target: TargetCard, table: pd.DataFrame) -> float | None:
    """Return the mean half-width of intervals that contain the labels' instrument too; None without one."""
    if target.measured_by is None or target.measured_by.half_width == 0:
        return None
    value = target_columns(target, table)[1]
    low, high = with_reference(target, value, *interval_ends(target, table))
    return float(np.mean(high - low) / 2)


NOT_TESTED = "not yet tested on another day"
MIN_VALID = 0.9  # ratio of valid frames of another recording, below which the answer states it


def tested_text(card: Card, target: TargetCard, evaluations: Sequence[EvaluationRecord]) -> str:
    """Return on what else a target was tested, and whether its intervals covered the truth there."""
    found = others(evaluations)
    parts = [_held_out(card), _reset(card), _elsewhere(card, target, found)]
    sessions = card.sessions is not None and card.sessions.held_out > 1 and card.sessions.column == "session"
    untested = "" if sessions or found else NOT_TESTED
    return "; ".join(part for part in (*parts, untested) if part)


COPIES = {"session": "sessions", "copy": "copies", "sensor": "sensors"}


def _held_out(card: Card) -> str:
    if card.sessions is None or card.sessions.held_out < 2 or card.interval_reset is not None:
        return ""
    many = f"tested on {card.sessions.held_out} {COPIES.get(card.sessions.column, card.sessions.column)}"
    return f"{many}, each held out whole{_guarantee(card.sessions, card.coverage)}"


def _guarantee(sessions: SessionsCard, coverage: float) -> str:
    if sessions.rule != "parametric":
        return ""
    enough = math.ceil(coverage / (1 - coverage) - 1e-9)
    return f" (no guarantee for another: that takes {enough})"


def _reset(card: Card) -> str:
    reset = card.interval_reset
    if reset is None:
        return ""
    many = "rows" if reset.groups == reset.rows else "presses"
    return f"intervals set by {reset.groups} {many} of session {reset.session}"


def _elsewhere(card: Card, target: TargetCard, found: Sequence[EvaluationRecord]) -> str:
    if not found:
        return ""
    worst = min((one.targets[target.column] for one in found), key=lambda score: score.coverage_90)
    share = percent(worst.coverage_90, worst.coverage_90_low, worst.coverage_90_high)
    many = "another session" if len(found) == 1 else f"{len(found)} recordings of other sessions"
    least = "" if len(found) == 1 else "at least "
    kept = "" if worst.coverage_90_high >= card.coverage else ", less than promised"
    return f"tested on {many}, where {least}{share} % lay within their intervals{kept}{_refused(found)}"


def _refused(found: Sequence[EvaluationRecord]) -> str:
    valid, frames = sum(one.frames_valid for one in found), sum(one.frames_scored for one in found)
    return "" if valid >= MIN_VALID * frames else f"; only {valid} of its {frames} frames were valid"
