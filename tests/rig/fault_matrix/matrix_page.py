"""The matrix as a table of numbers and as a page; nothing here runs anything."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path

from tests.rig.fault_matrix.engine_states import STATES
from tests.rig.fault_matrix.fault_injection import OPEN, RigFault
from tests.rig.fault_matrix.grbl_faults import GRBL_FAULTS
from tests.rig.fault_matrix.matrix_cell import MIN_AIR_MM, Cell
from tests.rig.fault_matrix.rig_faults import EVERY_FAULT

DOCS = Path(__file__).resolve().parents[3] / "docs"
CSV, PAGE_FILE = DOCS / "images" / "fault-matrix.csv", DOCS / "explanations" / "fault-matrix.md"
FOLDER = re.compile(r"\S*fault-matrix-\w+/run")  # of the machine that it was measured on
MEASURED = re.compile(r"<!-- (\w+) -->.*?<!-- /\1 -->", re.DOTALL)
"""What the page takes from the cells, between two comments of its name."""
FIRMWARES = ("1.1h", "grblHAL")
NAMES = tuple(field.name for field in fields(Cell))
LENGTHS = ("stop_mm", "bound_mm", "into_mm", "allowed_mm", "height_mm")
Key = tuple[str, str, str]


def keys() -> Iterator[tuple[Key, RigFault]]:
    """All cells that there must be, in the order of the tables."""
    for fault in EVERY_FAULT:
        for state in STATES:
            yield (fault.part, fault.name, state.name), fault
    for firmware in FIRMWARES:
        for fault in GRBL_FAULTS:
            for state in STATES:
                yield (f"{fault.part}, {firmware}", fault.name, state.name), fault


def key_of(cell: Cell) -> Key:
    """Which cell it is."""
    return cell.part, cell.fault, cell.state


def as_csv(cells: Iterable[Cell]) -> str:
    """All that was measured, one cell a line; lengths to a tenth of a micrometre."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(NAMES)
    for cell in cells:
        table.writerow([_written(name, getattr(cell, name)) for name in NAMES])
    return text.getvalue()


def from_csv(text: str) -> list[Cell]:
    """The cells of a table."""
    return [
        Cell(**{name: _read(name, value) for name, value in row.items()})
        for row in csv.DictReader(io.StringIO(text))
    ]


def _written(name: str, value: object) -> str:
    if name in LENGTHS:
        return "" if value is None else f"{value:.4f}"
    return FOLDER.sub("run", str(value))


def _read(name: str, value: str) -> object:
    if name in LENGTHS:
        return None if value == "" else float(value)
    return value == "True" if name == "obeyed" else value


def outcome(cell: Cell) -> str:
    """What a cell came to, in words without numbers: what two runs of the matrix must agree in."""
    words = ["recorded whole" if cell.ended == "done" else f"`{cell.ended}`"]
    if cell.ended != "done" and cell.seen not in (cell.state, "paused"):
        words.append(f"at {cell.seen}")
    if cell.height_mm <= MIN_AIR_MM:
        words.append("**stays**")
    return ", ".join(words)


def shown(cell: Cell) -> str:
    """A cell of the table: its outcome, and the ways."""
    ways = []
    if cell.stop_mm is not None:
        ways.append(f"stop {cell.stop_mm:.3f}" + ("" if cell.obeyed else " (not obeyed)"))
    if cell.into_mm is not None and cell.into_mm > 0:
        ways.append(f"on {cell.into_mm:.3f}")
    return "<br>".join([outcome(cell), *ways])


def table(cells: Sequence[Cell], parts: Sequence[str], faults: Sequence[RigFault]) -> str:
    """The table of some faults, one a row, with the states as columns."""
    found = {key_of(cell): cell for cell in cells}
    lines = ["| fault | " + " | ".join(state.name for state in STATES) + " |", "|---|" + "---|" * len(STATES)]
    for part, fault in zip(parts, faults, strict=True):
        row = [shown(found[part, fault.name, state.name]) for state in STATES]
        lines.append(f"| {fault.part}: {fault.name} | " + " | ".join(row) + " |")
    return "\n".join(lines)


def page(cells: Sequence[Cell]) -> str:
    """The page of the matrix as it is, with what was measured put in anew."""
    virtual = [cell for cell in cells if "," not in cell.part]
    grbl = [cell for cell in cells if "," in cell.part]
    tables = [
        "### " + firmware_title(firmware) + "\n\n"
        + table(grbl, [f"{fault.part}, {firmware}" for fault in GRBL_FAULTS], GRBL_FAULTS)
        for firmware in FIRMWARES
    ]  # fmt: skip
    values = {
        "states": len(STATES),
        "faults": len(EVERY_FAULT),
        "grbl_faults": len(GRBL_FAULTS),
        "cells": len(cells),
        "counts": _counts(cells),
        "stops": _stops(cells),
        "table": _block(table(virtual, [fault.part for fault in EVERY_FAULT], EVERY_FAULT)),
        "firmwares": _block("\n\n".join(tables)),
        "stays": _block("| why | cells |\n|---|---|\n" + _stays(cells)),
        "elsewhere": _block("| fault | in | why |\n|---|---|---|\n" + _elsewhere()),
        "open": ", ".join(f"{fault.part}: {fault.name}" for fault in EVERY_FAULT if fault.within == OPEN),
    }
    text = PAGE_FILE.read_text(encoding="utf-8")
    return MEASURED.sub(lambda m: f"<!-- {m[1]} -->{values[m[1]]}<!-- /{m[1]} -->", text)


def _block(text: str) -> str:
    return f"\n\n{text}\n\n"


def firmware_title(firmware: str) -> str:
    """Name of a fake's firmware in a heading."""
    return "Fake of Grbl 1.1h" if firmware == "1.1h" else "Fake of grblHAL"


def _counts(cells: Sequence[Cell]) -> str:
    whole = sum(cell.ended == "done" for cell in cells)
    stays = sum(cell.height_mm <= MIN_AIR_MM for cell in cells)
    on = sum(not cell.went_on for cell in cells)
    return (
        f"In {len(cells) - whole} the fault ended the recording by name, in {whole} it was recorded whole. "
        f"In {len(cells) - stays} the probe ended in the air, in {stays} it stayed where it was. In {on} of "
        f"{len(cells)} the same command, given again on a sound rig, ended with exactly the plan's frames."
    )


def _stops(cells: Sequence[Cell]) -> str:
    stops = [one for one in cells if one.stop_mm is not None and one.bound_mm and one.obeyed]
    share = max(one.stop_mm / one.bound_mm for one in stops)
    return f"{len(stops)} cells have a stop in motion; the longest came to {100 * share:.0f} % of its bound."


def _stays(cells: Sequence[Cell]) -> str:
    why = {key: fault.stays for key, fault in keys()}
    stays = Counter(why[key_of(cell)] for cell in cells if cell.height_mm <= MIN_AIR_MM)
    return "\n".join(f"| {reason} | {count} |" for reason, count in sorted(stays.items()))


def _elsewhere() -> str:
    rows = []
    for fault in (*EVERY_FAULT, *GRBL_FAULTS):
        whys: dict[str, list[str]] = {}
        for state, otherwise in fault.elsewhere.items():
            whys.setdefault(otherwise.why, []).append(state)
        rows += [
            f"| {fault.part}: {fault.name} | {', '.join(states)} | {why} |" for why, states in whys.items()
        ]
    return "\n".join(rows)
