"""Import of the photoelastic palm's recordings: one table per press, one folder of photographs per shot.

A press is a table `Cycle_Indent5mm_r{row}c{col}_{cycle}.csv` of force samples. During a dwell about five
samples and 25 photographs are taken; the column `image_file` names their folder or file. All frames of a shot
share one force, the mean of its samples, and belong on the same side of a split. The layout is from the
published code.
"""

from __future__ import annotations

import itertools
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import pandas as pd

from palpate.core import InputError, LabelError, ProgressCount, is_hidden, refuse_existing, storage_errors
from palpate.core.provenance import Provenance
from palpate.recordings import ImportReport, import_images, read_labels
from palpate.recordings.label_tables import FIRST_ROW, label_kinds

NEAR_MM = 0.05  # tolerance between two records of one depth or position
_TABLE = re.compile(r"Cycle_Indent(\d+(?:\.\d+)?)mm_r(\d{1,3})c(\d{1,3})_(\d{1,4})\.csv", re.ASCII)
_NUMBERS = ("t_s", "indent_mm", "Fx", "Fy", "Fz", "x_mm", "y_mm")
_PHASES = ("down", "up")
_MAX_TABLE_BYTES = 1 << 24


@dataclass(frozen=True, slots=True)
class PalmPressTable:
    """Parsed name of a press's table."""

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


def presses_in(folder: Path) -> list[PalmPressTable]:
    """Return the presses of a folder by location and cycle."""
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder of tables; check the name", code="folder-missing")
    with storage_errors(folder):
        tables = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".csv")
    if not tables:
        raise InputError(f"{folder} holds no table such as Cycle_Indent5mm_r4c6_1.csv", code="no-table")
    presses = sorted((_press(path) for path in tables), key=lambda one: (one.row, one.column, one.cycle))
    for one, next_ in itertools.pairwise(presses):
        if one.name == next_.name:
            raise LabelError(
                f"{one.path} and {next_.path} are of the same press, {one.name}; keep one of them"
            )
    return presses


def _press(path: Path) -> PalmPressTable:
    results = _TABLE.fullmatch(path.name)
    if results is None:
        raise LabelError(
            f"{path} is not named as Cycle_Indent5mm_r4c6_1.csv is, which tells depth, row, column and "
            "cycle; rename it, or move it away"
        )
    deepest, row, column, cycle = results.groups()
    return PalmPressTable(path, float(deepest), int(row), int(column), int(cycle))


def table_of(press: PalmPressTable) -> pd.DataFrame:
    """Read and check the samples of a press."""
    path = press.path
    with storage_errors(path):
        size = path.stat().st_size
    if size > _MAX_TABLE_BYTES:
        raise LabelError(f"{path} has {size} bytes; a press has {_MAX_TABLE_BYTES} at most")
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
        return "_" not in cell and bool(np.isfinite(float(cell)))  # Python accepts 1_000
    except ValueError:
        return False


_SHOT = re.compile(r"Cycle_r(\d{1,3})c(\d{1,3})_(\d{1,4})_(\w+?)_(\d+(?:\.\d+)?)mm", re.ASCII)
_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp"})
_SHOWN = 5


@dataclass(frozen=True, slots=True)
class PalmShot:
    """One dwell: rows of its press's table and its photographs."""

    press: PalmPressTable
    phase: str
    depth_mm: float
    rows: list[int] = field(default_factory=list)
    photos: list[Path] = field(default_factory=list)

    @property
    def label(self) -> str:
        """Phase as in the rig's plans."""
        return "reference" if self.depth_mm == 0.0 and self.phase == "down" else self.phase

    @property
    def key(self) -> str:
        """Name of the shot as in the rig's plans."""
        return f"{self.press.name}/{self.label}/{round(self.depth_mm * 1000)}/0"


