"""Sections of a calibration's page, the sentences that stand in them, and how far their numbers hold."""

from palpate.reports.sections.certificate_sections import MIN_GROUPS, SECTIONS, ReportedCalibration
from palpate.reports.sections.target_verdicts import (
    NOT_TESTED,
    answer,
    found_elsewhere,
    reading_half_width,
    tested_text,
    verdict,
)
from palpate.reports.terminal_text import not_relied_on

__all__ = [
    "MIN_GROUPS",
    "NOT_TESTED",
    "SECTIONS",
    "ReportedCalibration",
    "answer",
    "found_elsewhere",
    "not_relied_on",
    "reading_half_width",
    "tested_text",
    "verdict",
]
