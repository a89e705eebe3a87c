"""An experiment as a folder: in it a folder for every specimen, and in that two files for every press.

======================  ==================================================================================
``specimens.csv``       a row a specimen: ``specimen``, ``stiffness_N_per_mm`` (inf for a rigid plate, empty
                        where it is not known), where the bodies differ in shape ``reduced_modulus_MPa``
                        (E / (1 - nu^2), inf for a rigid one) and ``radius_mm`` (of curvature, inf for a flat
                        one), both empty where not known, and any further columns
``S1/01.tif``           frames of one press, a multi-page TIFF
``S1/01.csv``           its table, of the same name: see `press_table`
``trials.csv``          a row a press: ``specimen``, ``trial`` (``01``), and columns of what trials share,
                        such as ``session``, ``copy``, ``tip`` or ``operator``
======================  ==================================================================================

A run that was recorded on specimens holds such a folder, ``presses``, and is read as it.

`specimens.csv` may be left out; then no stiffness is known. `trials.csv` is read where groups
are asked for. Further columns and other files are passed over,
and so are folders within a specimen's, such as runs made of its presses.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from palpate.core import (
    UNITS,
    Image,
    InputError,
    LabelError,
    has_unit,
    new_file,
    split_column,
    storage_errors,
)
from palpate.recordings.exchange.frame_sequences import write_tiff
from palpate.recordings.exchange.image_files import TIFF_SUFFIXES
from palpate.recordings.label_tables import FIRST_ROW, label_kinds, read_labels
from palpate.recordings.manifest import MANIFEST

SPECIMENS = "specimens.csv"
TRIALS = "trials.csv"
PRESSES = "presses"  # within a run, where its presses lie as such a folder
NAME, STIFFNESS, TRIAL = "specimen", "stiffness_N_per_mm", "trial"
MODULUS, RADIUS = "reduced_modulus_MPa", "radius_mm"
WITHOUT_END = {
    STIFFNESS: "inf for a rigid plate",
    MODULUS: "inf for a rigid body",
    RADIUS: "inf for a flat one",
}
DIGITS = "%.9g"  # a nanometre in a metre, more than any device of a rig says
_PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True)
class KnownBody:
    """What is known of a specimen's material and shape.

    Attributes:
        modulus_pa: Young's over 1 - nu^2, inf for a rigid one; NaN where it is not known [Pa].
        radius_m: of curvature where it is touched, inf for a flat one; NaN where it is not known [m].
    """

    modulus_pa: float
    radius_m: float

    @property
    def known(self) -> bool:
        return not np.isnan([self.modulus_pa, self.radius_m]).any()


UNKNOWN_BODY = KnownBody(np.nan, np.nan)


@dataclass(frozen=True)
class PressedSpecimen:
    """A specimen and its presses.

    Attributes:
        stiffness_n_m: of the specimen alone, inf for a rigid plate; None where it is not known [N/m].
        presses: of every press its TIFF and its table, in the order of their names.
        body: its modulus and radius.
    """

    name: str
    stiffness_n_m: float | None
    presses: tuple[tuple[Path, Path], ...]
    body: KnownBody = UNKNOWN_BODY


@dataclass(frozen=True)
class PressFolder:
    """An experiment.

    Attributes:
        specimens: in the order of `specimens.csv`, or of their names where there is none.
    """

    path: Path
    specimens: tuple[PressedSpecimen, ...]


def press_folder(path: Path) -> PressFolder:
    """Find the specimens and presses of an experiment; no frame or table of a press is opened yet."""
    path = Path(path)
    path = path / PRESSES if (path / PRESSES).is_dir() and (path / MANIFEST).exists() else path
    if not path.is_dir():
        raise InputError(
            f"{path} is no folder; give that of an experiment, with a folder for every specimen",
            code="folder-missing",
        )
    with storage_errors(path):
        folders = {p.name: p for p in sorted(path.iterdir()) if p.is_dir() and not p.name.startswith(".")}
        if not folders:
            raise InputError(
                f"{path} holds no folders; put the presses of each specimen into one, e.g. S1/01.tif",
                code="folder-empty",
            )
        table = path / SPECIMENS
        known = _known(table, folders) if table.exists() else dict.fromkeys(folders, (None, UNKNOWN_BODY))
        return PressFolder(
            path,
            tuple(
                PressedSpecimen(name, stiffness, _presses(folders[name]), body)
                for name, (stiffness, body) in known.items()
            ),
        )


def trial_groups(folder: PressFolder, columns: Sequence[str]) -> pd.DataFrame:
    """Read from `trials.csv` what presses share.

    Args:
        columns: of the table, e.g. ``session``; ``specimen`` may be one.

    Returns:
        A row a press, in the order of specimens and their presses, with these columns as text.
    """
    path = folder.path / TRIALS
    if not path.is_file():
        raise LabelError(
            f"{path} is not there; to group trials write one with the columns "
            f"{','.join(dict.fromkeys([NAME, TRIAL, *columns]))} and a row a press, e.g. S1,01,monday"
        )
    table = read_labels(path, kinds=dict.fromkeys([NAME, TRIAL, *columns], "text"))
    for column in [NAME, TRIAL, *columns]:
        if column not in table.columns:
            raise LabelError(f"{path} has no column {column!r}; it has {', '.join(map(str, table.columns))}")
    rows = [tuple(str(row[one]).strip() for one in (NAME, TRIAL)) for _, row in table.iterrows()]
    keys = [(name, _plain_number(trial)) for name, trial in rows]
    presses = {
        (one.name, _plain_number(frames.stem)): frames
        for one in folder.specimens
        for frames, _ in one.presses
    }
    for key, row in zip(keys, rows, strict=True):
        if keys.count(key) > 1:
            raise LabelError(f"{path} names press {'/'.join(row)} more than once; a press has one row")
        if key not in presses:
            raise LabelError(f"{path} names press {'/'.join(row)}, which is not in {folder.path}")
    left = [f"{key[0]}/{frames.stem}" for key, frames in presses.items() if key not in keys]
    if left:
        raise LabelError(f"{path} has no row for {', '.join(left)}; add one, or move the press away")
    found = table.iloc[[keys.index(key) for key in presses]][list(columns)].reset_index(drop=True)
    found = found.map(lambda cell: "" if pd.isna(cell) else str(cell).strip())
    for i, column in np.argwhere((found == "").to_numpy()):
        raise LabelError(f"{path}: {'/'.join(list(presses)[i])} has no {columns[column]}; fill the cell")
    return found


def _plain_number(name: str) -> str:
    """A trial's name without leading zeros, which a spreadsheet drops."""
    return name.lstrip("0") or "0" if name.isdecimal() else name


