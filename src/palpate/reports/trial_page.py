"""Page of an experiment's analysis: results first, then figures (confusion matrices, ratios with intervals,
psychometric functions), tables, and caveats.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from palpate.core import Float, Int, ndarray, new_file
from palpate.psychophysics.analysis import (
    ExperimentAnalysis,
    PsychometricFit,
    RankConfusion,
    SettingAccuracy,
    SettingThreshold,
    TaskComparison,
)
from palpate.psychophysics.analysis.experiment_analysis import SIMULATED
from palpate.psychophysics.judgements import CUES, Condition, Task
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, INK, drawn, styled_panels
from palpate.reports.certificate_page import filled_template
from palpate.version import __version__

SHADES = LinearSegmentedColormap.from_list("counts", ["#ffffff", BAND, ACCENT])
PANELS_A_ROW = 3


def confusion_figure(matrices: Mapping[str, RankConfusion]) -> str:
    """Draw confusion matrices of rankings, by title, as a PNG in a data address."""
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
    """Draw ratios with intervals, one below the other."""
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


# levels, how often the answer was given at each, of how many, and the fitted function
PanelOfAnswers = tuple[Float[ndarray, " _"], Int[ndarray, " _"], Int[ndarray, " _"], PsychometricFit]


def psychometric_figure(panels: Mapping[str, PanelOfAnswers], label: str) -> str:
    """Draw ratios of an answer over levels, with the fitted function and its threshold's interval."""
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


SIGNIFICANT = 0.05
LEGEND = "; ".join(f"{condition.value}: {cues}" for condition, cues in CUES.items())
SAID = {Task.PAIR: "pairs", Task.RANK: "rankings"}


def setting_said(setting: str) -> str:
    """Return a setting, such as "direct I", with its condition in words: "direct with both cues"."""
    presentation, condition = setting.rsplit(" ", 1)
    return f"{presentation} with {CUES[Condition(condition)]}"


def analysis_answers(found: ExperimentAnalysis) -> tuple[str, ...]:
    """Return the results, a sentence each: differences, accuracies, thresholds."""
    return (
        *(_difference_said(one) for one in found.comparisons if one.shares),
        *(_accuracy_said(one) for one in found.accuracies),
        *(_threshold_said(one, found.unit) for one in found.thresholds),
    )


def write_trial_page(found: ExperimentAnalysis, path: Path, source: str) -> None:
    """Write the page of an analysis.

    Args:
        source: what was analyzed, in words.
    """
    page = filled_template(
        "trial.html",
        version=__version__,
        source=source,
        found=found,
        simulated=SIMULATED in found.caveats,
        answers=analysis_answers(found),
        legend=LEGEND,
        shares=share_figure(
            [_share_row(one) for one in found.accuracies],
            "right answers, of rankings right places [%]; 95 % intervals",
        ),
        confusions=confusion_figure({one.setting: one.confusion for one in found.rankings})
        if found.rankings
        else None,
        functions=psychometric_figure(_functions(found), _softness_label(found))
        if found.thresholds
        else None,
    )
    with new_file(path) as part:
        part.write_text(page, encoding="utf-8")


def _functions(found: ExperimentAnalysis) -> Mapping[str, PanelOfAnswers]:
    return {one.setting: (one.counted, one.given, one.n, one.fit) for one in found.thresholds}


def _softness_label(found: ExperimentAnalysis) -> str:
    """What the fits count as softness: the level, with its sign turned, or its reciprocal."""
    one, unit = found.thresholds[0], found.unit or "1"
    if (one.counted == one.levels).all():
        return f"level [{unit}]"
    return f"− level [{unit}]" if (one.counted == -one.levels).all() else f"1 / level [1/{unit}]"


def _share_row(one: SettingAccuracy) -> ShareRow:
    low, high = one.clusters or one.wilson
    return ShareRow(f"{setting_said(one.setting)}, {SAID[one.task]}", one.share, low, high)


def _difference_said(one: TaskComparison) -> str:
    told = [pair for pair in one.shares if pair.holm_p < SIGNIFICANT]
    untold = [
        f"{setting_said(pair.first)} and {setting_said(pair.second)}"
        for pair in one.shares
        if pair.holm_p >= SIGNIFICANT
    ]
    parts = [
        f"{better} above {worse} by {100 * abs(pair.value):.0f} points (p {pair.holm_p:.3g})"
        for pair in told
        for worse, better in [
            map(setting_said, (pair.first, pair.second) if pair.value > 0 else (pair.second, pair.first))
        ]
    ]  # fmt: skip
    if untold:
        parts.append(f"no difference is shown between {', '.join(untold)}")
    least = max(pair.least_p for pair in one.shares)
    note = f"; so few participants cannot give p below {least:.2g} in one comparison" if least > 0.01 else ""
    return f"{SAID[one.task].capitalize()}: {'; '.join(parts)}. p are exact, corrected by Holm{note}."


def _accuracy_said(one: SettingAccuracy) -> str:
    low, high = one.clusters or one.wilson
    over = "over participants" if one.clusters else "one participant's answers as independent"
    what = "places right" if one.task is Task.RANK else "right"
    return (
        f"{setting_said(one.setting)}, {SAID[one.task]}: {100 * one.share:.1f} % {what} "
        f"[95 %: {100 * low:.1f} to {100 * high:.1f}], {one.right} of {one.n}, {over}."
    )


def _threshold_said(one: SettingThreshold, unit: str) -> str:
    value, low, high = one.pse
    if not all(one.fit.threshold.bounded):
        why = "; ".join(one.fit.notes.values())
        return f"{setting_said(one.setting)}: these answers bound no threshold: {why}."
    spread, scale = one.fit.spread, "in the natural logarithm" if one.fit.function.logarithmic else unit
    jnd = {
        (True, True): f"{spread.value:.2g} {scale} [95 %: {spread.low:.2g} to {spread.high:.2g}]",
        (False, True): f"at most {spread.high:.2g} {scale}, not bounded below",
        (True, False): f"at least {spread.low:.2g} {scale}, not bounded above",
        (False, False): "not told",
    }[spread.bounded]
    badly = one.fit.deviance_p < SIGNIFICANT
    return (
        f"{setting_said(one.setting)}: as soft as {one.standard} at {value:.3g} {unit} [95 %: {low:.3g} to "
        f"{high:.3g}], just noticeable difference {jnd}"
        f"{f'; the function fits badly (p {one.fit.deviance_p:.2g})' if badly else ''}."
    )