def shots_of(press: PalmPressTable, table: pd.DataFrame, folder: Path) -> list[PalmShot]:
    """Return the dwells of a press in the order of its table."""
    results: dict[tuple[str, float], PalmShot] = {}
    seen: dict[str, list[Path]] = {}
    for i in range(len(table)):
        cell, phase = str(table["image_file"].iloc[i]), str(table["phase"].iloc[i])
        depth = _depth_mm(press, i, cell, phase, float(table["indent_mm"].iloc[i]))
        shot = results.setdefault((phase, depth), PalmShot(press, phase, depth))
        shot.rows.append(i)
        if cell not in seen:
            seen[cell] = _photos(press, i, cell, folder)
            shot.photos.extend(seen[cell])
        elif not set(seen[cell]) <= set(shot.photos):
            raise LabelError(
                f"{press.path}, row {i + FIRST_ROW}: {cell!r} belongs to another shot than {phase} at "
                f"{depth:g} mm; one photograph shows one dwell"
            )
    for shot in results.values():
        _check_stands(shot, table)
    return list(results.values())


def _depth_mm(press: PalmPressTable, i: int, cell: str, phase: str, indent_mm: float) -> float:
    """Depth from the folder's name, which must agree with the row, else from the row."""
    named = _SHOT.search(PureWindowsPath(cell).name)
    if named is None:
        return round(indent_mm, 3)
    row, column, cycle, phase_named, depth = named.groups()
    report = (int(row), int(column), int(cycle), phase_named)
    if report != (press.row, press.column, press.cycle, phase) or abs(float(depth) - indent_mm) > NEAR_MM:
        raise LabelError(
            f"{press.path}, row {i + FIRST_ROW}: image_file is {cell!r}, but the row is of {press.name}, "
            f"{phase}, {indent_mm:g} mm; one of the two is misfiled"
        )
    return float(depth)


def _photos(press: PalmPressTable, i: int, cell: str, folder: Path) -> list[Path]:
    """Photographs named by a cell: one, or those of a folder in numeric order."""
    where = f"{press.path}, row {i + FIRST_ROW}"
    if not cell:
        raise LabelError(f"{where} names no image_file; name one, or remove the row")
    windows = PureWindowsPath(cell)
    if PurePosixPath(cell).is_absolute() or windows.drive or windows.root or ".." in windows.parts:
        raise LabelError(
            f"{where}: image_file {cell!r} does not stay inside {folder}; name it relative to "
            "that, without '..'"
        )
    inner = PurePosixPath(*windows.parts)  # the source was written on Windows
    at = next((path for path in (folder / inner, folder / "images" / inner) if path.exists()), None)
    if at is None:
        raise LabelError(
            f"{where}: image_file {cell!r} is neither in {folder} nor in {folder / 'images'}; copy it there"
        )
    with storage_errors(at):
        photos = sorted(filter(_is_photo, at.iterdir()), key=_by_number) if at.is_dir() else [at]
    if not photos:
        raise LabelError(f"{where}: {at} holds no photograph; copy them there, or remove the shot's rows")
    for photo in photos:
        if not photo.resolve().is_relative_to(folder.resolve()):
            raise LabelError(
                f"{where}: {photo} is a link that leads out of {folder}; copy the photograph there"
            )
    return photos


def _is_photo(path: Path) -> bool:
    return path.suffix.lower() in _SUFFIXES and not path.name.startswith(".")


