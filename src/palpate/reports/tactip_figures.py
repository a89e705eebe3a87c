"""Figures 5 to 9 of the compliance report, drawn of the virtual TacTip's presses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray

from palpate.core.shapes import Float
from palpate.reports.compliance import boxes
from palpate.reports.figures import INK, STYLE, drawn

COLOUR = {"S1": "#2f6fb7", "new": "#c0392b", "S2": "#2e9e5b", "S3": "#d8a013"}
"""The report's own: blue, red, green, yellow."""

Course = tuple[Float[ndarray, " _"], Float[ndarray, " _"]]
Courses = Mapping[str, Sequence[Course]]
Groups = Mapping[str, Sequence[float]]


def plate_figure(
    samples: Mapping[str, Course], slopes: Groups, lines: Mapping[str, tuple[float, float]]
) -> str:
    """Figure 5: force over deformation with its line; stiffness of every trial [N/mm]."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 3.3), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=[1.3, 1])
        for name, (depth, force) in samples.items():
            slope, start = lines[name]
            left.plot(depth, force, ".", color=COLOUR[name], ms=3, label=f"{name}: {slope:.2f} N/mm")
            left.plot(depth, slope * depth + start, color=COLOUR[name], lw=0.8)
        left.set(xlabel="deformation [mm]", ylabel="force [N]", title="(a) rigid plate on specimens")
        left.legend(frameon=False, fontsize=8)
        boxes(slopes, "stiffness [N/mm]", right, COLOUR)
        right.set_title("(b) stiffness of every trial")
        return drawn(figure)


def trend_figure(panels: Mapping[str, tuple[Courses, Groups]], across: str = "force [N]") -> str:
    """Figures 6, 8 and 9: a cue over force for every trial, and a box a specimen; a row of both a cue."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 3.0 * len(panels)), layout="constrained")
        rows = np.atleast_2d(figure.subplots(len(panels), 2, width_ratios=[1.3, 1]))
        for (left, right), (label, (courses, groups)) in zip(rows, panels.items(), strict=True):
            for name, lines in courses.items():
                for i, (x, y) in enumerate(lines):
                    left.plot(x, y, color=COLOUR[name], lw=0.8, label=name if i == 0 else None)
            course_label, _, box_label = label.partition("|")
            left.set(xlabel=across, ylabel=course_label)
            left.legend(frameon=False, fontsize=8)
            boxes(groups, box_label, right, COLOUR)
        return drawn(figure)


@dataclass(frozen=True)
class Told:
    """A line of stiffness over a cue, and what it tells of the new specimen [N/mm]."""

    label: str
    points: Mapping[str, Sequence[float]]
    kappa: Mapping[str, float]
    slope: float
    start: float
    new_cue: float
    new: tuple[float, float, float]
    true: float


def line_figure(lines: Sequence[Told]) -> str:
    """Figure 7: stiffness over a cue, the line, the new specimen by it with its 90 % interval."""
    with mpl.rc_context(STYLE):
        high = -(-len(lines) // 2)
        figure = Figure(figsize=(8.6, 3.1 * high), layout="constrained")
        for axes, one in zip(np.ravel(figure.subplots(high, 2)), lines, strict=False):
            _line(axes, one)
        return drawn(figure)


def _line(axes: Axes, one: Told) -> None:
    for name, values in one.points.items():
        axes.plot(values, np.full(len(values), one.kappa[name]), ".", color=COLOUR[name], label=name)
    ends = np.array([min(map(min, one.points.values())), max(map(max, one.points.values()))])
    axes.plot(ends, one.slope * ends + one.start, color=INK, lw=0.8)
    value, low, high = one.new
    if np.isfinite([low, high]).all():
        axes.plot([one.new_cue] * 2, [low, high], color=COLOUR["new"], lw=1.5)
    axes.plot(one.new_cue, value, "o", color=COLOUR["new"], label=f"new: {value:.2f} N/mm")
    axes.axhline(one.true, color=COLOUR["new"], lw=0.8, ls=":")
    axes.set(xlabel=one.label, ylabel="stiffness [N/mm]")
    axes.legend(frameon=False, fontsize=8)


def forest_figure(
    rows: Mapping[str, tuple[float, float, float]], true: float, printed: Mapping[str, float]
) -> str:
    """The new specimen's stiffness by every route, with its interval; the dotted line is the truth [N/mm]."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 0.42 * len(rows) + 1.0), layout="constrained")
        axes = figure.subplots()
        for i, (name, (value, low, high)) in enumerate(rows.items()):
            axes.plot(np.clip([low, high], 0.5, 15), [i, i], color=INK, lw=1.4)
            axes.plot(np.clip(value, 0.5, 15), i, "o", color=COLOUR["new"])
            if name in printed:
                axes.plot(printed[name], i, "D", color="none", markeredgecolor=COLOUR["S1"])
        axes.axvline(true, color=COLOUR["new"], lw=0.8, ls=":")
        axes.set_yticks(range(len(rows)), list(rows))
        axes.invert_yaxis()
        axes.set(xlabel="stiffness of the new specimen [N/mm]; diamonds: printed", xlim=(0, 15.2))
        return drawn(figure)
