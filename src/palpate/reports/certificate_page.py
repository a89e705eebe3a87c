"""A calibration as one page to send to a colleague: text, table and pictures in a single HTML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from palpate.calibration.certificate import read_predictions
from palpate.calibration.conformal import few_groups_coverage_interval
from palpate.calibration.coverage import target_findings
from palpate.calibration.evaluation import groups_in
from palpate.core import PathText, new_file
from palpate.estimators.certified import checked_file, read_card
from palpate.estimators.model_card import Card, ScoreCard, TargetCard
from palpate.recordings.label_tables import OWN, own_column
from palpate.reports.calibration_figures import (
    errors_of,
    held_rows,
    picture,
    surface_columns,
    surface_figure,
    target_columns,
    target_figure,
)
from palpate.reports.class_section import class_answer, class_section

OUTER_SHARE = 0.1
"""Share of the scored rows, by their truth, that an outer range holds."""
MIN_OUTER_ROWS = 20
"""Rows that an outer range holds at least; with fewer, a rate of 90 % cannot be told from one of 70 %."""
MIN_TOLD = 0.7
"""Rate below which the interval of a range's coverage must not reach, if it shall tell of 90 %."""


@dataclass(frozen=True, slots=True)
class OuterRange:
    """Held-out rows at one end of a target's range, and how often their intervals covered the truth.

    Attributes:
        where: the range in words with its unit, e.g. "above 5.5 mm".
        n: rows.
        covered: rows whose interval covered the truth.
        low, high: 95 % interval of the covered share, groups counted as groups.
        bias: mean signed error [the target's unit].
    """

    where: str
    n: int
    covered: int
    low: float
    high: float
    bias: float


def write_report(calibration: PathText, out: PathText) -> Path:
    """Write a calibration's report.

    Args:
        calibration: the calibration folder.
        out: the HTML file to make; must not exist.

    Raises:
        CertificateError: the folder is damaged.
        ExistsError: `out` exists.
        MissingExtraError: its predictions were written as Parquet, and pyarrow is not installed.
    """
    calibration, out = Path(calibration), Path(out)
    card = read_card(calibration)
    for part in card.files:
        checked_file(calibration, part)
    text = render_report(calibration, card)
    with new_file(out) as path:
        path.write_text(text, encoding="utf-8")
    return out


def render_report(calibration: Path, card: Card) -> str:
    """The report's HTML."""
    table = read_predictions(calibration, card)
    where, groups = surface_columns(table), groups_in(table, card.split.columns)
    example, reference = calibration / "example.png", calibration / "reference.png"
    return filled_template(
        "certificate.html",
        card=card,
        figures={target.column: target_figure(target, table, groups) for target in card.targets},
        verdicts={t.column: verdict(t, outer_ranges(t, table, groups)) for t in card.targets},
        findings={t.column: target_findings(t, card.coverage) for t in card.targets},
        surface=surface_figure(card.targets, table, where) if where and card.targets else "",
        classes=class_section(card),
        where=where,
        worst=_worst(calibration, card, table),
        example=picture(example) if example.exists() else "",
        reference=picture(reference) if reference.exists() else "",
    )


