"""Figures of reproduced studies: bars beside printed values, truth against estimate, curves, trends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator

from palpate.core import UInt8, ndarray
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, COLOURS, INK, drawn, styled_panels
from palpate.reports.compliance_figures import Course, Courses, boxes, trial_lines


class Bar(NamedTuple):
    """One model's value beside what is printed of it; None where there is none."""

    name: str
    printed: float | None
    found: float | None
    low: float = 0.0
    high: float = 0.0


class Cloud(NamedTuple):
    """Truths and estimates of one model."""

    title: str
    true: Sequence[float]
    estimate: Sequence[float]


def bars(all_bars: Sequence[Bar], label: str) -> str:
    """Printed above found, a line a model; the found with their intervals."""
    with styled_panels(8.2, 0.5 * len(all_bars) + 0.9) as (figure, (axes,)):
        for i, bar in enumerate(all_bars):
            if bar.printed is not None:
                axes.barh(i - 0.2, bar.printed, 0.36, color=BAND, edgecolor=INK, lw=0.6)
                axes.text(bar.printed, i - 0.2, f" {bar.printed:.3g}", va="center", fontsize=7)
            if bar.found is not None:
                reach = [[max(bar.found - bar.low, 0)], [max(bar.high - bar.found, 0)]]
                axes.barh(i + 0.2, bar.found, 0.36, color=ACCENT, xerr=reach, error_kw={"lw": 1})
                axes.text(bar.high, i + 0.2, f" {bar.found:.3g}", va="center", fontsize=7)
        axes.set_yticks(range(len(all_bars)), [bar.name for bar in all_bars], fontsize=8)
        axes.invert_yaxis()
        axes.margins(x=0.08)
        axes.set_xlabel(label)
        swatches = [Rectangle((0, 0), 1, 1, color=colour) for colour in (BAND, ACCENT)]
        axes.legend(swatches, ["printed, real sensor", "found, virtual sensor"], frameon=False, fontsize=8)
        return drawn(figure)


ACROSS = 4  # panels in a row


@contextmanager
def _panel_each(count: int, side: float) -> Iterator[tuple[Figure, np.ndarray]]:
    """A panel a model, some in a row."""
    columns = min(count, ACROSS)
    rows = -(-count // columns)
    with styled_panels(side * columns, side * rows, rows, columns) as (figure, panels):
        for spare in panels[count:]:
            spare.set_visible(False)
        yield figure, panels[:count]


def clouds(all_clouds: Sequence[Cloud], label: str) -> str:
    """Estimate against truth, a panel a model."""
    with _panel_each(len(all_clouds), 3.1) as (figure, panels):
        every = [value for cloud in all_clouds for value in cloud.true]
        ends = [min(every), max(every)]
        for i, (axes, cloud) in enumerate(zip(panels, all_clouds, strict=True)):
            axes.plot(ends, ends, color=INK, lw=0.8, ls="--")
            axes.scatter(cloud.true, cloud.estimate, s=8, color=ACCENT, alpha=0.55, linewidths=0)
            axes.set(title=cloud.title, xlabel=f"true {label}")
            axes.set_ylabel("" if i % ACROSS else f"estimated {label}")
        return drawn(figure)


def places(titles: Sequence[str], at: Sequence[Sequence[Sequence[float]]]) -> str:
    """Places of contacts and their estimates, a panel a model: x, y, x estimated, y estimated."""
    with _panel_each(len(titles), 3.4) as (figure, panels):
        for i, (axes, title, (x, y, x_seen, y_seen)) in enumerate(zip(panels, titles, at, strict=True)):
            for ends in zip(x, x_seen, y, y_seen, strict=True):
                axes.plot(ends[:2], ends[2:], color=BAD, lw=0.5, alpha=0.5)
            axes.scatter(x_seen, y_seen, s=9, color=ACCENT, alpha=0.6, linewidths=0, label="estimated")
            axes.scatter(x, y, s=16, color=INK, marker="+", lw=0.9, label="true")
            axes.set(title=title, xlabel="x [mm]", xlim=(-30, 30), ylim=(-30, 30), aspect="equal")
            axes.set_ylabel("" if i % ACROSS else "y [mm]")
        panels[0].legend(frameon=False, fontsize=7, loc="upper right")
        return drawn(figure)


def curves(
    panels: Mapping[str, Mapping[str, tuple[Sequence[float], Sequence[float]]]],
    across: str,
    *,
    log: bool = True,
    log_across: bool = False,
) -> str:
    """Panels of curves (x, y) by name, those of a share [%] linear; colours are those of the comparison."""
    with styled_panels(3.4 * len(panels) + 0.6, 3.1, columns=len(panels)) as (figure, drawn_axes):
        names = list(dict.fromkeys(name for lines in panels.values() for name in lines))
        for axes, (label, lines) in zip(drawn_axes, panels.items(), strict=True):
            for name, (x, y) in lines.items():
                colour = COLOURS[names.index(name) % len(COLOURS)]
                axes.plot(x, y, "o-", color=colour, ms=3.5, lw=1.2, label=name)
            if log and not label.endswith("[%]"):
                axes.set_yscale("log")
                for side in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
                    side(FuncFormatter(lambda value, _: f"{value:g}"))
                axes.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
            if log_across:
                axes.set_xscale("log")
            axes.set(xlabel=across, ylabel=label)
        _legend(figure, drawn_axes)
        return drawn(figure)


def annotated(image: UInt8[ndarray, "h w 3"], boxes: Sequence[tuple[tuple[int, int, int, int], str]]) -> str:
    """A frame with its regions outlined: (x, y, width, height) and a colour each."""
    with styled_panels(6.4, 6.4 * image.shape[0] / image.shape[1]) as (figure, (axes,)):
        axes.imshow(image)
        for (x, y, w, h), colour in boxes:
            axes.add_patch(Rectangle((x, y), w - 1, h - 1, fill=False, ec=colour, lw=2))
        axes.set_axis_off()
        return drawn(figure)


def _legend(figure: Figure, axes: ndarray) -> None:
    handles: dict[str, Any] = {}
    for one in axes:
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=5, frameon=False, fontsize=8
    )


