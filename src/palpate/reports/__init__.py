"""Results shown: a calibration's page, and tables for a terminal."""

from palpate.reports.certificate import render_report, verdict, write_report
from palpate.reports.text import check_text, latency_line, scores_table

__all__ = ["check_text", "latency_line", "render_report", "scores_table", "verdict", "write_report"]