def write_specimens(
    folder: Path, stiffness_n_m: Mapping[str, float], bodies: Mapping[str, KnownBody] | None = None
) -> Path:
    """Write `specimens.csv` into a folder.

    Args:
        stiffness_n_m: of every specimen, inf for a rigid plate, NaN where it is not known [N/m].
        bodies: modulus and radius of every one; None for no such columns.
    """
    for name, stiffness in stiffness_n_m.items():
        if not _PLAIN.fullmatch(name):
            raise InputError(
                f"specimen {name!r} cannot name a folder everywhere; use letters, digits, '.', '_' and '-'",
                code="folder-name",
            )
        if stiffness <= 0:
            raise InputError(f"specimen {name} of {stiffness:g} N/m; above 0, inf for a rigid plate")
    values = {name: UNITS["N_per_mm"].from_si(k) for name, k in stiffness_n_m.items()}
    table = {NAME: list(values), STIFFNESS: list(values.values())}
    if bodies is not None:
        table[MODULUS] = [UNITS["MPa"].from_si(bodies[name].modulus_pa) for name in values]
        table[RADIUS] = [UNITS["mm"].from_si(bodies[name].radius_m) for name in values]
    return _written(folder / SPECIMENS, pd.DataFrame(table))


def write_press(folder: Path, press: str, frames: Iterable[Image], rows: pd.DataFrame) -> tuple[Path, Path]:
    """Write one press into the folder of its specimen, frame by frame as they come.

    Args:
        folder: of the specimen; made where it is not there.
        frames: 8-bit grey or RGB, of one size.
        rows: see `press_rows`.
    """
    tiff = folder / f"{press}.tif"
    write_tiff(tiff, frames)
    return tiff, _written(folder / f"{press}.csv", rows)


def _written(path: Path, rows: pd.DataFrame) -> Path:
    with new_file(path) as building:
        rows.to_csv(building, index=False, float_format=DIGITS)
    return path


