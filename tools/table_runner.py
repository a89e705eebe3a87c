"""What all scripts that make shipped tables have in common: presses in a folder, and what is made of them.

python tools/X_tables.py solved                  # solves what the folder does not hold yet, press by press
python tools/X_tables.py solved --only NAME      # of these presses alone
python tools/X_tables.py solved --out FOLDER     # the same, and writes the tables
python tools/X_tables.py solved --check          # the same on the study's meshes, and writes the study
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy import ndarray

HERE = Path(__file__).parent
Arrays = dict[str, ndarray]
Solve = Callable[[Path], None]


def kept(path: Path) -> Arrays:
    """What was solved."""
    with np.load(path) as arrays:
        return {name: arrays[name] for name in arrays.files}


def write(path: Path, arrays: Mapping[str, object]) -> None:
    """Write a table, and say how large it is."""
    np.savez_compressed(path, **arrays)
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB", flush=True)


def write_study(name: str, found: object) -> None:
    """Write a study beside the tools."""
    (HERE / f"{name}_study.json").write_text(json.dumps(found, indent=1) + "\n")


def run(
    doc: str,
    presses: Mapping[str, Solve],
    tables: Callable[[Path, Path], None],
    study: Callable[[Path], None] | None = None,
    studied: Mapping[str, Solve] | None = None,
) -> None:
    """The command line of a script.

    Args:
        presses: by the name of the file that each writes: what the tables are made of.
        tables: from the folder of these files to the folder of the tables.
        study: writes the study, from the folder of all files; None where there is none.
        studied: presses that the study needs besides.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("solved", type=Path, help="folder of what was solved; files that are there are kept")
    parser.add_argument("--only", metavar="NAME", action="append", help="solve these presses alone")
    parser.add_argument("--out", type=Path, help="folder for the tables")
    parser.add_argument("--check", action="store_true", help="write the study")
    asked = parser.parse_args()
    asked.solved.mkdir(parents=True, exist_ok=True)
    known = {**presses, **((studied or {}) if asked.check or asked.only else {})}
    if unknown := set(asked.only or ()) - set(known):
        parser.error(f"{', '.join(sorted(unknown))}: there are {', '.join(known)}")
    for name in asked.only or known:
        if not (path := asked.solved / f"{name}.npz").exists():
            started = time.process_time()
            known[name](path)
            print(f"{name}: {time.process_time() - started:.0f} s", flush=True)
    if asked.check and study is not None:
        study(asked.solved)
    if asked.out:
        asked.out.mkdir(parents=True, exist_ok=True)
        tables(asked.solved, asked.out)


def keep_states(path: Path, states: Iterable[tuple[float, ...]], names: tuple[str, ...]) -> None:
    """Write states as they are solved, column by column; stops early, and says so, where the solver does."""
    found = []
    try:
        for state in states:
            found.append(state)
            columns = map(np.array, zip(*found, strict=True))
            np.savez_compressed(path, **dict(zip(names, columns, strict=True)))
            told = [
                f"{name} {value:.6g}" for name, value in zip(names, state, strict=True) if not np.ndim(value)
            ]
            print(path.stem, *told, flush=True)
    except ArithmeticError as stop:
        print(f"stopped: {stop}", flush=True)