COLOUR = {"S1": "#2f6fb7", "new": "#c0392b", "S2": "#2e9e5b", "S3": "#d8a013"}
"""The report's own: blue, red, green, yellow."""

Groups = Mapping[str, Sequence[float]]


def plate_figure(
    samples: Mapping[str, Course], slopes: Groups, lines: Mapping[str, tuple[float, float]]
) -> str:
    """Figure 5: force over deformation with its line; stiffness of every trial [N/mm]."""
    with styled_panels(8.6, 3.3, columns=2, width_ratios=[1.3, 1]) as (figure, (left, right)):
        for name, (depth, force) in samples.items():
            slope, start = lines[name]
            left.plot(depth, force, ".", color=COLOUR[name], ms=3, label=f"{name}: {slope:.2f} N/mm")
            left.plot(depth, slope * depth + start, color=COLOUR[name], lw=0.8)
        left.set(xlabel="deformation [mm]", ylabel="force [N]", title="(a) rigid plate on specimens")
        left.legend(frameon=False, fontsize=8)
        boxes(slopes, "stiffness [N/mm]", right, COLOUR)
        right.set_title("(b) stiffness of every trial")
        return drawn(figure)


def trend_figure(panels: Mapping[str, tuple[Courses, Groups]]) -> str:
    """Figures 6, 8 and 9: a cue over force for every trial, and a box a specimen; a row of both a cue."""
    rows = len(panels)
    with styled_panels(8.6, 3.0 * rows, rows, columns=2, width_ratios=[1.3, 1]) as (figure, pairs):
        for (left, right), (label, (courses, groups)) in zip(
            pairs.reshape(-1, 2), panels.items(), strict=True
        ):
            course_label, _, box_label = label.partition("|")
            trial_lines(courses, "force [N]", course_label, left, COLOUR, lw=0.8)
            boxes(groups, box_label, right, COLOUR)
        return drawn(figure)


@dataclass(frozen=True)
class ComparedValue:
    """A line of stiffness over a cue, and what it tells of the new specimen [N/mm]."""

    label: str
    points: Mapping[str, Sequence[float]]
    kappa: Mapping[str, float]
    slope: float
    start: float
    new_cue: float
    new: tuple[float, float, float]
    true: float


def line_figure(lines: Sequence[ComparedValue]) -> str:
    """Figure 7: stiffness over a cue, the line, the new specimen by it with its 90 % interval."""
    rows = -(-len(lines) // 2)
    with styled_panels(8.6, 3.1 * rows, rows, columns=2) as (figure, panels):
        for axes, one in zip(panels, lines, strict=False):
            _line(axes, one)
        return drawn(figure)


def _line(axes: Axes, one: ComparedValue) -> None:
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
    with styled_panels(8.6, 0.42 * len(rows) + 1.0) as (figure, (axes,)):
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
