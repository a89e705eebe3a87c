"""Results as plain text for a terminal.

Half-widths of the 95 % intervals of scores, to which a report rounds them.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from palpate.core import half_width_text, rounded
from palpate.estimators.findings import ORDER_CODES, Finding
from palpate.estimators.intervals import layout_of
from palpate.estimators.model_card import Card, ScoreCard, TargetCard

if TYPE_CHECKING:
    from palpate.recordings.integrity import CheckReport

CONFIDENT = 1.96  # standard deviations on either side of a mean, for 95 %
MIN_SHARE_HALF_WIDTH = 1.0  # least written half-width of a percentage
MIN_R2_HALF_WIDTH = 1e-3  # least written half-width of R²


def mean_error_half_width(score: ScoreCard, groups: int) -> float:
    """Return the half-width of a mean absolute error's 95 % interval over groups."""
    spread = math.sqrt(max(score.rmse**2 - score.mae**2, 0.0))
    return CONFIDENT * spread / math.sqrt(max(min(groups, score.n), 1))


def explained_half_width(score: ScoreCard, groups: int) -> float:
    """Return the half-width of the 95 % interval of R² over groups, as a ratio of two normal variances."""
    n = max(min(groups, score.n), 1)
    return CONFIDENT * abs(1 - score.r2) * math.sqrt(4 / n)


def width_text(half_width: float, period: float | None = None, unit: str = "") -> str:
    """Return the half-width of an interval to two digits, or that it is the whole turn of a circular target.

    Example:
        >>> width_text(0.523), width_text(12.3, 360.0, "deg"), width_text(200.0, 360.0, "deg")
        ('±0.52', '±12 deg', 'the whole turn')
    """
    if period is not None and 2 * half_width >= period:
        return "the whole turn"
    return f"±{half_width_text(half_width)} {unit}".rstrip()


def percent(share: float, low: float, high: float) -> str:
    """Return a ratio in percent to the decimal place of its interval; 100 and 0 only where exact.

    Example:
        >>> percent(0.8963, 0.86, 0.92), percent(0.998, 0.16, 1.0), percent(1.0, 0.16, 1.0)
        ('89.6', '99.8', '100')
    """
    shown = rounded(100 * share, max(50 * (high - low), MIN_SHARE_HALF_WIDTH))
    if 0 < share < 1 and float(shown) in (0, 100):
        return f"{min(max(100 * share, 0.1), 99.9):.1f}"
    return shown


def audit_head(card: Card) -> str:
    """Return the summary of a card's findings, with the targets concerned."""
    if card.split.clean and not (card.confounds and card.confounds.failed):
        return "The audit warns"
    named = [t.quantity.replace("_", " ") for t in card.targets if not_relied_on(card, t)]
    if len(named) in (0, len(card.targets)):
        return "The audit failed: do not rely on these scores"
    return f"The audit failed: do not rely on the scores of {', '.join(named)}"


def not_relied_on(card: Card, target: TargetCard) -> bool:
    """Return whether an audit failed over a target, or over all."""
    j, layout = card.columns.index(target.column), layout_of(card)
    own = {target.column, *layout.names(card.columns)[layout.outputs_of(j)], ""}
    found = card.confounds.findings if card.confounds else ()
    return not card.split.clean or any(f.severity == "fails" and f.target in own for f in found)


def remaining_remedy(card: Card, finding: Finding, elsewhere: bool = False) -> str:
    """Return the remedy of a finding; for temporal order also what has not been done yet.

    Args:
        elsewhere: the calibration was evaluated on another session.
    """
    if finding.code not in ORDER_CODES:
        return finding.remedy
    if elsewhere or _tested_on_sessions(card):
        return f"{finding.remedy}; until then, rely only on what was found on other sessions"
    evaluated = "`palpate evaluate` on another session tests it"
    if card.split.block_rows is not None:
        return f"{finding.remedy}; until then, {evaluated}"
    return f"{finding.remedy}; until then, `--split blocks` holds out stretches of time, and {evaluated}"


def _tested_on_sessions(card: Card) -> bool:
    return card.sessions is not None and card.sessions.held_out > 1 and card.sessions.column == "session"


COLUMNS = 80  # of a terminal
HEAD = ("target", "unit", "MAE", "of mean", "RMSE", "R2", "90 %", "covered (95 %)")