def _by_number(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", path.name)]


def _check_stands(shot: PalmShot, table: pd.DataFrame) -> None:
    for name in ("x_mm", "y_mm", "indent_mm"):
        values = table[name].to_numpy(dtype=np.float64)[shot.rows]
        off = np.flatnonzero(np.abs(values - values[0]) > NEAR_MM)
        if off.size:
            raise LabelError(
                f"{shot.press.path}, row {shot.rows[off[0]] + FIRST_ROW}: {name} is {values[off[0]]:g}, and "
                f"{values[0]:g} in row {shot.rows[0] + FIRST_ROW} of the same dwell"
            )


def check_once(shots: Sequence[PalmShot]) -> None:
    """Reject a photograph that two shots name."""
    first: dict[Path, PalmShot] = {}
    for shot in shots:
        for photo in shot.photos:
            other = first.setdefault(photo.resolve(), shot)
            if other is not shot:
                raise LabelError(
                    f"{photo} belongs to two shots, {other.key} of {other.press.path} and {shot.key} of "
                    f"{shot.press.path}; one photograph shows one dwell"
                )


def check_no_strays(shots: Sequence[PalmShot], folder: Path) -> None:
    """Reject photographs that no shot names."""
    named = {photo.resolve() for shot in shots for photo in shot.photos}
    strays = sorted(
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if _is_photo(path) and not is_hidden(path, folder) and path.resolve() not in named
    )
    if strays:
        raise LabelError(
            f"{len(strays)} photographs in {folder} are named by no table: {', '.join(strays[:_SHOWN])}; "
            "move them away, or allow unlabelled images to leave them out"
        )


def import_palm(
    folder: Path,
    run: Path,
    *,
    sensor: str = "palm",
    licence: str = "",
    origin: str = "",
    provenance: Provenance | None = None,
    allow_unlabelled: bool = False,
    progress: ProgressCount | None = None,
) -> ImportReport:
    """Convert a folder of the palm's tables and photographs to a run.

    Labels follow `rig.acquisition`, with `row`, `column`, and the samples' spread `force_sd_N`. Run times are
    ordinal; `t_s` is the middle of the dwell. `force_N` is positive in compression, with the sign of the
    deepest shots. `depth_mm`, x, and y are the source's own; depth 0 is a reference.

    Args:
        folder: Folder of the tables, with the photographs or their folder ``images``.
        run: Run to create.
        sensor, licence, origin, provenance, progress: See `import_images`.
        allow_unlabelled: Whether to skip photographs that no table names.
    """
    refuse_existing(run)
    presses = presses_in(folder)
    tables = {press: table_of(press) for press in presses}
    shots = [shot for press, table in tables.items() for shot in shots_of(press, table, folder)]
    check_once(shots)
    if not allow_unlabelled:
        check_no_strays(shots, folder)
    labels = _labels(shots, tables, folder)
    with tempfile.TemporaryDirectory() as scratch, storage_errors(Path(scratch)):
        table_file = Path(scratch, "labels.csv")
        labels.to_csv(table_file, index=False, lineterminator="\r\n")
        return import_images(
            folder,
            run,
            labels=table_file,
            image_column="image_file",
            sensor=sensor,
            licence=licence,
            origin=origin,
            provenance=provenance,
            rig="imported from the palm's own tables",
            allow_unlabelled=True,
            progress=progress,
        )


def _labels(
    shots: Sequence[PalmShot], tables: dict[PalmPressTable, pd.DataFrame], folder: Path
) -> pd.DataFrame:
    sign = _normal_sign(tables)
    rows: list[dict[str, object]] = []
    for shot in shots:
        samples = tables[shot.press].iloc[shot.rows]
        about = _about(shot, samples, sign)
        for k, photo in enumerate(shot.photos):
            name = photo.relative_to(folder).as_posix()
            rows.append({"image_file": name, "frame_in_shot": float(k), **about})
    return pd.DataFrame(rows).dropna(axis=1)  # drops the spread where there is none


def _about(shot: PalmShot, samples: pd.DataFrame, sign: float) -> dict[str, object]:
    press, force = shot.press, samples[["Fx", "Fy", "Fz"]].to_numpy(dtype=np.float64)
    fx, fy, fz = force.mean(axis=0).tolist()
    return {
        "shot": shot.key,
        "location": press.location,
        "row": float(press.row),
        "column": float(press.column),
        "press": press.name,
        "cycle": float(press.cycle),
        "phase": shot.label,
        "reference": shot.depth_mm == 0.0,
        "x_mm": float(samples["x_mm"].mean()),
        "y_mm": float(samples["y_mm"].mean()),
        "depth_mm": shot.depth_mm,
        "force_N": sign * fz,
        "force_x_N": fx,
        "force_y_N": fy,
        "force_sd_N": float(force[:, 2].std(ddof=1)) if len(force) > 1 else np.nan,
        "t_s": float(samples["t_s"].mean()),
    }


def _normal_sign(tables: dict[PalmPressTable, pd.DataFrame]) -> float:
    """Sign of Fz at the deepest shots, where the membrane is compressed."""
    signs: dict[float, PalmPressTable] = {}
    for press, table in tables.items():
        depth, fz = table["indent_mm"].to_numpy(), table["Fz"].to_numpy()
        deepest = float(np.mean(fz[depth >= depth.max() - NEAR_MM]))
        if depth.max() > NEAR_MM and deepest != 0.0:
            signs.setdefault(float(np.sign(deepest)), press)
    if len(signs) > 1:
        one, other = signs[1.0].path, signs[-1.0].path
        raise LabelError(
            f"at the deepest indentation Fz is positive in {one} and negative in {other}; import "
            "presses of one sign convention at a time"
        )
    return next(iter(signs), 1.0)
