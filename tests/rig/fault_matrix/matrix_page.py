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
    """The page of the matrix."""
    virtual = [cell for cell in cells if "," not in cell.part]
    grbl = [cell for cell in cells if "," in cell.part]
    tables = [
        "### " + firmware_title(firmware) + "\n\n"
        + table(grbl, [f"{fault.part}, {firmware}" for fault in GRBL_FAULTS], GRBL_FAULTS)
        for firmware in FIRMWARES
    ]  # fmt: skip
    return PAGE.format(
        states=len(STATES), faults=len(EVERY_FAULT), grbl_faults=len(GRBL_FAULTS), cells=len(cells),
        virtual=len(virtual), grbl=len(grbl), counts=_counts(cells), stops=_stops(cells),
        table=table(virtual, [fault.part for fault in EVERY_FAULT], EVERY_FAULT),
        firmwares="\n\n".join(tables), stays=_stays(cells), elsewhere=_elsewhere(),
        open=", ".join(f"{fault.part}: {fault.name}" for fault in EVERY_FAULT if fault.within == OPEN),
    )  # fmt: skip


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


PAGE = """# What happens when something fails

Every fault of the list below was let into a recording in every state of the engine, and it was measured
what the rig did. A tool writes this page (`python tools/rig_fault_matrix.py`), and a test runs all of it
again. **All devices are simulated: the virtual palm's rig, and the fake of a GRBL controller with the
driver that drives real ones. Firmware unproven: no real controller has run here**, and what is bounded is
bounded on these alone. A rig needs a switch that cuts the power.

{faults} faults of the rig in {states} states, and {grbl_faults} of a GRBL stage in the same states on fakes
of two firmwares, are {cells} cells; none is empty.
The six rows at the end of the first table, of late, silent and scaled force, were measured after repeated
presses and the guarded first approach had been added, the others before.
{counts}

A fault sets in while the engine is in one of these states:

| state | when |
|---|---|
| idle | the devices are open, and the recording is not begun |
| travel | on its way, in the air, to the next place |
| seek | just above the skin, on its way to contact |
| press | on its way down, 0.75 mm deep or more |
| hold | at a stand in the skin, taking frames |
| slide | on its way aside, in the skin |
| retreat | on its way up, in the skin |
| taps | on its way down in a tap that sets the clocks |
| pause | lifted, waiting for the operator |
| resume | just told to go on |

## How to read a cell

- `force-stale`: the name with which the recording ended (a reason of the run's events, `aborted`,
  `e-stopped`, `stopped`, or the exception of a program that was ended). *recorded whole*: nothing ended it,
  and the run holds the plan; a press that a transient fault interrupted was repeated. *at zero*: in that
  state it did no harm, and was seen in this later one.
- **stays**: the probe was not lifted. Everywhere else it hung in the air at the end, above the skin's own
  surface.
- *stop*: way from asking for a stop until the stage truly stood [mm], of the stop that came nearest to its
  bound, v² / 2a + v·latency. On the virtual stage it is counted from the request (0.5 m/s², 4 ms: 0.012 mm
  at 2 mm/s, 0.48 mm at 20 mm/s), on the fakes from the byte, by the fake's own steps (50 mm/s², 20 ms and a
  tick of 2 ms: 0.084 mm at 2 mm/s). {stops} No number: nothing was stopped in motion.
- *on*: way towards the skin or along it from when the fault showed [mm]. A wrong force shows where the
  newest force read lies five standard deviations off the true one, and 0.2 mm are allowed from there. A
  sensor that falls silent may cost v·`age_s` and the stop, anything told at once v·`force_latency_s` and
  the stop, a stage that is gone the move that it was sent, 0.2 mm.

All numbers, with their bounds, are in `docs/images/fault-matrix.csv`.

## The rig

{table}

Guard and recorder are one process here. On a rig whose file names real devices a
[supervisor](../decisions/0025-a-process-of-its-own-guards.md) guards, and lifts the probe of a programme that
is killed or stands still as well; tests of its own show that, with processes that are killed and stopped.

No way is bounded, since nothing is pressed by them, for {open}.

## A GRBL stage

Other parts are virtual. Time runs on while an answer is awaited, and sleeps are skipped, so ways differ by
some micrometres from run to run. On a machine whose cores are all busy, a press on Grbl 1.1 that somebody
else holds was named `force-dead` in two of three runs: its force stopped rising before the status that
says so had come.

{firmwares}

## Where the probe stays

| why | cells |
|---|---|
{stays}

## Where a fault has another name, or does nothing

| fault | in | why |
|---|---|---|
{elsewhere}

## What the list leaves out

Refused before anything moves, or tried elsewhere: a Net F/T's records of a wrong length, repeated, lost or
from elsewhere, its start that is lost, its pages that lie (`tests/rig/test_netft_faults.py`,
`test_netft_calibration.py`); a banner that comes late and a machine that is not homed
(`tests/rig/test_grbl_faults.py`); numbers that a controller would misread; files cut or altered at any byte
(`tests/recordings`). The driver sends no probing lines, so that probing cannot fail. A zero is never taken
in contact that the force before can tell; from the first one on it cannot be told, where the skin is
touched at the clearance by less than 1 N. A stage that creeps without saying so can be
taken for a force that is dead.
"""
