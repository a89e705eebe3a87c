"""A calibration as one page to send to a colleague: text, table and pictures in a single HTML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from palpate.core.files import new_file
from palpate.estimators.card import Card, ScoreCard, TargetCard
from palpate.estimators.certified import checked_file, read_card
from palpate.reports.figures import picture, surface_columns, surface_figure, target_figure

PREDICTIONS_FILE = "predictions.parquet"


@dataclass(frozen=True, slots=True)
class _Worst:
    picture: str
    frame: str
    said: str


def write_report(calibration: Path, out: Path) -> Path:
    """Write a calibration's report.

    Args:
        calibration: the calibration folder.
        out: the HTML file to make; must not exist.

    Raises:
        CertificateError: the folder is damaged.
        ExistsError: `out` exists.
    """
    card = read_card(calibration)
    for part in card.files:
        checked_file(calibration, part)
    text = render_report(calibration, card)
    with new_file(out) as path:
        path.write_text(text, encoding="utf-8")
    return out


def render_report(calibration: Path, card: Card) -> str:
    """The report's HTML."""
    table = pd.read_parquet(calibration / PREDICTIONS_FILE)
    where = surface_columns(table)
    environment = Environment(
        loader=PackageLoader("palpate.reports"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["g"] = lambda value: f"{value:.3g}"
    example, reference = calibration / "example.png", calibration / "reference.png"
    return environment.get_template("certificate.html").render(
        card=card,
        figures={target.column: target_figure(target, table) for target in card.targets},
        verdicts={target.column: verdict(target) for target in card.targets},
        surface=surface_figure(card.targets, table, where) if where else "",
        where=where,
        worst=_worst(calibration, card, table),
        example=picture(example) if example.exists() else "",
        reference=picture(reference) if reference.exists() else "",
    )


def verdict(target: TargetCard) -> str:
    """What a target's scores mean, in a sentence."""
    s = target.score
    if s.says_nothing:
        return (
            f"This model does not read {target.quantity.replace('_', ' ')} from these images: the error, "
            f"{s.mae:.3g} {s.unit}, is no better than always saying the mean ({s.mean_mae:.3g} {s.unit}). "
            "Do not use this reading; another model may read it."
        )
    return (
        f"Off by {s.mae:.3g} {s.unit} on average, {s.mean_mae / s.mae:.1f} times less than always saying the "
        f"mean. The 90 % intervals are ±{s.half_width:.3g} {s.unit} wide on average and held the truth in "
        f"{100 * s.coverage_90:.1f} % of rows (95 % interval {100 * s.coverage_90_low:.1f} to "
        f"{100 * s.coverage_90_high:.1f} %), {_kept(s)}."
    )


def _kept(s: ScoreCard) -> str:
    """Whether the intervals keep their promise."""
    if s.coverage_90_high < 0.9:
        return "less often than they promise"
    return "as promised" if s.coverage_90_low <= 0.9 else "more often than they promise: they are wide"


def _worst(calibration: Path, card: Card, table: pd.DataFrame) -> list[_Worst]:
    found = []
    for path in sorted(calibration.glob("worst-*.png"), key=lambda p: int(p.stem.split("-")[1])):
        row = table[table["row"] == int(path.stem.split("-")[1])].iloc[0]
        target = max(card.targets, key=lambda t: _error(row, t) / (t.greatest - t.least))
        found.append(_Worst(picture(path), str(row["frame"]), _said(row, target)))
    return found


def _error(row: pd.Series, target: TargetCard) -> float:
    return abs(float(row[f"estimate:{target.column}"]) - float(row[target.column]))


def _said(row: pd.Series, target: TargetCard) -> str:
    guess, half = row[f"estimate:{target.column}"], row[f"half_width:{target.column}"]
    return (
        f"{target.quantity.replace('_', ' ')} {guess:.3g} ± {half:.2g} {target.unit}, "
        f"truth {row[target.column]:.3g} {target.unit}"
    )
