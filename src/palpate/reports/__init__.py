"""Results shown: a calibration's page, and tables for a terminal. Names load when first used."""

from typing import TYPE_CHECKING

from palpate.core.plugins import names_at_first_use

if TYPE_CHECKING:
    from palpate.reports.certificate_page import render_report, write_report
    from palpate.reports.sections import verdict
    from palpate.reports.terminal_text import check_text, latency_line, scores_table

_MODULES = {
    "check_text": "terminal_text",
    "latency_line": "terminal_text",
    "render_report": "certificate_page",
    "scores_table": "terminal_text",
    "verdict": "sections",
    "write_report": "certificate_page",
}

__all__ = ["check_text", "latency_line", "render_report", "scores_table", "verdict", "write_report"]

if not TYPE_CHECKING:  # mypy accepts only the names imported above
    __getattr__, __dir__ = names_at_first_use(__name__, _MODULES, __all__)
