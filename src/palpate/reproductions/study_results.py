"""What a reproduced study leaves: its numbers beside the printed ones, and a page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, NotRequired, TypedDict

import numpy as np

from palpate.core import new_file

REPORT_FILE, SUMMARY_FILE = "report.html", "summary.json"


class Published(NamedTuple):
    """A number, and where it is printed."""

    value: float
    where: str


class StudyEntry(TypedDict):
    """A number: what it is, what was found, its unit, what is printed and where, and why the two differ."""

    name: str
    value: float | None
    unit: str
    published: float | None
    source: str
    why: NotRequired[str]


def study_entry(
    source: str, name: str, value: float | np.floating[Any], unit: str, printed: Published | None = None
) -> StudyEntry:
    """One number, None where it is not finite, beside what `source` prints of it."""
    return StudyEntry(
        name=name,
        value=float(value) if np.isfinite(value) else None,
        unit=unit,
        published=printed.value if printed else None,
        source=f"{source}, {printed.where}" if printed else "",
    )


def write_results(folder: Path, entries: Sequence[StudyEntry], page: str) -> None:
    """Write a study's ``summary.json`` and ``report.html``.

    Raises:
        ExistsError: one of them is there.
        StorageError: the disk refused.
    """
    with new_file(folder / SUMMARY_FILE) as path:
        path.write_text(json.dumps(entries, indent=1, allow_nan=False) + "\n")
    with new_file(folder / REPORT_FILE) as path:
        path.write_text(page, encoding="utf-8")