def scores_table(
    scores: Mapping[str, ScoreCard],
    periods: Mapping[str, float | None] | None = None,
    outside: Collection[str] = (),
) -> str:
    """Return one line per target, and a sentence for those that the model does not read; 80 columns at most.

    Mean absolute error is followed by that of predicting the mean; the 90 % half-width by the covered ratio
    and its 95 % interval.

    Args:
        scores: by target column.
        periods: of circular targets.
        outside: columns whose labels lie outside the calibrated range.
    """
    lines = [HEAD, *(_cells(name, score, (periods or {}).get(name)) for name, score in scores.items())]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEAD))]
    gap = "  " if sum(widths) + 2 * len(HEAD) - 2 <= COLUMNS else " "
    text = [
        gap.join(
            cell.ljust(w) if i < 2 else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    ]
    text += [
        f"{name}: no better than always saying the mean ({score.mae:.3g} against {score.mean_mae:.3g} "
        f"{score.unit}): this model does not read it from these images; another may"
        for name, score in scores.items()
        if score.says_nothing and name not in outside
    ]
    return "\n".join(text)


def _cells(name: str, s: ScoreCard, period: float | None) -> tuple[str, ...]:
    off, ends = mean_error_half_width(s, s.n), (s.coverage_90_low, s.coverage_90_high)
    covered, low, high = (percent(share, *ends) for share in (s.coverage_90, *ends))
    return (
        name,
        s.unit,
        rounded(s.mae, off),
        rounded(s.mean_mae, off),
        rounded(s.rmse, off),
        rounded(s.r2, max(explained_half_width(s, s.n), MIN_R2_HALF_WIDTH)),
        width_text(s.half_width, period),
        f"{covered} ({low}–{high}) %",
    )


def instrument_lines(targets: Sequence[TargetCard]) -> list[str]:
    """Return one line per target whose readings' intervals contain its labels' instrument."""
    return [
        f"{t.column}: ±{half_width_text(t.measured_by.half_width)} {t.unit} of its labels' instrument "
        f"({t.measured_by.instrument}) joins each reading's interval, as a root of squares"
        for t in targets
        if t.measured_by is not None and t.measured_by.half_width > 0
    ]


def confounds_text(card: Card) -> list[str]:
    """Return the findings that precede the numbers, each remedy once."""
    audit = card.confounds
    found = [f for f in audit.findings if f.severity != "notes"] if audit is not None else []
    if audit is None or not found:
        return []
    lines = [audit_head(card)]
    remedies = [remaining_remedy(card, f) for f in found]
    for remedy in dict.fromkeys(remedies):
        lines += [f"- {f.text}." for f, own in zip(found, remedies, strict=True) if own == remedy]
        lines.append(f"  What to do: {remedy}.")
    return [textwrap.fill(x, COLUMNS, subsequent_indent="  ", break_on_hyphens=False) for x in lines]


def latency_line(seconds: Sequence[float]) -> str:
    """Return the median and 95th percentile of the time per frame, without the first frame."""
    ms = 1e3 * np.asarray(seconds[1:] or seconds)
    p50, p95 = np.percentile(ms, [50, 95])
    return f"latency: median {p50:.2f} ms, 95th percentile {p95:.2f} ms over {len(ms)} frames"


def check_text(report: CheckReport) -> str:
    """Return the contents of a run, and whether it is reliable."""
    span = "times not measured" if report.duration_s is None else f"{report.duration_s:.3g} s"
    sensor = report.sensor or "sensor not named"
    lines = [f"{report.path}: {report.frames} frames, {span}, {report.segments} segments, {sensor}"]
    for name, channel in report.channels.items():
        if channel.count:
            rate = "" if channel.rate_Hz is None else f", {channel.rate_Hz:.4g} Hz"
            gap = "" if channel.longest_gap_s is None else f", longest gap {channel.longest_gap_s:.3g} s"
            lines.append(f"  {name}: {channel.count}{rate}{gap}, {channel.dropped} dropped")
    labels = [f"{name} [{unit}]" if unit else name for name, unit in report.labels.items()]
    lines.append(f"labels: {', '.join(labels) or 'none'}")
    lines += [f"  {name} is missing in {count} frames" for name, count in report.missing_labels.items()]
    if report.duplicated_frames:
        lines.append(f"{report.duplicated_frames} frames equal the one before: a frozen camera?")
    if report.orphan_frames:
        lines.append(
            f"{report.orphan_frames} frames have no record of their labels, as after a kill between the two: "
            "nothing counts them, and a plan that goes on records them anew"
        )
    if report.orphan_records:
        lines.append(f"{report.orphan_records} records of labels have no frame: their frames are lost")
    if report.zero_moved_N is not None:
        lines.append(f"the force sensor's zero moved by at most {report.zero_moved_N:.4f} N over a press")
    if report.void_frames:
        lines.append(
            f"{report.void_frames} frames were taken back, since the force was not to be believed: nothing "
            "counts them, and a plan that goes on records them anew"
        )
    lines += [f"damage: {d.file} at byte {d.at_byte}: {d.what}" for d in report.damage]
    remedy = "damaged: `palpate check --repair` copies what can be read into a new run"
    if any("cut" in d.what for d in report.damage):
        remedy += ", and the command that recorded it goes on in this one"
    lines.append("sound" if report.sound else remedy)
    return "\n".join(lines)
