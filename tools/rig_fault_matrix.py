"""Let every fault into a recording in every state of the engine, and write what happened as a page.

    python tools/rig_fault_matrix.py                      # all cells, two at a time; about twenty minutes
    python tools/rig_fault_matrix.py --only "force:"      # some, by part, fault and state; writes nothing

All devices are simulated: the virtual palm's rig, and fakes of a GRBL controller. Writes
docs/explanations/fault-matrix.md and docs/images/fault-matrix.csv. The exit status is 1 where a cell breaks
its law: a name that is not the fault's, a stop beyond v^2 / 2a + v latency, a probe that stays in the skin
though it could be lifted, or a run that the same command does not complete.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "src")]

from tests.rig.fault_matrix.engine_states import GRBL_STATES, STATES  # noqa: E402
from tests.rig.fault_matrix.fault_injection import RigFault  # noqa: E402
from tests.rig.fault_matrix.matrix_cell import Cell, faults_of, run_cell, run_grbl_cell  # noqa: E402
from tests.rig.fault_matrix.matrix_page import CSV, PAGE_FILE, Key, as_csv, from_csv, key_of, keys, page  # noqa: E402

ALL = dict(keys())


def run(key: Key) -> tuple[Cell, list[str]]:
    """One cell, and what it breaks of the law; on a fake, whose time is real, at the second try."""
    fault, (part, _, state) = ALL[key], key
    if ", " not in part:
        cell = run_cell(fault, next(one for one in STATES if one.name == state))
        return cell, faults_of(cell, fault)
    there, firmware = next(one for one in GRBL_STATES if one.name == state), part.split(", ")[1]
    return run_grbl(fault, there, firmware)


def run_grbl(fault: RigFault, state: object, firmware: str) -> tuple[Cell, list[str]]:
    """A cell of a fake: a busy machine may end a recording before the fault; then it is begun again."""
    for _ in range(2):
        try:
            cell = run_grbl_cell(fault, state, firmware)  # type: ignore[arg-type]
        except AssertionError as e:
            never = e
        else:
            return cell, faults_of(cell, fault)
    raise never


def run_all(wanted: list[Key], processes: int) -> Iterator[tuple[Cell, list[str]]]:
    """Cells in the order of the tables, each in a process that has run few others."""
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        yield from pool.map(run, wanted)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="*", default=[], help="cells whose 'part: fault / state' has this")
    parser.add_argument("--write", action="store_true", help="with --only: put these cells into the page")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    named = {key: f"{key[0]}: {key[1]} / {key[2]}" for key in ALL}
    wanted = [key for key in ALL if not args.only or any(text in named[key] for text in args.only)]
    cells, broken = [], 0
    for key, (cell, faults) in zip(wanted, run_all(wanted, args.processes), strict=True):
        cells.append(cell)
        broken += bool(faults)
        print(f"{len(cells)}/{len(wanted)} {named[key]}: {cell.ended} at {cell.seen}", *faults, flush=True)
    if args.only and args.write:
        known = {key_of(cell): cell for cell in (*from_csv(CSV.read_text(encoding="utf-8")), *cells)}
        cells = [known[key] for key in ALL]  # a fault that is new has its place too
    if args.write or not args.only:
        CSV.write_text(as_csv(cells), encoding="utf-8")
        written = from_csv(CSV.read_text(encoding="utf-8"))  # rounded there
        PAGE_FILE.write_text(page(written), encoding="utf-8")
    print(f"{len(cells)} cells, {broken} of them break the law")
    return int(broken > 0)


if __name__ == "__main__":
    raise SystemExit(main())
