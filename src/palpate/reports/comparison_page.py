"""Two calibrations side by side: what each says of a target, and whether the two can be compared at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.calibration.certificate import read_predictions
from palpate.calibration.coverage.grouped_rates import (
    MIN_GROUPS_OF_MEAN,
    counted_text,
    grouped_mean_interval,
    held_out_groups,
)
from palpate.calibration.sessions import EvaluationRecord
from palpate.core import CertificateError, InputError, PathText, new_file, rounded
from palpate.core.reading import Refusal
from palpate.estimators.certified import check_files, read_card
from palpate.estimators.model_card import Card, TargetCard
from palpate.recordings.label_tables import own_column
from palpate.reports.calibration_figures import errors_of
from palpate.reports.certificate_page import filled_template
from palpate.reports.evaluation_text import frames_of
from palpate.reports.sections import ReportedCalibration, found_elsewhere, not_relied_on, tested_text
from palpate.reports.terminal_text import mean_error_half_width, percent, width_text


@dataclass(frozen=True, slots=True)
class ErrorDifference:
    """Second less first mean absolute error on the same held-out rows.

    Attributes:
        counted_by: kind of group, see `calibration.coverage.grouped_rates.held_out_groups`.
        difference: [the target's unit].
        low, high: its 95 % interval over groups; None for too few.
    """

    rows: int
    groups: int
    difference: float
    low: float | None
    high: float | None
    counted_by: str


@dataclass(frozen=True, slots=True)
class ComparedTarget:
    """One target of two calibrations.

    Attributes:
        first, second: their cards.
        paired: their errors on the rows that both held out; None where these differ.
    """

    column: str
    first: TargetCard
    second: TargetCard
    paired: ErrorDifference | None


@dataclass(frozen=True, slots=True)
class CalibrationComparison:
    """Two calibrations, target by target.

    Attributes:
        only: columns that only one has, of each.
        obstacles: why their scores cannot be compared; empty where they can.
        evaluations: kept next to each card, the earliest first.
        left_out: faults of files next to the cards that are no evaluation of theirs.
    """

    cards: tuple[Card, Card]
    targets: tuple[ComparedTarget, ...]
    only: tuple[tuple[str, ...], tuple[str, ...]]
    obstacles: tuple[Refusal, ...]
    evaluations: tuple[tuple[EvaluationRecord, ...], tuple[EvaluationRecord, ...]]
    left_out: tuple[str, ...] = ()

    @property
    def shared_runs(self) -> tuple[tuple[EvaluationRecord, EvaluationRecord], ...]:
        """Evaluations of both on one and the same run, the latest of each."""
        latest = [{str(one.run["hash"]): one for one in kept} for kept in self.evaluations]
        return tuple((latest[0][run], latest[1][run]) for run in latest[0] if run in latest[1])

    @property
    def warnings(self) -> tuple[str, ...]:
        """Which scores not to rely on, a sentence each: a confound makes errors small, too."""
        failed = tuple(
            f"The audit of {card.id} failed: do not rely on its scores of {', '.join(failed)}."
            for card in self.cards
            if (failed := [t.column for t in card.targets if not_relied_on(card, t)])
        )
        return failed + tuple(f"Left out: {why}." for why in self.left_out)

    def tested(self, column: str) -> tuple[str, str]:
        """On which days each was tested, and where in its range it did not keep its promise there."""
        first, second = (
            "; ".join([tested_text(card, target, kept), *found_elsewhere(target, kept)])
            for card, kept in zip(self.cards, self.evaluations, strict=True)
            for target in card.targets
            if target.column == column
        )
        return first, second

    def to_dict(self) -> dict[str, Any]:
        return {
            "calibrations": [card.id for card in self.cards],
            "simulated": [card.is_simulated for card in self.cards],
            "comparable": not self.obstacles,
            "obstacles": [one._asdict() for one in self.obstacles],
            "warnings": list(self.warnings),
            "only": [list(columns) for columns in self.only],
            "sessions": [
                None if card.sessions is None else card.sessions.model_dump(mode="json")
                for card in self.cards
            ],
            "evaluations": [[one.model_dump(mode="json") for one in kept] for kept in self.evaluations],
            "targets": {
                one.column: {
                    "unit": one.first.unit,
                    "range": [[t.least, t.greatest] for t in (one.first, one.second)],
                    "mae": [t.score.mae for t in (one.first, one.second)],
                    "half_width": [t.score.half_width for t in (one.first, one.second)],
                    "coverage_90": [t.score.coverage_90 for t in (one.first, one.second)],
                    "tested": list(self.tested(one.column)),
                    "paired": one.paired
                    and {
                        "rows": one.paired.rows,
                        "groups": one.paired.groups,
                        "counted_by": one.paired.counted_by,
                        "mae_difference": one.paired.difference,
                        "low": one.paired.low,
                        "high": one.paired.high,
                    },
                }
                for one in self.targets
            },
        }


def compare_calibrations(first: PathText, second: PathText) -> CalibrationComparison:
    """Compare two calibrations."""
    folders = Path(first), Path(second)
    cards = read_card(folders[0]), read_card(folders[1])
    for folder, card in zip(folders, cards, strict=True):
        check_files(folder, card)
    both = [column for column in cards[0].columns if column in cards[1].columns]
    if not both:
        raise InputError(
            f"{first} reads {', '.join(cards[0].columns)} and {second} {', '.join(cards[1].columns)}: no "
            f"target in common{_other_units(cards)}; compare calibrations that read the same column",
            code="no-common-target",
        )
    tables = tuple(_by_frame(folder, card) for folder, card in zip(folders, cards, strict=True))
    obstacles = _obstacles(cards, tables, both)
    only = tuple(tuple(c for c in card.columns if c not in both) for card in cards)
    reports = tuple(ReportedCalibration(*each) for each in zip(folders, cards, strict=True))
    targets = tuple(_compared(column, reports, tables, paired=not obstacles) for column in both)
    kept = (reports[0].evaluations, reports[1].evaluations)
    left_out = reports[0].refused_evaluations + reports[1].refused_evaluations
    return CalibrationComparison(cards, targets, (only[0], only[1]), obstacles, kept, left_out)


def _other_units(cards: tuple[Card, Card]) -> str:
    """Quantities that both have, each in a unit of its own, in words; empty where there is none."""
    units = [{t.quantity: t.unit for t in card.targets} for card in cards]
    both = [f"{name} is in {units[0][name]} and in {units[1][name]}" for name in units[0] if name in units[1]]
    return f" ({', '.join(both)})" if both else ""


def _by_frame(folder: Path, card: Card) -> pd.DataFrame:
    table = read_predictions(folder, card)
    row = own_column(table, "row")
    if row.duplicated().any():
        raise CertificateError(f"{folder} has more than one prediction for some rows; calibrate again")
    return table.set_index(pd.Index(row.to_numpy(int)))


def _obstacles(
    cards: tuple[Card, Card], tables: tuple[pd.DataFrame, ...], columns: list[str]
) -> tuple[Refusal, ...]:
    a, b = cards
    if a.run.hash != b.run.hash:
        elsewhere = Refusal(
            "recordings-differ",
            f"They were scored on different recordings, {a.run.run_id} and {b.run.run_id}: a smaller error "
            "may be an easier recording. Calibrate both on one, or score both on a third run.",
        )
        return (elsewhere,)
    found = [
        Refusal(
            "period-differs",
            f"{column} is periodic in one and a plain number in the other: their errors are not of one kind. "
            "Calibrate both with or without --circular.",
        )
        for column in columns
        if len({t.period for card in cards for t in card.targets if t.column == column}) > 1
    ]
    if a.split.kind != b.split.kind:
        why = (
            f"Their rows were held out in different ways, {a.split.kind} and {b.split.kind}: the one that "
            "keeps more apart has the harder test. Calibrate both with the same --split."
        )
        found.append(Refusal("split-differs", why))
    if set(tables[0].index) != set(tables[1].index):
        common = len(set(tables[0].index) & set(tables[1].index))
        why = (
            f"They were scored on different rows: {len(tables[0])} and {len(tables[1])}, of which {common} "
            "are the same. Calibrate both with the same --split, --folds, --scored-folds and --seed."
        )
        found.append(Refusal("rows-differ", why))
    elif not _same_folds(tables):
        why = (
            "The same rows were held out, but together with others: the folds differ, and so does what each "
            "was trained on. Calibrate both with the same --folds and --seed."
        )
        found.append(Refusal("folds-differ", why))
    elif not _alike([table[columns] for table in tables]):
        why = "Their rows hold different labels for the same frames; look at how each was made."
        found.append(Refusal("labels-differ", why))
    return tuple(found)


def _same_folds(tables: tuple[pd.DataFrame, ...]) -> bool:
    return _alike([own_column(table, "held_out_in_fold") for table in tables])


def _alike(two: Sequence[pd.DataFrame | pd.Series[Any]]) -> bool:
    return bool(np.array_equal(two[0].sort_index().to_numpy(), two[1].sort_index().to_numpy()))


def _compared(
    column: str, reports: tuple[ReportedCalibration, ...], tables: tuple[pd.DataFrame, ...], *, paired: bool
) -> ComparedTarget:
    first, second = (next(t for t in report.targets if t.column == column) for report in reports)
    difference = _difference(first, reports[0].card, tables) if paired else None
    return ComparedTarget(column, first, second, difference)


def _difference(target: TargetCard, card: Card, tables: tuple[pd.DataFrame, ...]) -> ErrorDifference:
    sorted_ = [table.sort_index() for table in tables]
    names = (target.column, f"estimate:{target.column}")
    errors = [np.abs(errors_of(target, *(t[name].to_numpy(float) for name in names))) for t in sorted_]
    change, (groups, by) = errors[1] - errors[0], held_out_groups(card, sorted_[0])
    low, high = grouped_mean_interval(change, groups) or (None, None)
    return ErrorDifference(len(change), len(np.unique(groups)), float(change.mean()), low, high, by)


def judgement(one: ComparedTarget) -> str:
    """Return which calibration reads a target better, in a sentence."""
    name, pair = one.first.quantity.replace("_", " "), one.paired
    if pair is None:
        return f"{name}: not comparable, see above."
    if one.first.score.says_nothing and one.second.score.says_nothing:
        return f"{name}: neither reads it, both are no better than always saying the mean."
    if not one.first.is_read and not one.second.is_read:
        return f"{name}: neither reads it: each card says why."
    counted = counted_text(pair.groups, pair.counted_by)
    if pair.low is None or pair.high is None:
        why = f"{counted}; {MIN_GROUPS_OF_MEAN} or more are needed"
        return f"{name}: these rows cannot tell which errs less ({why})."
    width, unit = (pair.high - pair.low) / 2, one.first.unit
    if pair.low <= 0 <= pair.high:
        ends = f"{rounded(pair.low, width)} to {rounded(pair.high, width)} {unit}"
        interval = f"95 % interval of the difference {ends}, {counted}"
        return f"{name}: these rows do not tell which errs less ({interval})."
    better, sign = ("second", -1.0) if pair.difference < 0 else ("first", 1.0)
    low, high = sorted((sign * pair.low, sign * pair.high))
    interval = f"95 % interval {rounded(low, width)} to {rounded(high, width)} {unit}, {counted}"
    by = rounded(sign * pair.difference, width)
    return f"{name}: the {better} errs less, by {by} {unit} on average ({interval})."


def headline(comparison: CalibrationComparison, one: ComparedTarget) -> str:
    """Return what decides between the two: held-out errors, unless an audit failed."""
    pairs = zip(comparison.cards, (one.first, one.second), strict=True)
    failed = [card.id for card, target in pairs if not_relied_on(card, target)]
    if not failed:
        return judgement(one)
    name = one.first.quantity.replace("_", " ")
    instead = (
        "see what both gave on the same recording, below"
        if comparison.shared_runs
        else "run `palpate evaluate` of both on another session"
    )
    return f"{name}: held-out errors cannot decide, as the audit of {' and '.join(failed)} failed; {instead}."


def comparison_text(comparison: CalibrationComparison) -> str:
    """Return the comparison for a terminal."""
    cards = comparison.cards
    only = zip(cards, comparison.only, strict=True)
    lines = [
        "calibrations " + " and ".join(f"{card.id} ({_told(card)})" for card in cards),
        *(f"NOT COMPARABLE: {obstacle.why}" for obstacle in comparison.obstacles),
        *comparison.warnings,
        *_table([HEAD, *(_cells(one, cards) for one in comparison.targets)]),
        *(headline(comparison, one) for one in comparison.targets if one.paired),
        *_days(comparison),
        *(f"only {card.id} reads {', '.join(columns)}" for card, columns in only if columns),
    ]
    return "\n".join(lines)


def _told(card: Card) -> str:
    return f"{card.model_name}; simulated, not measured" if card.is_simulated else card.model_name


def _days(comparison: CalibrationComparison) -> list[str]:
    lines = []
    for k, card in enumerate(comparison.cards):
        said = {one.column: comparison.tested(one.column)[k] for one in comparison.targets}
        if len(set(said.values())) == 1:
            lines.append(f"{card.id}: {next(iter(said.values()))}")
        else:
            lines += [f"{card.id}, {column}: {text}" for column, text in said.items()]
    return lines


HEAD = ("target", "unit", "MAE", "", "90 %", "", "covered", "")


def _cells(one: ComparedTarget, cards: tuple[Card, Card]) -> tuple[str, ...]:
    scores = (one.first.score, one.second.score)
    pairs = zip(scores, cards, strict=True)
    maes = [rounded(s.mae, mean_error_half_width(s, card.split.groups)) for s, card in pairs]
    halves = [width_text(t.score.half_width, t.period) for t in (one.first, one.second)]
    shares = [f"{percent(s.coverage_90, s.coverage_90_low, s.coverage_90_high)} %" for s in scores]
    return (one.column, one.first.unit, *maes, *halves, *shares)


def _table(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if i < 2 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def write_comparison(comparison: CalibrationComparison, out: PathText) -> Path:
    """Write a comparison as one HTML page."""
    text = filled_template(
        "comparison.html",
        comparison=comparison,
        judgements={one.column: headline(comparison, one) for one in comparison.targets},
        frames=[
            [frames_of(card, one) for card, one in zip(comparison.cards, pair, strict=True)]
            for pair in comparison.shared_runs
        ],
        sessions=[_sessions_text(card) for card in comparison.cards],
        confounds=[_confounds_text(card) for card in comparison.cards],
    )
    out = Path(out)
    with new_file(out) as path:
        path.write_text(text, encoding="utf-8")
    return out


def _sessions_text(card: Card) -> str:
    if card.sessions is None:
        return "not told apart"
    many = len(card.sessions.names)
    return "1" if many == 1 else f"{many}, of which {card.sessions.held_out} were held out whole"


def _confounds_text(card: Card) -> str:
    if card.confounds is None:
        return "not made"
    if card.confounds.failed:
        return "failed"
    found = {finding.severity for finding in card.confounds.findings}
    return next((severity for severity in ("warns", "notes") if severity in found), "nothing found")
