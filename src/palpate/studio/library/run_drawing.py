"""Drawings of a recorded run, as SVG: a quantity over its length with notes, and frames held out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
import pandas as pd

from palpate.core import Float, has_unit, split_column
from palpate.recordings import Run, Split
from palpate.recordings.run_notes import RunNote
from palpate.studio.page_style import paint
from palpate.studio.status_text import number
from palpate.studio.svg_drawing import nice_step

WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 640, 190, 52, 12, 14, 28
MAX_BINS = 500
"""Stretches of a curve that are drawn, each from its least to its greatest, so that no peak is lost."""
INK, SOFT, LINE, ACCENT, WARN = map(paint, ("ink", "soft", "line", "accent", "warn"))
ROW, MAX_FOLDS = 13, 20
Samples = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class RecordedCurve:
    """Quantity over a run's length.

    Attributes:
        times_s: of its samples, from the run's first instant [s].
        values: in `unit`.
        whole_s: the run's length [s].
    """

    name: str
    unit: str
    times_s: Samples
    values: Samples
    whole_s: float


def curve_of(run: Run) -> RecordedCurve | None:
    """What a run's length is shown by: its force sensor, else numbers of its labels; None of neither."""
    whole_s = max(float(run.times_s[-1]), 1e-6) if len(run) else 1e-6
    force = run.force()
    if len(force):
        times_s, values = force["time_s"].to_numpy(), force["fz_N"].to_numpy()
        whole_s = max(whole_s, float(times_s[-1]))
        return RecordedCurve("force along the skin's normal", "N", times_s, values, whole_s)
    names = [name for name, kind in run.manifest.labels.items() if kind == "number"]
    names.sort(key=lambda name: not name.endswith("_N"))
    for name in names:
        values = pd.to_numeric(run.labels[name], errors="coerce").to_numpy(np.float64)
        if np.isfinite(values).any():
            quantity, unit = (name, "")
            if has_unit(name):
                quantity, found = split_column(name)
                unit = found.symbol
            return RecordedCurve(f"{quantity} by the labels", unit, run.times_s, values, whole_s)
    return None


def curve_svg(curve: RecordedCurve | None, notes: Sequence[RunNote] = ()) -> str:
    """A run's curve, with a mark at each note and a line at the frame shown, which a script moves."""
    if curve is None:
        return '<p class="empty">This run holds no force and no number in its labels that could be drawn.</p>'
    times_s, values = _binned(curve)
    low, high = _range(values)
    step = nice_step((high - low) / 4)
    digits = max(0, -math.floor(math.log10(step) + 1e-9))

    def across(time_s: float) -> float:
        return LEFT + min(max(time_s / curve.whole_s, 0.0), 1.0) * (WIDTH - LEFT - RIGHT)

    def down(value: float) -> float:
        return TOP + (high - value) / (high - low) * (HEIGHT - TOP - BOTTOM)

    said = f"{number(float(values.min()), 2)} to {number(float(values.max()), 2)} {curve.unit}"
    deep = HEIGHT - TOP - BOTTOM
    begin = (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" data-left="{LEFT}" data-right="{WIDTH - RIGHT}" '
        f'data-whole="{curve.whole_s:.6f}"><title>{escape(curve.name)} over the run</title>'
        f"<desc>{escape(said)} over {curve.whole_s:.1f} s; {len(notes)} notes</desc>"
        f'<rect x="{LEFT}" y="{TOP}" width="{WIDTH - LEFT - RIGHT}" height="{deep}" fill="transparent"/>'
    )
    parts = [begin]
    for i in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1):
        y = down(i * step)
        parts.append(
            f'<path d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}" stroke="{SOFT if i == 0 else LINE}"/>'
            f'<text x="{LEFT - 7}" y="{y + 4:.1f}" text-anchor="end">{number(i * step, digits)}</text>'
        )
    tick = nice_step(curve.whole_s / 5)
    for i in range(math.floor(curve.whole_s / tick + 1e-9) + 1):
        x = across(i * tick)
        anchor = "end" if x > WIDTH - RIGHT - 20 else "middle"
        parts.append(f'<text x="{x:.1f}" y="{HEIGHT - 9}" text-anchor="{anchor}">{i * tick:g} s</text>')
    unit = f"{curve.name} [{curve.unit}]" if curve.unit else curve.name
    parts.append(f'<text x="{LEFT + 5}" y="{TOP + 10}" class="unit">{escape(unit)}</text>')
    points = " ".join(f"{across(t):.1f},{down(v):.1f}" for t, v in zip(times_s, values, strict=True))
    parts.append(f'<polyline points="{points}" fill="none" stroke="{ACCENT}" stroke-width="1.6"/>')
    for note in notes:
        x = across(note.time_s)
        parts.append(
            f'<g><title>{escape(note.text)}</title><path d="M{x:.1f} {TOP}v{deep}" stroke="{WARN}" '
            f'stroke-dasharray="2 3"/><path d="M{x - 5:.1f} {TOP}h10l-5 8z" fill="{WARN}"/></g>'
        )
    line = f'<path class="cursor" d="M{LEFT} {TOP}v{deep}" stroke="{INK}" stroke-width="1.6"/>'
    return "".join([*parts, line, "</svg>"])


