"""The photoelastic palm's shots: the dwells of a press, and the photographs taken during each."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import pandas as pd

from palpate.core.errors import LabelError
from palpate.core.files import storage_errors
from palpate.recordings.importers.palm_tables import NEAR_MM, Press
from palpate.recordings.labels import FIRST_ROW

_SHOT = re.compile(r"Cycle_r(\d{1,3})c(\d{1,3})_(\d{1,4})_(\w+?)_(\d+(?:\.\d+)?)mm", re.ASCII)
_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp"})
_SHOWN = 5


@dataclass(frozen=True, slots=True)
class Shot:
    """One dwell: which rows of its press's table, and which photographs."""

    press: Press
    phase: str
    depth_mm: float
    rows: list[int] = field(default_factory=list)
    photos: list[Path] = field(default_factory=list)

    @property
    def label(self) -> str:
        """The phase, as the rig's own plans name it."""
        return "reference" if self.depth_mm == 0.0 and self.phase == "down" else self.phase

    @property
    def key(self) -> str:
        """As the rig's own plans name their shots."""
        return f"{self.press.name}/{self.label}/{round(self.depth_mm * 1000)}/0"


def shots_of(press: Press, table: pd.DataFrame, folder: Path) -> list[Shot]:
    """A press's dwells, in the order in which they begin in its table."""
    found: dict[tuple[str, float], Shot] = {}
    seen: dict[str, list[Path]] = {}
    for i in range(len(table)):
        cell, phase = str(table["image_file"].iloc[i]), str(table["phase"].iloc[i])
        depth = _depth_mm(press, i, cell, phase, float(table["indent_mm"].iloc[i]))
        shot = found.setdefault((phase, depth), Shot(press, phase, depth))
        shot.rows.append(i)
        if cell not in seen:
            seen[cell] = _photos(press, i, cell, folder)
            shot.photos.extend(seen[cell])
        elif not set(seen[cell]) <= set(shot.photos):
            raise LabelError(
                f"{press.path}, row {i + FIRST_ROW}: {cell!r} belongs to another shot than {phase} at "
                f"{depth:g} mm; one photograph shows one dwell"
            )
    for shot in found.values():
        _check_stands(shot, table)
    return list(found.values())


def _depth_mm(press: Press, i: int, cell: str, phase: str, indent_mm: float) -> float:
    """The shot's depth: of its folder's name, which must not gainsay the row, else of the row."""
    named = _SHOT.search(PureWindowsPath(cell).name)
    if named is None:
        return round(indent_mm, 3)
    row, column, cycle, phase_named, depth = named.groups()
    told = (int(row), int(column), int(cycle), phase_named)
    if told != (press.row, press.column, press.cycle, phase) or abs(float(depth) - indent_mm) > NEAR_MM:
        raise LabelError(
            f"{press.path}, row {i + FIRST_ROW}: image_file is {cell!r}, but the row is of {press.name}, "
            f"{phase}, {indent_mm:g} mm; one of the two is misfiled"
        )
    return float(depth)


def _photos(press: Press, i: int, cell: str, folder: Path) -> list[Path]:
    """The photographs that a cell names: one, or those of a folder, in the order of their numbers."""
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
        photos = sorted(_images_in(at), key=_by_number) if at.is_dir() else [at]
    if not photos:
        raise LabelError(f"{where}: {at} holds no photograph; copy them there, or remove the shot's rows")
    for photo in photos:
        if not photo.resolve().is_relative_to(folder.resolve()):
            raise LabelError(
                f"{where}: {photo} is a link that leads out of {folder}; copy the photograph there"
            )
    return photos


def _images_in(folder: Path) -> Iterator[Path]:
    return (
        path
        for path in folder.iterdir()
        if path.suffix.lower() in _SUFFIXES and not path.name.startswith(".")
    )


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Sorts photo_2 before photo_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", path.name)]


def _check_stands(shot: Shot, table: pd.DataFrame) -> None:
    for name in ("x_mm", "y_mm", "indent_mm"):
        values = table[name].to_numpy(dtype=np.float64)[shot.rows]
        off = np.flatnonzero(np.abs(values - values[0]) > NEAR_MM)
        if off.size:
            raise LabelError(
                f"{shot.press.path}, row {shot.rows[off[0]] + FIRST_ROW}: {name} is {values[off[0]]:g}, and "
                f"{values[0]:g} in row {shot.rows[0] + FIRST_ROW} of the same dwell"
            )


def check_once(shots: Sequence[Shot]) -> None:
    """Refuse a photograph that two shots name.

    Raises:
        LabelError: there is one.
    """
    first: dict[Path, Shot] = {}
    for shot in shots:
        for photo in shot.photos:
            other = first.setdefault(photo.resolve(), shot)
            if other is not shot:
                raise LabelError(
                    f"{photo} belongs to two shots, {other.key} of {other.press.path} and {shot.key} of "
                    f"{shot.press.path}; one photograph shows one dwell"
                )


def check_no_strays(shots: Sequence[Shot], folder: Path) -> None:
    """Refuse photographs that no shot names.

    Raises:
        LabelError: there are some; names the first.
    """
    named = {photo.resolve() for shot in shots for photo in shot.photos}
    strays = sorted(
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.suffix.lower() in _SUFFIXES and not path.name.startswith(".") and path.resolve() not in named
    )
    if strays:
        raise LabelError(
            f"{len(strays)} photographs in {folder} are named by no table: {', '.join(strays[:_SHOWN])}; "
            "move them away, or allow unlabelled images to leave them out"
        )
