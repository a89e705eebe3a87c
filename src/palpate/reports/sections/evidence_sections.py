"""Sections of a calibration's page on its evidence: days, audits, camera changes, instruments."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.image import imread

from palpate.calibration.confounds.deciding_pixels import MAP_FILE, block_edges
from palpate.calibration.coverage.counted_groups import press_groups
from palpate.calibration.coverage.grouped_rates import grouped_coverage_interval
from palpate.calibration.sessions import EvaluationRecord
from palpate.estimators.intervals import layout_of
from palpate.estimators.model_card import Card, TargetCard
from palpate.reports.calibration_figures import Panel, deciding_panel, errors_of, held_rows, target_columns
from palpate.reports.evaluation_text import frames_of, valid_readings_text
from palpate.reports.sections.target_verdicts import reading_half_width

if TYPE_CHECKING:
    from palpate.reports.sections.certificate_sections import ReportedCalibration

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
