"""Sections of a calibration's page: a function and a template of its name in `templates/certificate`.

A section is left out where its function returns None. `SECTIONS` lists them in the page's order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.calibration.certificate import read_predictions
from palpate.calibration.coverage.counted_groups import held_out_groups, press_column
from palpate.calibration.coverage.grouped_rates import grouped_coverage_interval
from palpate.calibration.coverage.range_scores import target_findings
from palpate.calibration.sessions import EvaluationRecord
from palpate.calibration.sessions.evaluation_record import PREFIX, SUFFIX, in_order, read_evaluation
from palpate.core import CertificateError, interval_text, rounded
from palpate.estimators.findings import Finding
from palpate.estimators.model_card import Card, TargetCard
from palpate.estimators.reading_steps import reading_steps
from palpate.recordings.label_tables import OWN, own_column
from palpate.reports.calibration_figures import (
    errors_of,
    held_rows,
    interval_ends,
    picture,
    surface_columns,
    surface_figure,
    target_panels,
)
from palpate.reports.evaluation_text import class_answer, classes_told
from palpate.reports.sections.evidence_sections import (
    audit,
    choice,
    deciding,
    evaluations,
    instruments,
    robustness,
    sessions,
)
from palpate.reports.sections.target_verdicts import (
    OuterRange,
    answer,
    fails,
    found_elsewhere,
    others,
    outer_ranges,
    reading_half_width,
    tested_text,
    verdict,
)
from palpate.reports.terminal_text import audit_head, not_relied_on, remaining_remedy


@dataclass(frozen=True)
class ReportedCalibration:
    """Calibration folder with its card."""

    folder: Path
    card: Card

    @cached_property
    def table(self) -> pd.DataFrame:
        return read_predictions(self.folder, self.card)

    @cached_property
    def groups(self) -> np.ndarray:
        """``[n]`` number of each row's group."""
        return held_out_groups(self.card, self.table)[0]

    @property
    def scored_groups(self) -> int:
        return len(np.unique(self.groups))

    @cached_property
    def targets(self) -> tuple[TargetCard, ...]:
        """Its targets; with an interval of the coverage that allows for few groups, or rows of one press."""
        if self.scored_groups >= MIN_GROUPS and not self._took_presses_apart:
            return self.card.targets
        return tuple(_judged_by_few(target, self.table, self.groups) for target in self.card.targets)

    @property
    def _took_presses_apart(self) -> bool:
        return self.card.split.kind == "random" and press_column(self.table) is not None

    @cached_property
    def ends(self) -> dict[str, tuple[OuterRange, ...]]:
        return {t.column: outer_ranges(t, self.table, self.groups) for t in self.card.targets}

    @property
    def evaluations(self) -> tuple[EvaluationRecord, ...]:
        """Scores of this very calibration on other recordings, the earliest first."""
        return self._kept[0]

    @property
    def refused_evaluations(self) -> tuple[str, ...]:
        """What is wrong with each file beside the card that looks like an evaluation and is none of its."""
        return self._kept[1]

    @cached_property
    def _kept(self) -> tuple[tuple[EvaluationRecord, ...], tuple[str, ...]]:
        found, refused = [], []
        for path in sorted(self.folder.glob(f"{PREFIX}*{SUFFIX}")):
            try:
                found.append(read_evaluation(path, self.card))
            except CertificateError as e:
                refused.append(str(e).replace(str(path), path.name))  # the page goes to other people
        return in_order(found), tuple(refused)


MIN_GROUPS = 10  # fewer groups: earlier cards stated too narrow coverage intervals


def _judged_by_few(target: TargetCard, table: pd.DataFrame, groups: np.ndarray) -> TargetCard:
    low, high = grouped_coverage_interval(held_rows(target, table), groups)
    ends = {"coverage_90_low": low, "coverage_90_high": high}
    return target.model_copy(update={"score": target.score.model_copy(update=ends)})


Values = dict[str, Any]


def findings(report: ReportedCalibration) -> Values | None:
    """Show the findings of failed audits, before the numbers."""
    card = report.card
    told = [f for f in (card.confounds.findings if card.confounds else ()) if f.severity != "notes"]
    elsewhere = bool(others(report.evaluations))
    remedies: dict[str, list[Finding]] = {}
    for finding in told:
        remedies.setdefault(remaining_remedy(card, finding, elsewhere), []).append(finding)
    sentences = [] if card.split.clean else [f"{one.text}." for one in card.split.findings or ()]
    sentences += [f"{one.text}." for one in (card.sessions.findings if card.sessions else ())]
    if not told and not sentences:
        return None
    failed = not card.split.clean or bool(card.confounds and card.confounds.failed)
    return {"failed": failed, "head": audit_head(card), "remedies": remedies, "sentences": sentences}


def answers(report: ReportedCalibration) -> Values:
    """Show one sentence per target, and on which day it was tested."""
    return {
        "answers": [_answer(report, target) for target in report.targets],
        "vectors": report.card.vectors or (),
        "classes": [
            {
                "text": f"{one.column.replace('_', ' ')}: {classes_told(one, one.score)}",
                "bad": one.score.says_nothing,
            }
            for one in report.card.classes or ()
        ],
        "day": _day(report),
        "untested": _untested(report),
    }