def _known(path: Path, folders: Mapping[str, Path]) -> dict[str, tuple[float | None, KnownBody]]:
    """Stiffness [N/m] and body of every specimen of the table, which are those that have a folder."""
    table = read_labels(path, kinds={NAME: "text"})
    if NAME not in table.columns:
        raise LabelError(
            f"{path} has no column {NAME!r}; it has {', '.join(map(str, table.columns))}",
            code="column-missing",
        )
    names = [str(name).strip() for name in table[NAME]]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise LabelError(
            f"{path} names specimen {twice[0]!r} more than once; a specimen has one row", code="row-repeated"
        )
    gone = [name for name in names if name not in folders]
    if gone:
        raise LabelError(
            f"{path} names {', '.join(map(repr, gone))}, without a folder of that name beside it; there are "
            f"{', '.join(folders)}",
            code="specimen-folder-missing",
        )
    left = [name for name in folders if name not in names]
    if left:
        raise LabelError(
            f"{path} has no row for {', '.join(map(repr, left))}; add one, or move the folder away",
            code="specimen-row-missing",
        )
    stiffness = _quantity(path, table, STIFFNESS)
    if stiffness is None:
        raise LabelError(
            f"{path} has no column {STIFFNESS!r}; add it: inf for a rigid plate, empty where not known",
            code="column-missing",
        )
    unknown = [None] * len(names)
    moduli, radii = (_quantity(path, table, column) or unknown for column in (MODULUS, RADIUS))
    bodies = [
        KnownBody(np.nan if E is None else E, np.nan if R is None else R)
        for E, R in zip(moduli, radii, strict=True)
    ]
    return dict(zip(names, zip(stiffness, bodies, strict=True), strict=True))


def _quantity(path: Path, table: pd.DataFrame, usual: str) -> list[float | None] | None:
    """Values of a quantity in SI, in whatever unit its column is; None where there is no such column."""
    what, unit = split_column(usual)
    column = next((str(name) for name in table.columns if _is_of(str(name), what, unit.si)), None)
    if column is None:
        return None
    if label_kinds(table)[column] != "number":
        raise LabelError(
            f"{path}: {column!r} holds what is no number; write inf where it is without end",
            code="table-number",
        )
    values = table[column].to_numpy(np.float64)
    bad = np.flatnonzero(values <= 0)
    if bad.size:
        raise LabelError(
            f"{path}, row {bad[0] + FIRST_ROW}: a {what.replace('_', ' ')} of {values[bad[0]]:g}; it is "
            f"above 0, and {WITHOUT_END[usual]}",
            code="stiffness",
        )
    to_si = split_column(column)[1].to_si
    return [None if np.isnan(value) else to_si(float(value)) for value in values]


def _is_of(name: str, what: str, si: str) -> bool:
    if not has_unit(name):
        return False
    quantity, unit = split_column(name)
    return quantity == what and unit.si == si


def _presses(folder: Path) -> tuple[tuple[Path, Path], ...]:
    files = [p for p in sorted(folder.iterdir()) if p.is_file() and not p.name.startswith(".")]
    tiffs = _by_stem(p for p in files if p.suffix.lower() in TIFF_SUFFIXES)
    tables = _by_stem(p for p in files if p.suffix.lower() == ".csv")
    alone = sorted(tiffs.keys() ^ tables.keys())
    if alone:
        is_tiff = alone[0] in tiffs
        raise InputError(
            f"{(tiffs if is_tiff else tables)[alone[0]]} is without its {'table' if is_tiff else 'frames'} "
            f"{alone[0]}{'.csv' if is_tiff else '.tif'}; a press is two files of one name",
            code="press-incomplete",
        )
    if not tiffs:
        raise InputError(
            f"{folder} holds no presses; put e.g. 01.tif and 01.csv into it, or move it away",
            code="no-presses",
        )
    return tuple((tiffs[stem], tables[stem]) for stem in sorted(tiffs))


def _by_stem(files: Iterable[Path]) -> dict[str, Path]:
    by_stem: dict[str, Path] = {}
    for path in files:
        if path.stem in by_stem:
            raise InputError(
                f"{by_stem[path.stem]} and {path.name} are of one press; keep one of them",
                code="press-ambiguous",
            )
        by_stem[path.stem] = path
    return by_stem
