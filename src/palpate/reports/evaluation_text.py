"""Evaluations and classes in words: refused frames, untold targets, valid readings, confusion tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from palpate.calibration.sessions import EvaluationRecord
from palpate.estimators.class_sets import ClassCard, ClassCoverageCard, ClassScoreCard
from palpate.estimators.findings import ValidScoreCard
from palpate.estimators.model_card import Card
from palpate.recordings import Manifest
from palpate.reports.terminal_text import percent


def frames_text(card: Card, scored: int, valid: int, untold: Mapping[str, int], all_valid: int) -> str:
    """Return the sentence on the frames of an evaluation; arguments as of `EvaluationRecord`."""
    judged = f"{valid} of {scored} frames tell something and are refused by neither guard nor range rule"
    unread = [_name(t.quantity) for t in card.targets if t.is_never_valid]
    seldom = [
        f"{_name(t.quantity)} in {untold[t.column]}"
        for t in card.targets
        if untold[t.column] and not t.is_never_valid
    ]
    if not unread and not seldom and valid == all_valid:
        return f"{valid} of {scored} frames gave valid readings throughout"
    told = f"not told is {', '.join(seldom)} of all frames" if seldom else ""
    never = f"this calibration does not read {', '.join(unread)}" if unread else ""
    of_what = "of all that it reads" if unread else "throughout"
    return "; ".join(filter(None, [judged, told, never, f"{all_valid} gave valid readings {of_what}"]))


def frames_of(card: Card, found: EvaluationRecord) -> str:
    """Return the sentence on the frames of a kept evaluation."""
    return frames_text(
        card, found.frames_scored, found.frames_valid, found.frames_untold, found.frames_all_valid
    )


def valid_readings_text(card: Card, found: Mapping[str, ValidScoreCard]) -> list[str]:
    """Return the sentence on valid readings alone: their number and coverage by target."""
    told = [f"{_name(t.quantity)} {_covered(found[t.column])}" for t in card.targets if not t.is_never_valid]
    return [f"covered, valid readings only: {', '.join(told)}"] if told else []


def _covered(one: ValidScoreCard) -> str:
    if one.covered is None or one.low is None or one.high is None:
        return "none was valid"
    share, low, high = (percent(part, one.low, one.high) for part in (one.covered, one.low, one.high))
    return f"{share} % of {one.n} ({low} to {high} %)"


def _name(quantity: str) -> str:
    return quantity.replace("_", " ")


def simulated_text(card: Card, run: Manifest | None) -> str:
    """Return whether a calibration's or a run's frames were simulated, in words; empty where both were
    measured.
    """
    virtual = {"the calibration": card.is_simulated, "the run": run is not None and run.is_simulated}
    named = [name for name, simulated in virtual.items() if simulated]
    if not named:
        return ""
    are = "is" if len(named) == 1 else "are"
    return f"simulated, not measured: {' and '.join(named)} {are} of a virtual sensor"


def day_text(scores: Mapping[str, Any]) -> str:
    """Return whether scores are of another day than the training data, in words."""
    if scores["learnt_from_this_run"]:
        return "this is the run it learnt from: these scores say nothing about new presses"
    if scores["same_session"]:
        return f"no other day: {scores['same_session']}"
    return f"another session than was learnt from, by its name: {', '.join(scores['session'])}"


def class_lines(card: ClassCard, score: ClassScoreCard, coverage: float) -> list[str]:
    """Return a sentence and a table on one column of classes.

    Args:
        score: its own, or that of another run.
    """
    widths = [max(len(name), 5) for name in card.names]
    head = max(len("true class"), *map(len, card.names))
    columns = "  ".join(name.rjust(width) for name, width in zip(card.names, widths, strict=True))
    lines = [
        f"{card.column}: {classes_told(card, score)}",
        f"{'true class':{head}}  {columns}  in its set ({100 * coverage:g} % asked)",
    ]
    for name, counts, covered in zip(card.names, score.confusion, score.coverage, strict=True):
        cells = "  ".join(f"{count:{width}d}" for count, width in zip(counts, widths, strict=True))
        lines.append(f"{name:{head}}  {cells}  {class_covered(covered)}")
    return lines


def classes_told(card: ClassCard, score: ClassScoreCard) -> str:
    """Return accuracy, baseline, and size of the sets, in a sentence."""
    return (
        f"{100 * score.accuracy:.1f} % of {score.n} rows right (95 % interval "
        f"{100 * score.accuracy_low:.1f} to {100 * score.accuracy_high:.1f} %), where always saying "
        f"{card.most_frequent} gives {100 * score.baseline:.1f} %; sets hold {score.set_size:.2f} of "
        f"{len(card.names)} classes on average, all in {100 * score.whole:.1f} % and "
        f"none in {100 * score.empty:.1f} % of rows"
    )


def class_covered(one: ClassCoverageCard) -> str:
    """Return the ratio of a class's rows whose set contained it, with its interval."""
    if not one.rows:
        return "no rows"
    return (
        f"{100 * one.covered / one.rows:.1f} % ({100 * one.low:.1f} to {100 * one.high:.1f} %; "
        f"{one.groups} groups)"
    )


def class_answer(row: pd.Series, card: Card) -> str:
    """Return the predicted and true classes of a row."""
    return "; ".join(
        f"{one.column} {row[f'estimate:{one.column}']}, truth {row[one.column]}" for one in card.classes or ()
    )