def filled_template(name: str, **values: Any) -> str:
    """A page of `reports/templates`; its filters write three significant digits, and a share in percent."""
    environment = Environment(
        loader=PackageLoader("palpate.reports"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["g"] = lambda value: "–" if value is None else f"{value:.3g}"
    environment.filters["pc"] = lambda share: f"{100 * share:.1f} %"
    return environment.get_template(name).render(**values)


def outer_ranges(target: TargetCard, table: pd.DataFrame, groups: np.ndarray) -> tuple[OuterRange, ...]:
    """The lowest and the highest tenth of a target's scored rows, by the truth; none where rows are few.

    Args:
        target: whose range it is.
        table: the held-out predictions, a row a frame.
        groups: ``[n]`` label of each row's group.
    """
    true, estimate, _ = target_columns(target, table)
    error = errors_of(target, true, estimate)
    inside = held_rows(target, table)
    count = max(int(OUTER_SHARE * len(true)), MIN_OUTER_ROWS)
    if 2 * count > len(true):
        return ()
    lowest, highest = np.sort(true)[[count - 1, -count]]
    ranges = []
    # Rows that share the limit's truth belong to the range too, as with a few dead weights.
    for word, limit, rows in (("below", lowest, true <= lowest), ("above", highest, true >= highest)):
        low, high = few_groups_coverage_interval(inside[rows], groups[rows])
        where, covered = f"{word} {limit:.3g} {target.unit}", int(inside[rows].sum())
        ranges.append(OuterRange(where, int(rows.sum()), covered, low, high, float(error[rows].mean())))
    return tuple(ranges)


def verdict(target: TargetCard, ends: tuple[OuterRange, ...] = ()) -> str:
    """Meaning of a target's scores, in a sentence.

    Args:
        target: its card.
        ends: its outer ranges; none where the rows are too few to judge them.
    """
    s = target.score
    if s.says_nothing:
        return (
            f"This model does not read {target.quantity.replace('_', ' ')} from these images: the error, "
            f"{s.mae:.3g} {s.unit}, is no better than always saying the mean ({s.mean_mae:.3g} {s.unit}). "
            "Do not use this reading; another model may read it."
        )
    return (
        f"Off by {s.mae:.3g} {s.unit} on average, {s.mean_mae / s.mae:.1f} times less than always saying the "
        f"mean. The 90 % intervals are ±{s.half_width:.3g} {s.unit} wide on average and covered the truth in "
        f"{100 * s.coverage_90:.1f} % of rows (95 % interval {100 * s.coverage_90_low:.1f} to "
        f"{100 * s.coverage_90_high:.1f} %), {_promise(s, ends)}."
    )


def _promise(s: ScoreCard, ends: tuple[OuterRange, ...]) -> str:
    """Judgement of the intervals' promise, over all rows and at both ends of the range."""
    failed = [end for end in ends if end.high < 0.9]
    unsure = [end for end in ends if end.low <= MIN_TOLD and end not in failed]
    named = "; ".join(
        f"{end.where} only {_covered(end)}, with a mean error of {end.bias:+.3g} {s.unit}" for end in failed
    )
    told = f"; too few rows or groups to judge {', '.join(f'{e.where}: {_covered(e)}' for e in unsure)}"
    more = told if unsure else ""
    if s.coverage_90_high < 0.9:
        return f"less often than they promise{'; ' if named else ''}{named}{more}"
    if failed:
        return f"but not over the whole range: {named}{more}"
    if s.coverage_90_low > 0.9:
        return f"more often than they promise: they are wide{more}"
    if not ends:
        return "as promised over all rows; there are too few to judge the ends of the range"
    return f"as promised over all rows{more}" if unsure else "as promised, at both ends of the range too"


def _covered(end: OuterRange) -> str:
    return f"{end.covered} of {end.n} (95 % interval {100 * end.low:.1f} to {100 * end.high:.1f} %)"


def _worst(calibration: Path, card: Card, table: pd.DataFrame) -> list[dict[str, str]]:
    """Picture, name and estimate of each frame that was missed most."""
    frames = []
    for number in sorted(int(path.stem.split("-")[1]) for path in calibration.glob("worst-*.png")):
        row = table[own_column(table, "row") == number].iloc[0]
        name = str(row[f"{OWN}frame" if f"{OWN}frame" in row else "frame"])
        shown = picture(calibration / f"worst-{number}.png")
        frames.append({"picture": shown, "frame": name, "said": _said(row, card)})
    return frames


def _said(row: pd.Series, card: Card) -> str:
    if not card.targets:
        return class_answer(row, card)
    return _estimate_text(row, max(card.targets, key=lambda t: _error(row, t) / (t.greatest - t.least)))


def _error(row: pd.Series, target: TargetCard) -> float:
    true, estimate = (np.array([float(row[name])]) for name in (target.column, f"estimate:{target.column}"))
    return abs(float(errors_of(target, true, estimate)[0]))


def _estimate_text(row: pd.Series, target: TargetCard) -> str:
    guess, half = row[f"estimate:{target.column}"], row[f"half_width:{target.column}"]
    return (
        f"{target.quantity.replace('_', ' ')} {guess:.3g} ± {half:.2g} {target.unit}, "
        f"truth {row[target.column]:.3g} {target.unit}"
    )
