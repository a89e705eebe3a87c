"""What a reproduced study leaves: its numbers beside the printed ones, and a page."""

from __future__ import annotations

import json
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NotRequired, TypedDict

import numpy as np

from palpate.core import ExistsError, new_file, refuse_existing, storage_errors

REPORT_FILE, SUMMARY_FILE, ASKED_FILE = "report.html", "summary.json", "study.json"


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
    """Write a study's ``summary.json`` and ``report.html``."""
    with new_file(folder / SUMMARY_FILE) as path:
        path.write_text(json.dumps(entries, indent=1, allow_nan=False) + "\n")
    with new_file(folder / REPORT_FILE) as path:
        path.write_text(page, encoding="utf-8")


def unfinished_work(out: Path, asked: Mapping[str, Any]) -> Path:
    """The folder beside `out` in which a study is made, new or found again.

    Args:
        out: folder that the study becomes when all is done.
        asked: what decides the study's results; work of another kind is not gone on with.
    """
    refuse_existing(out)
    work, wanted = out.with_name(f".{out.name}.work"), json.dumps(asked)
    note = work / ASKED_FILE
    if note.is_file() and note.read_text() != wanted:
        raise ExistsError(
            f"{work} holds unfinished work of another scale, seed or part ({note.read_text()}); run that one "
            "again to finish it, remove the folder, or choose another --out",
            code="work-of-another",
        )
    if not note.is_file():
        with storage_errors(work):
            work.mkdir(parents=True, exist_ok=True)
        with new_file(note) as path:
            path.write_text(wanted)
    return work


def kept_result(folder: Path, name: str, make: Callable[[], Any]) -> Any:
    """A result as plain values, made once; beside it the time that took, and the processor's."""
    path = folder / "results" / f"{name}.json"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        begun, cpu_begun = time.monotonic(), cpu_seconds()
        result = make()
        document = {
            "seconds": round(time.monotonic() - begun, 1),
            "cpu_seconds": round(cpu_seconds() - cpu_begun, 1),
            "found": result,
        }
        with new_file(path) as temporary:
            temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
    return json.loads(path.read_text())["found"]


def cpu_seconds() -> float:
    """Processor time of this process and of those that it has waited for [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def kept_seconds(folder: Path) -> dict[str, float]:
    """Time that each kept result took by the clock [s]."""
    files = sorted((folder / "results").glob("*.json"))
    return {path.stem: float(json.loads(path.read_text())["seconds"]) for path in files}
