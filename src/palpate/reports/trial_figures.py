"""Figures of judgements: confusion matrices, shares with intervals, psychometric functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from palpate.core import Float, Int, ndarray
from palpate.psychophysics.analysis import PsychometricFit, RankConfusion
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, INK, drawn, styled_panels

SHADES = LinearSegmentedColormap.from_list("counts", ["#ffffff", BAND, ACCENT])
PANELS_A_ROW = 3


def confusion_figure(matrices: Mapping[str, RankConfusion]) -> str:
    """Confusion matrices of rankings with their counts, by title, as a PNG in a data address."""
    rows = -(-len(matrices) // PANELS_A_ROW)
    columns = min(len(matrices), PANELS_A_ROW)
    with styled_panels(2.9 * columns, 2.9 * rows, rows, columns) as (figure, panels):
        for axes in panels[len(matrices) :]:
            axes.set_axis_off()
        for axes, (title, one) in zip(panels, matrices.items(), strict=False):
            axes.imshow(one.counts / one.rankings, cmap=SHADES, vmin=0, vmax=1)
            for (i, j), count in np.ndenumerate(one.counts):
                dark = count > 0.7 * one.rankings
                axes.text(
                    j, i, str(count), ha="center", va="center", color="white" if dark else INK, fontsize=8
                )
            places = range(len(one.names))
            axes.set_xticks(places, [str(place + 1) for place in places], fontsize=7)
            axes.set_yticks(places, one.names, fontsize=7)
            axes.set_xlabel("place given, 1 least soft", fontsize=8)
            axes.set_title(f"{title}: {100 * one.total_accuracy:.1f} %")
            axes.spines[:].set_visible(False)
        return drawn(figure)


@dataclass(frozen=True, slots=True)
class ShareRow:
    """One share with its interval, and another beside it where there is one."""

    name: str
    value: float
    low: float
    high: float
    beside: float | None = None


def share_figure(rows: Sequence[ShareRow], label: str, line: float | None = None) -> str:
    """Shares with intervals, one below the other; diamonds stand beside, a dotted line is one for all."""
    with styled_panels(8.4, 0.34 * len(rows) + 0.9) as (figure, (axes,)):
        for i, one in enumerate(rows):
            axes.plot([100 * one.low, 100 * one.high], [i, i], color=INK, lw=1.4)
            axes.plot(100 * one.value, i, "o", color=ACCENT)
            if one.beside is not None:
                axes.plot(100 * one.beside, i, "D", color="none", markeredgecolor=BAD)
        if line is not None:
            axes.axvline(100 * line, color=BAD, lw=0.9, ls=":")
        axes.set_yticks(range(len(rows)), [one.name for one in rows], fontsize=8)
        axes.invert_yaxis()
        axes.set(xlabel=label, xlim=(-1, 101))
        return drawn(figure)


PanelOfAnswers = tuple[Float[ndarray, " _"], Int[ndarray, " _"], Int[ndarray, " _"], PsychometricFit]
"""Levels, how often the answer was given at each, of how many, and the fitted function."""


def psychometric_figure(
    panels: Mapping[str, PanelOfAnswers],
    label: str,
) -> str:
    """Shares of an answer over levels, with the fitted function and its threshold's interval, by title.

    Args:
        panels: by title.
        label: of the levels, with their unit.
    """
    columns = min(len(panels), PANELS_A_ROW)
    rows = -(-len(panels) // PANELS_A_ROW)
    with styled_panels(3.0 * columns, 2.6 * rows, rows, columns) as (figure, every):
        for axes in every[len(panels) :]:
            axes.set_axis_off()
        for axes, (title, (levels, given, n, fit)) in zip(every, panels.items(), strict=False):
            fine = np.linspace(levels.min(), levels.max(), 200)
            axes.plot(fine, fit.function(fine), color=ACCENT)
            axes.scatter(levels, given / n, s=8 + n, color=INK, zorder=3)
            inside = np.clip([fit.threshold.low, fit.threshold.high], fine[0], fine[-1])
            axes.plot(inside, [0.5, 0.5], color=BAD, lw=2)
            axes.set(ylim=(-0.03, 1.03), xlabel=label, ylabel="called softer", title=title)
        return drawn(figure)
