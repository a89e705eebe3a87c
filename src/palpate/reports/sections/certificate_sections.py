"""Sections of a calibration's page: a function and a template of its name in `templates/certificate`.

A section is left out where its function returns None. `SECTIONS` lists them in the page's order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.image import imread

from palpate.calibration.certificate import read_predictions
from palpate.calibration.confounds.skin_region import MAP_FILE, block_edges
from palpate.calibration.coverage.grouped_rates import (
    grouped_coverage_interval,
    held_out_groups,
    press_column,
    press_groups,
)
from palpate.calibration.coverage.range_scores import target_findings
from palpate.calibration.sessions import EvaluationRecord
from palpate.calibration.sessions.session_findings import PREFIX, SUFFIX, in_order, read_evaluation
from palpate.core import CertificateError, interval_text, rounded
from palpate.estimators.findings import Finding
from palpate.estimators.intervals import layout_of
from palpate.estimators.model_card import Card, TargetCard
from palpate.recordings.label_tables import OWN, own_column
from palpate.reports.calibration_figures import (
    Panel,
    deciding_panel,
    errors_of,
    held_rows,
    interval_ends,
    picture,
    surface_columns,
    surface_figure,
    target_columns,
    target_panels,
)
from palpate.reports.evaluation_text import class_answer, classes_told, frames_of, valid_readings_text
from palpate.reports.sections.target_verdicts import (
    answer,
    fails,
    found_elsewhere,
    others,
    reading_half_width,
    tested_text,
    verdict,
)
from palpate.reports.terminal_text import audit_head, not_relied_on, remaining_remedy

Values = dict[str, Any]


def sessions(report: ReportedCalibration) -> Values | None:
    """Show scores of each training session, and what few of them promise."""
    found = report.card.sessions
    if found is None or len(found.names) < 2 or found.column not in report.table:
        return None
    names = report.table[found.column].astype(str).to_numpy()
    rows = [_session_row(report, name, names == name) for name in found.names if (names == name).any()]
    return {"sessions": found, "rows": rows, "targets": report.card.targets, "mixed": not found.held_out}


def _session_row(report: ReportedCalibration, name: str, rows: np.ndarray) -> Values:
    cells = []
    for target in report.card.targets:
        true, guess, _ = (part[rows] for part in target_columns(target, report.table))
        error, inside = errors_of(target, true, guess), held_rows(target, report.table)[rows]
        low, high = grouped_coverage_interval(inside, press_groups(report.table[rows]))
        mae, scatter = float(np.abs(error).mean()), float(np.abs(error).std())
        cells.append(
            {
                "target": target, "mae": mae, "mae_half": 1.96 * scatter / max(len(error), 1) ** 0.5,
                "covered": float(inside.mean()), "low": low, "high": high,
            }
        )  # fmt: skip
    return {"name": name, "n": int(rows.sum()), "cells": cells}


def evaluations(report: ReportedCalibration) -> Values | None:
    """Show scores on other recordings next to the card's own, and files that are not of it."""
    if not report.evaluations and not report.refused_evaluations:
        return None
    rows = [
        {
            "found": found,
            "frames": frames_of(report.card, found),
            "scores": [(t, found.targets[t.column]) for t in report.card.targets],
            "valid": valid_readings_text(report.card, found.valid_readings),
            **_said_of(report.card, found),
            "instruments": tuple(found.instruments.values()),
        }
        for found in report.evaluations
    ]
    return {"evaluations": rows, "refused": report.refused_evaluations, "coverage": report.card.coverage}


def _said_of(card: Card, found: EvaluationRecord) -> Values:
    """Findings of an evaluation: targets that fall short, and those that the card does not read."""
    each = [(t, one) for t in card.targets for one in found.findings_of(t.column)]
    return {
        "findings": [one for t, one in each if t.is_read],
        "unread": [one for t, one in each if not t.is_read],
    }


def audit(report: ReportedCalibration) -> Values | None:
    """Show what other than touch predicts the labels, next to the model."""
    found = report.card.confounds
    if found is None:
        return None
    notes = [f for f in found.findings if f.severity == "notes"]
    height, width = report.card.input.frame_px
    return {"audit": found, "notes": notes, "whole": found.skin_px == (0, 0, width, height)}


def deciding(report: ReportedCalibration) -> Values | None:
    """Show maps of the pixels that decide each target."""
    card, folder = report.card, report.folder
    example = folder / "example.png"
    known = card.confounds is not None and card.confounds.map_file == MAP_FILE
    if not known or card.confounds is None or not (folder / MAP_FILE).exists() or not example.exists():
        return None
    growth = np.load(folder / MAP_FILE, allow_pickle=False).astype(np.float64)
    edges, layout = block_edges(card.input.size_px), layout_of(card)
    blocks = (len(edges[0]) - 1, len(edges[1]) - 1)
    if not card.targets or len(growth) < layout.outputs or growth.shape[1:] != blocks:
        return None
    image = np.atleast_3d(imread(example))[..., :3].mean(axis=2)
    maps = [growth[layout.outputs_of(j)].mean(axis=0) for j in range(len(card.targets))]
    panels = [_map_panel(t, image, one, edges) for t, one in zip(card.targets, maps, strict=True)]
    return {
        "panels": panels,
        "rows": card.confounds.map_rows,
        "circular": any(t.circular for t in card.targets),
        "undecided": [t for t, one in zip(card.targets, maps, strict=True) if not _stands_out(one)],
    }


def _map_panel(
    target: TargetCard, image: np.ndarray, growth: np.ndarray, edges: tuple[np.ndarray, np.ndarray]
) -> Panel:
    name = target.quantity.replace("_", " ")
    unit = target.unit if target.circular is None else "ratio"
    return deciding_panel(name, unit, image, growth, edges)


def _stands_out(growth: np.ndarray) -> bool:
    return float(growth.max()) > 2 * abs(float(growth.min()))


def robustness(report: ReportedCalibration) -> Values | None:
    """Show error and refusal under each camera change."""
    found = report.card.robustness
    if found is None:
        return None
    kinds = [(kind, list(rows)) for kind, rows in groupby(found.table, key=lambda row: row.kind)]
    return {"robustness": found, "kinds": kinds}


def choice(report: ReportedCalibration) -> Values | None:
    """Show what the model tried on inner folds, and what it took."""
    return None if report.card.choice is None else {"choice": report.card.choice}


def instruments(report: ReportedCalibration) -> Values | None:
    """Show the instruments of the labels, and their part of every interval."""
    if not any(target.measured_by for target in report.card.targets):
        return None
    rows = [
        {"target": t, "by": t.measured_by, "reading": reading_half_width(t, report.table)}
        for t in report.card.targets
    ]
    return {"rows": rows}


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
    card, name = report.card, target.quantity.replace("_", " ")
    tested = tested_text(card, target, report.evaluations)
    sentences = [answer(card, target, report.scored_groups, tested)]
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
    warned = fails(card, target, report.evaluations)
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
                "verdict": verdict(target, report.scored_groups),
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
    use,
)
