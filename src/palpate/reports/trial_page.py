"""The page of an experiment's analysis: what was found first, then its figures, tables and caveats."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from palpate.core import new_file
from palpate.psychophysics.analysis import (
    ExperimentAnalysis,
    SettingAccuracy,
    SettingThreshold,
    TaskComparison,
)
from palpate.psychophysics.analysis.experiment_analysis import SIMULATED
from palpate.psychophysics.judgements import Task
from palpate.reports.certificate_page import filled_template
from palpate.reports.trial_figures import (
    PanelOfAnswers,
    ShareRow,
    confusion_figure,
    psychometric_figure,
    share_figure,
)
from palpate.version import __version__

SIGNIFICANT = 0.05
SAID = {Task.PAIR: "pairs", Task.RANK: "rankings"}


def analysis_answers(found: ExperimentAnalysis) -> tuple[str, ...]:
    """What was found, a sentence each: differences, accuracies, thresholds."""
    return (
        *(_difference_said(one) for one in found.comparisons if one.shares),
        *(_accuracy_said(one) for one in found.accuracies),
        *(_threshold_said(one, found.unit) for one in found.thresholds),
    )


def write_trial_page(found: ExperimentAnalysis, path: Path, source: str) -> None:
    """Write the page of an analysis.

    Args:
        found: what it shows.
        path: of the HTML file; must not exist.
        source: what was analysed, as the page says it.

    Raises:
        ExistsError: `path` exists.
        StorageError: the disk refused.
    """
    page = filled_template(
        "trial.html",
        version=__version__,
        source=source,
        found=found,
        simulated=SIMULATED in found.caveats,
        answers=analysis_answers(found),
        shares=share_figure(
            [_share_row(one) for one in found.accuracies],
            "right answers, of rankings right places [%]; 95 % intervals",
        ),
        confusions=confusion_figure({one.setting: one.confusion for one in found.rankings})
        if found.rankings
        else None,
        functions=psychometric_figure(_functions(found), f"softness, from level [{found.unit or '1'}]")
        if found.thresholds
        else None,
    )
    with new_file(path) as part:
        part.write_text(page, encoding="utf-8")


def _functions(found: ExperimentAnalysis) -> Mapping[str, PanelOfAnswers]:
    return {one.setting: (one.counted, one.given, one.n, one.fit) for one in found.thresholds}


def _share_row(one: SettingAccuracy) -> ShareRow:
    low, high = one.clusters or one.wilson
    return ShareRow(f"{one.setting}, {SAID[one.task]}", one.share, low, high)


def _difference_said(one: TaskComparison) -> str:
    told = [pair for pair in one.shares if pair.holm_p < SIGNIFICANT]
    untold = [f"{pair.first} and {pair.second}" for pair in one.shares if pair.holm_p >= SIGNIFICANT]
    parts = [
        f"{better} above {worse} by {100 * abs(pair.value):.0f} points (p {pair.holm_p:.3g})"
        for pair in told
        for better, worse in [
            (pair.second, pair.first) if pair.value > 0 else (pair.first, pair.second)
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
        f"{one.setting}, {SAID[one.task]}: {100 * one.share:.1f} % {what} "
        f"[{100 * low:.1f}, {100 * high:.1f}], {one.right} of {one.n}, {over}."
    )


def _threshold_said(one: SettingThreshold, unit: str) -> str:
    value, low, high = one.pse
    if not all(one.fit.threshold.bounded) or not all(one.fit.spread.bounded):
        return (
            f"{one.setting}: the psychometric function is not bounded by these answers: "
            f"{'; '.join(one.fit.notes)}."
        )
    jnd = one.fit.spread
    fit_said = (
        "" if one.fit.deviance_p >= SIGNIFICANT else f"; the function fits badly (p {one.fit.deviance_p:.2g})"
    )
    scale = "a natural logarithm" if one.fit.function.logarithmic else unit
    return (
        f"{one.setting}: as soft as {one.standard} at {value:.3g} {unit} [{low:.3g}, {high:.3g}], just "
        f"noticeable difference {jnd.value:.2g} {scale} [{jnd.low:.2g}, {jnd.high:.2g}]{fit_said}."
    )