def split_svg(found: Split, frames: int) -> str:
    """Frames of a run from left to right, a row a fold; a bar where the fold holds them out."""
    folds = found.folds[:MAX_FOLDS]
    height = ROW * len(folds) + 22
    begin = (
        f'<svg viewBox="0 0 {WIDTH} {height}" role="img"><title>Frames that each fold holds out</title>'
        f"<desc>{len(found.folds)} folds of {frames} frames, {escape(found.reason)}</desc>"
    )
    parts = [begin]
    scale = (WIDTH - LEFT - RIGHT) / max(frames, 1)
    for k, rows in enumerate(folds):
        y = k * ROW + 3
        parts.append(
            f'<text x="{LEFT - 7}" y="{y + 9}" text-anchor="end">{k + 1}</text>'
            f'<path d="M{LEFT} {y + ROW / 2 - 1}H{WIDTH - RIGHT}" stroke="{LINE}"/>'
        )
        bars = "".join(
            f"M{LEFT + first * scale:.1f} {y}h{max((end - first) * scale, 0.7):.1f}v{ROW - 4}h"
            f"-{max((end - first) * scale, 0.7):.1f}z"
            for first, end in _stretches(np.sort(rows))
        )
        parts.append(f'<path d="{bars}" fill="{ACCENT}"/>')
    named = f'<text x="{WIDTH - RIGHT}" y="{height - 5}" text-anchor="end">frames, first to last</text>'
    return "".join([*parts, named, "</svg>"])


def label_ranges(run: Run) -> Mapping[str, str]:
    """Each label with the range of its numbers, or how many different texts or flags it has."""
    told = {}
    for name, kind in run.manifest.labels.items():
        column = run.labels[name].dropna()
        if not len(column):
            told[name] = "nothing"
        elif kind == "number":
            told[name] = f"{column.min():.4g} to {column.max():.4g}".replace("-", "−")
        else:
            told[name] = f"{column.nunique()} different"
        if 0 < len(column) < len(run):
            told[name] += f", in {len(column)} of {len(run)} frames"
    return told


def _binned(curve: RecordedCurve) -> tuple[Samples, Samples]:
    good = np.isfinite(curve.values)
    times_s, values = curve.times_s[good], curve.values[good]
    if len(times_s) <= 2 * MAX_BINS:
        return times_s, values
    edges = np.linspace(0, len(times_s), MAX_BINS + 1).astype(int)[:-1]
    both = np.stack([np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)], axis=1)
    return np.repeat(times_s[edges], 2), both.reshape(-1)


def _range(values: Samples) -> tuple[float, float]:
    low, high = float(min(values.min(), 0.0)), float(max(values.max(), 0.0))
    span = max(high - low, 1e-3)
    return low - 0.05 * span, high + 0.12 * span  # room for the name


def _stretches(rows: np.ndarray) -> list[tuple[int, int]]:
    """Stretches of consecutive rows, as first and end."""
    if not len(rows):
        return []
    breaks = np.flatnonzero(np.diff(rows) > 1)
    firsts, lasts = [0, *(breaks + 1)], [*breaks, len(rows) - 1]
    return [(int(rows[a]), int(rows[b]) + 1) for a, b in zip(firsts, lasts, strict=True)]
