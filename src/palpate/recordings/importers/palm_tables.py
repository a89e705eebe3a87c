"""The photoelastic palm's tables: one a press, named by its place and cycle, force samples in its rows."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from palpate.core.errors import InputError, LabelError
from palpate.core.files import storage_errors
from palpate.recordings.labels import FIRST_ROW, label_kinds, read_labels

NEAR_MM = 0.05  # within which two notes of one depth or place agree: half a step
_TABLE = re.compile(r"Cycle_Indent(\d+(?:\.\d+)?)mm_r(\d{1,3})c(\d{1,3})_(\d{1,4})\.csv", re.ASCII)
_NUMBERS = ("t_s", "indent_mm", "Fx", "Fy", "Fz", "x_mm", "y_mm")
_PHASES = ("down", "up")
_MOST_TABLE_BYTES = 1 << 24  # a press has some 260 rows of 100 bytes


@dataclass(frozen=True, slots=True)
class Press:
    """One table's name, taken apart."""

    path: Path
    deepest_mm: float
    row: int
    column: int
    cycle: int

    @property
    def location(self) -> str:
        return f"r{self.row}c{self.column}"

    @property
    def name(self) -> str:
        return f"{self.location}/{self.cycle}"


def presses_in(folder: Path) -> list[Press]:
    """The presses that a folder has tables of, by place and cycle.

    Raises:
        InputError: no folder, or it has no tables.
        LabelError: a table with another name, or two of one press.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder of tables; check the name")
    with storage_errors(folder):
        tables = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".csv")
    if not tables:
        raise InputError(
            f"{folder} holds no table Cycle_Indent5mm_r4c6_1.csv or alike; name the tables' folder"
        )
    presses = sorted((_press(path) for path in tables), key=lambda one: (one.row, one.column, one.cycle))
    for one, next_ in itertools.pairwise(presses):
        if one.name == next_.name:
            raise LabelError(
                f"{one.path} and {next_.path} are of the same press, {one.name}; keep one of them"
            )
    return presses


def _press(path: Path) -> Press:
    found = _TABLE.fullmatch(path.name)
    if found is None:
        raise LabelError(
            f"{path} is not named as Cycle_Indent5mm_r4c6_1.csv is, which tells depth, row, column and "
            "cycle; rename it, or move it away"
        )
    deepest, row, column, cycle = found.groups()
    return Press(path, float(deepest), int(row), int(column), int(cycle))


def table_of(press: Press) -> pd.DataFrame:
    """A press's samples, in the table's order, every number finite.

    Raises:
        LabelError: the table is damaged, lacks a column, or holds what it must not; says in which row.
    """
    path = press.path
    with storage_errors(path):
        size = path.stat().st_size
    if size > _MOST_TABLE_BYTES:
        raise LabelError(f"{path} has {size} bytes; a press has {_MOST_TABLE_BYTES} at most")
    table = read_labels(path, kinds={})
    missing = [name for name in (*_NUMBERS, "phase", "image_file") if name not in table.columns]
    if missing:
        raise LabelError(
            f"{path}, row 1 has no column {', '.join(map(repr, missing))}; its columns are "
            f"{', '.join(map(str, table.columns))}"
        )
    for name in _NUMBERS:
        _check_numbers(table[name], name, path, is_number=label_kinds(table)[name] == "number")
    for i, phase in enumerate(table["phase"]):
        if phase not in _PHASES:
            raise LabelError(f"{path}, row {i + FIRST_ROW}: phase is {phase!r}; it is down or up")
    for i, depth in enumerate(table["indent_mm"]):
        if not -NEAR_MM <= depth <= press.deepest_mm + NEAR_MM:
            raise LabelError(
                f"{path}, row {i + FIRST_ROW}: indent_mm is {depth:g}, and the file's name says 0 to "
                f"{press.deepest_mm:g} mm"
            )
    return table


def _check_numbers(column: pd.Series, name: str, path: Path, *, is_number: bool) -> None:
    for i, cell in enumerate(column):
        if not is_number and isinstance(cell, str) and _is_finite(cell):
            continue
        if not is_number or not np.isfinite(cell):
            raise LabelError(
                f"{path}, row {i + FIRST_ROW}: {name} is {str(cell)[:40]!r}, no finite number; fill it "
                "in, or remove the press"
            )


def _is_finite(cell: str) -> bool:
    try:
        return "_" not in cell and bool(np.isfinite(float(cell)))  # Python reads 1_000, a table does not
    except ValueError:
        return False
