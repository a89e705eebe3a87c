"""A calibration as one page to send to a colleague: text, table and pictures in a single HTML file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from palpate.core import PathText, half_width_text, new_file, rounded
from palpate.estimators.certified import check_files, read_card
from palpate.estimators.model_card import Card
from palpate.reports.evaluation_text import class_covered, classes_told
from palpate.reports.sections import SECTIONS, ReportedCalibration
from palpate.reports.terminal_text import (
    MIN_R2_HALF_WIDTH,
    explained_half_width,
    mean_error_half_width,
    percent,
    width_text,
)


def write_report(calibration: PathText, out: PathText) -> Path:
    """Write a calibration's report as one HTML file.

    Args:
        calibration: calibration folder.
        out: HTML file to make; must not exist.
    """
    calibration, out = Path(calibration), Path(out)
    card = read_card(calibration)
    check_files(calibration, card)
    text = render_report(calibration, card)
    with new_file(out) as path:
        path.write_text(text, encoding="utf-8")
    return out


def render_report(calibration: Path, card: Card) -> str:
    """Render the report's HTML: the sections that have content."""
    report = ReportedCalibration(calibration, card)
    found = {section.__name__: section(report) for section in SECTIONS}
    shown = {name: values for name, values in found.items() if values is not None}
    return filled_template("certificate.html", card=card, sections=shown)


def filled_template(name: str, package: str = "palpate.reports", /, **values: Any) -> str:
    """Fill a page of a package's folder `templates`, which may include those of `palpate.reports`."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("palpate.reports")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    environment.filters["g"] = lambda value: "–" if value is None else f"{value:.3g}"
    environment.filters["four"] = lambda value: "–" if value is None else f"{value:.4g}"
    environment.filters["pc"] = lambda share: f"{100 * share:.1f} %"
    environment.filters["two"] = lambda value: rounded(value, abs(value))
    environment.filters["r"] = _two_decimals
    environment.filters["joint"] = lambda v, part="covered": percent(getattr(v, part), v.low, v.high)
    environment.filters["share"] = lambda c: percent(c["covered"], c["low"], c["high"])
    environment.filters["code"] = _with_code
    environment.filters["setting"] = _setting_text
    environment.filters["to"] = rounded
    environment.filters["wide"] = width_text
    environment.filters["half"] = half_width_text
    environment.filters["mae"] = lambda s, groups, part="mae": rounded(
        getattr(s, part), mean_error_half_width(s, groups)
    )
    environment.filters["r2"] = lambda s, groups: rounded(
        s.r2, max(explained_half_width(s, groups), MIN_R2_HALF_WIDTH)
    )
    environment.filters["covered"] = lambda s, part="coverage_90": (
        f"{percent(getattr(s, part), s.coverage_90_low, s.coverage_90_high)} %"
    )
    environment.filters["classes_told"] = lambda card: classes_told(card, card.score)
    environment.filters["class_covered"] = class_covered
    return environment.get_template(name).render(**values)


def _with_code(text: str) -> Markup:
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text))))  # noqa: S704 -- escaped before


def _two_decimals(value: float | None) -> str:
    """R² for a table: two decimals, and no minus before nothing."""
    return "–" if value is None else f"{round(value, 2) + 0.0:.2f}"


def _setting_text(value: Any) -> str:
    """A model's setting as a person writes it: 0.000316 for 0.00031622776601683794."""
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, list | tuple):
        return ", ".join(_setting_text(one) for one in value) or "none"
    return str(value)
