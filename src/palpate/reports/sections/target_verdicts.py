"""What a target's scores mean, in sentences: the answer that stands first, and the verdict by the figure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from palpate.calibration.coverage.range_scores import failing, target_findings
from palpate.calibration.sessions import EvaluationRecord
from palpate.core import rounded
from palpate.estimators.findings import SessionsCard
from palpate.estimators.model_card import Card, ScoreCard, TargetCard
from palpate.estimators.reference_uncertainty import too_unsure, with_reference
from palpate.reports.calibration_figures import interval_ends, target_columns
from palpate.reports.terminal_text import mean_error_half_width, percent, width_text

MIN_TOLD = 0.7  # lower bound of the coverage's interval, from which groups are enough to judge it


def others(evaluations: Sequence[EvaluationRecord]) -> tuple[EvaluationRecord, ...]:
    """Return evaluations on sessions that were not trained on."""
    return tuple(one for one in evaluations if one.of_another_session)


def fails(card: Card, target: TargetCard, evaluations: Sequence[EvaluationRecord]) -> bool:
    """Return whether a target's intervals cover less than promised, over all rows, a part, or elsewhere."""
    scores = [target.score, *(found.targets[target.column] for found in others(evaluations))]
    return (
        any(one.coverage_90_high < card.coverage for one in scores)
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


def answer(card: Card, target: TargetCard, groups: int, tested: str) -> str:
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
    return f"{name}: {typical} {s.unit} typical; {held} {_where(target)}; {tested}"


def _where(target: TargetCard) -> str:
    s = target.score
    if target.period is not None and target.greatest - target.least >= target.period:
        return f"all the way round ({target.period:g} {s.unit})"
    return f"from {rounded(target.least, s.half_width)} to {rounded(target.greatest, s.half_width)} {s.unit}"


def _held(s: ScoreCard, coverage: float) -> str:
    share = percent(s.coverage_90, s.coverage_90_low, s.coverage_90_high)
    return f"{'only ' if s.coverage_90_high < coverage else ''}{share} %"


def verdict(target: TargetCard, groups: int | None = None) -> str:
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
        f"{covered} % of rows (95 % interval {low} to {high} %), {_promise(target)}."
    )


def _times(s: ScoreCard) -> str:
    return f", {s.mean_mae / s.mae:.1f} times less than always saying the mean" if s.mae > 0 else ""


def _promise(target: TargetCard) -> str:
    s = target.score
    if s.coverage_90_high < 0.9:
        return "less often than they promise"
    if s.coverage_90_low <= MIN_TOLD:
        return "which so few groups cannot judge"
    if target.over_range is not None and failing(target.over_range.tenths):
        return "but not over the whole range"
    if s.coverage_90_low > 0.9:
        return "more often than they promise: they are wide"
    return "as promised over all rows"


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