def _answer(report: ReportedCalibration, target: TargetCard) -> dict[str, str]:
    card, ends, name = report.card, report.ends[target.column], target.quantity.replace("_", " ")
    tested = tested_text(card, target, report.evaluations)
    sentences = [answer(card, target, ends, report.scored_groups, tested)]
    if target.is_read:
        sentences += [one.removeprefix(f"{name}: ") for one in target_findings(target, card.coverage)]
        sentences += found_elsewhere(target, report.evaluations)
    elsewhere = [one.instruments for one in others(report.evaluations)]
    sentences += [one[target.column].removeprefix(f"{name}: ") for one in elsewhere if target.column in one]
    joined = reading_half_width(target, report.table)
    if joined is not None and target.measured_by is not None:
        own = rounded(target.measured_by.half_width, joined)
        sentences.append(
            f"readings say ±{rounded(joined, joined)} {target.unit} on average, since they hold the ±{own} "
            f"{target.unit} of what the labels were measured with, too"
        )
    if not_relied_on(card, target):
        sentences.append("do not rely on this: the audit failed, see above")
    bad = not target.is_read or not_relied_on(card, target)
    warned = fails(card, target, ends, report.evaluations)
    return {"text": ". ".join(one[0].upper() + one[1:] for one in sentences[1:]), "first": sentences[0],
            "style": "bad" if bad else "warn" if warned else ""}  # fmt: skip


def _day(report: ReportedCalibration) -> str:
    card = report.card
    if card.interval_reset is not None:
        return card.interval_reset.text
    if card.sessions is None or (card.sessions.held_out < 2 and others(report.evaluations)):
        return ""
    return card.sessions.text


def _untested(report: ReportedCalibration) -> bool:
    return report.card.sessions is None and not others(report.evaluations)


def targets(report: ReportedCalibration) -> Values | None:
    """Show figures of each target, with its verdict and the tenths of its range."""
    if not report.targets:
        return None
    return {
        "targets": [
            {
                "name": target.quantity.replace("_", " "),
                "verdict": verdict(target, report.ends[target.column], report.scored_groups),
                "bad": not target.is_read,
                "findings": target_findings(target, report.card.coverage),
                "panels": target_panels(target, report.table, report.groups),
                "card": target,
                "one_width": target.over_range is not None and target.over_range.by_truth is None,
            }
            for target in report.targets
        ],
        "coverage": report.card.coverage,
    }


def classes(report: ReportedCalibration) -> Values | None:
    """Show confusion and sets of each class column."""
    told = report.card.classes
    return {"classes": told, "coverage": report.card.coverage} if told else None


def surface(report: ReportedCalibration) -> Values | None:
    """Show maps of the error over the skin, where labels state the position."""
    where = surface_columns(report.table)
    if where is None or not report.targets:
        return None
    return {"where": where, "maps": surface_figure(report.card.targets, report.table, where)}


def scores(report: ReportedCalibration) -> Values | None:
    """Show the table of scores."""
    if not report.targets:
        return None
    few = report.scored_groups < MIN_GROUPS
    counted = {"targets": report.targets, "groups": report.scored_groups}
    return {"card": report.card, "few": few} | counted


def split(report: ReportedCalibration) -> Values:
    """Show how rows were held out."""
    return {"split": report.card.split, "reset": report.card.interval_reset}


def worst(report: ReportedCalibration) -> Values | None:
    """Show picture, name, and estimate of each frame with the largest errors."""
    frames = []
    paths = report.folder.glob("worst-*.png")
    for number in sorted(int(path.stem.split("-")[1]) for path in paths):
        row = report.table[own_column(report.table, "row") == number].iloc[0]
        name = str(row[f"{OWN}frame" if f"{OWN}frame" in row else "frame"])
        shown = picture(report.folder / f"worst-{number}.png")
        frames.append({"picture": shown, "frame": name, "said": _said(row, report.card)})
    return {"worst": frames} if frames else None


def _said(row: pd.Series, card: Card) -> str:
    if not card.targets:
        return class_answer(row, card)
    read = [t for t in card.targets if t.is_read] or card.targets
    return _estimate_text(row, max(read, key=lambda t: _error(row, t) / (t.greatest - t.least)))


def _error(row: pd.Series, target: TargetCard) -> float:
    true, estimate = (np.array([float(row[name])]) for name in (target.column, f"estimate:{target.column}"))
    return abs(float(errors_of(target, true, estimate)[0]))


def _estimate_text(row: pd.Series, target: TargetCard) -> str:
    (low,), (high,) = interval_ends(target, row.to_frame().T)
    value, around = interval_text(float(row[f"estimate:{target.column}"]), float(low), float(high))
    true = rounded(float(row[target.column]), (high - low) / 2)
    return f"{target.quantity.replace('_', ' ')} {value} {around} {target.unit}, truth {true} {target.unit}"


def source(report: ReportedCalibration) -> Values:
    """Show recording, input, model, and software."""
    example, reference = report.folder / "example.png", report.folder / "reference.png"
    return {
        "card": report.card,
        "example": picture(example) if example.exists() else "",
        "reference": picture(reference) if reference.exists() else "",
    }


def steps(report: ReportedCalibration) -> Values:
    """Show every step from the camera's pixels to a reading."""
    return {"words": steps_of(report.card)}


def steps_of(card: Card) -> tuple[str, ...]:
    """Return a card's steps in words; for earlier cards, derived."""
    return (card.steps or reading_steps(card)).words


def use(report: ReportedCalibration) -> Values:
    """Show how to use it, and what it does not promise."""
    before = all(target.over_range is None for target in report.card.targets)
    return {"card": report.card, "before": before}


# in the order of the page; the name of each is that of its template
SECTIONS: tuple[Callable[[ReportedCalibration], Values | None], ...] = (
    findings,
    answers,
    targets,
    classes,
    deciding,
    surface,
    scores,
    sessions,
    evaluations,
    audit,
    split,
    robustness,
    instruments,
    choice,
    worst,
    source,
    steps,
    use,
)
