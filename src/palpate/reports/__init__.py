"""Results shown: a calibration's page, and tables for a terminal.

The names here load when they are first used, so that printing a table loads no page.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

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

__all__ = [
    "check_text",
    "latency_line",
    "render_report",
    "scores_table",
    "verdict",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"palpate.reports.{_MODULES[name]}"), name)
    raise AttributeError(f"palpate.reports has no {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return __all__
