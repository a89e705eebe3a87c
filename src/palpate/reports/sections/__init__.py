"""Sections of a calibration's page, the sentences that stand in them, and how far their numbers hold."""

from palpate.reports.sections.certificate_sections import MIN_GROUPS, SECTIONS, ReportedCalibration
from palpate.reports.sections.target_verdicts import (
    MIN_TOLD,
    NOT_TESTED,
    answer,
    found_elsewhere,
    outer_ranges,
    reading_half_width,
    tested_text,
    verdict,
)
from palpate.reports.terminal_text import not_relied_on

__all__ = [
    "MIN_GROUPS",
    "MIN_TOLD",
    "NOT_TESTED",
    "SECTIONS",
    "ReportedCalibration",
    "answer",
    "found_elsewhere",
    "not_relied_on",
    "outer_ranges",
    "reading_half_width",
    "tested_text",
    "verdict",
]
