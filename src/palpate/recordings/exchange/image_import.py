"""A folder of single images and a table of labels, turned into a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
import pandas as pd

from palpate.core import (
    NS_PER_S,
    ImageError,
    InputError,
    LabelError,
    ManualClock,
    PathText,
    ProgressCount,
    UnitError,
    has_unit,
    is_hidden,
    new_folder,
    refuse_existing,
    split_column,
)
from palpate.recordings.exchange.folder_export import FILE_COLUMN, TIME_COLUMN
from palpate.recordings.exchange.image_files import IMAGE_SUFFIXES, read_image
from palpate.recordings.label_tables import FIRST_ROW, label_kinds, read_labels, rows_text
from palpate.recordings.manifest import MANIFEST, Manifest
from palpate.recordings.run_reader import NAME_COLUMN
from palpate.recordings.run_writer import RunWriter
from palpate.recordings.splits import CONVENTIONAL_GROUPS

_SHOWN = 5
_GROUP_NAMES = frozenset(name for columns in CONVENTIONAL_GROUPS for name in columns)


@dataclass(frozen=True, slots=True)
class ImportReport:
    """Report of what was imported.

    Attributes:
        frames: number of frames in the run.
        columns: labels of the run, in the table's order.
        units: unit of each column of numbers that names one.
        unitless: columns of numbers whose names carry no unit; they can group frames, and cannot be targets.
    """

    frames: int
    columns: tuple[str, ...]
    units: Mapping[str, str]
    unitless: tuple[str, ...]

    @property
    def no_targets(self) -> tuple[str, ...]:
        """Columns of `unitless` that are not called as groups are: somebody may want one for a target."""
        return tuple(name for name in self.unitless if name not in _GROUP_NAMES)


def import_images(
    folder: PathText,
    run: PathText,
    *,
    labels: PathText,
    image_column: str,
    sensor: str = "",
    licence: str = "",
    origin: str = "",
    rig: str = "",
    rate_hz: float | None = None,
    time_column: str | None = None,
    allow_unlabelled: bool = False,
    strict: bool = False,
    progress: ProgressCount | None = None,
) -> ImportReport:
    """Turn a folder of images and a table of labels into a run; row ``i`` of the table becomes frame ``i``.

    Every row and every image is checked before the run is begun, and the run appears whole or not at all.
    What `export_folder` wrote comes back with its frames, times and labels unchanged, and with the sensor,
    rig, licence and origin of its manifest where these are not given.

    Args:
        folder: where the images are, themselves or in a folder ``images`` of it.
        run: the run to make; must not exist.
        labels: the table, as given or inside `folder`.
        image_column: the column that names each row's image, relative to `folder` or to ``folder/images``.
        sensor: which sensor the images are of.
        licence: of the data.
        origin: who recorded it, and where it was had from.
        rig: what the sensor stood on.
        rate_hz: frames a second, where the images are a sequence at a steady rate [Hz]; without it and
            without `time_column` the run's times are ordinal: frame ``i`` is at ``i`` seconds.
        time_column: the column that holds each frame's time [s], strictly increasing.
        allow_unlabelled: leave out images that no row names, rather than refuse the folder.
        strict: refuse columns of numbers whose names carry no unit, unless they are called as groups are,
            such as ``press``. Without it the report's `no_targets` names them, and they cannot be targets.
        progress: told how many steps are done of how many; an image is checked in one and written in another.

    Raises:
        ExistsError: `run` exists.
        LabelError: the table is damaged, lacks the column, names an image twice, or one that is not there or
            not inside `folder`; a number is missing; or an image has no row.
        UnitError: `strict`, and a column of numbers carries no unit.
        ImageError: an image cannot be read, or is not of the first one's size and kind.
        InputError: `folder` is none, or `rate_hz` is no rate or given beside `time_column`.
        RecordingError: `folder` was exported and its manifest is damaged.
    """
    folder, run, labels = Path(folder), Path(run), Path(labels)
    refuse_existing(run)
    source = labels if labels.is_file() else folder / labels
    exported = _exported_manifest(folder, image_column)
    kinds = exported.labels if exported else {}
    table = read_labels(source, kinds={**kinds, image_column: "text"})
    _check_numbers(table, source)
    paths = _image_paths(table, source, folder, image_column)
    if not allow_unlabelled:
        _check_no_strays(folder, paths, source)
    times_ns = _times_ns(table, source, rate_hz, TIME_COLUMN if exported else time_column)
    timed = exported.clock == "measured" if exported else (rate_hz is not None or time_column is not None)
    kept = _labels(table, image_column)
    if strict and (bare := _report(kept).no_targets):
        raise UnitError(
            f"{source}: columns of numbers without a unit: {', '.join(bare)}; name each quantity_unit, as in "
            "depth_mm or mass_ratio, or import without strict and use them as groups only"
        )
    for done, _ in enumerate(_same_kind(paths), start=1):
        _tell(progress, done, 2 * len(paths))
    about = {"sensor": sensor, "rig": rig, "licence": licence, "origin": origin}
    with whole_run(run, _manifest(about, exported, kept, timed)) as writer:
        for i, image in enumerate(_same_kind(paths)):
            writer.frame(image, time_ns=int(times_ns[i]), labels=_row(kept, i))
            _tell(progress, len(paths) + i + 1, 2 * len(paths))
    return _report(kept)


def _manifest(about: dict[str, str], exported: Manifest | None, kept: pd.DataFrame, timed: bool) -> Manifest:
    """Manifest by what the caller says, else by what an exported folder says of itself."""
    texts = {name: text or (getattr(exported, name) if exported else "") for name, text in about.items()}
    return Manifest.new(
        sensor=texts["sensor"],
        rig=texts["rig"],
        licence=texts["licence"],
        origin=texts["origin"],
        targets=tuple(one for one in exported.targets if one in kept) if exported else (),
        seed=exported.seed if exported else None,
        labels=label_kinds(kept),
        clock="measured" if timed else "ordinal",
    )


@contextmanager
def whole_run(run: Path, manifest: Manifest) -> Iterator[RunWriter]:
    """A writer of messages that carry their own times, into a run that appears whole or not at all."""
    with new_folder(run) as building:
        inner = building / "run"  # the writer makes its own folder
        with RunWriter.create(inner, manifest, clock=ManualClock(), overflow="wait") as writer:
            yield writer
        for part in inner.iterdir():
            part.rename(building / part.name)
        inner.rmdir()


def _image_paths(table: pd.DataFrame, source: Path, folder: Path, image_column: str) -> list[Path]:
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder of images; check the name")
    if image_column not in table.columns:
        raise LabelError(
            f"{source} has no column {image_column!r}; its columns are {', '.join(table.columns)}"
        )
    names = [str(cell) for cell in table[image_column]]
    paths = [_inside(folder, name, source, row) for row, name in enumerate(names, start=FIRST_ROW)]
    missing = [i for i, path in enumerate(paths) if path is None]
    if missing:
        shown = ", ".join(repr(names[i]) for i in missing[:_SHOWN])
        raise LabelError(
            f"{source}, {rows_text(missing)}: no such image in {folder} or {folder / 'images'}: {shown}; "
            "copy the images there, or remove the rows"
        )
    files = [path for path in paths if path is not None]
    _check_once(files, source)
    return files


def _inside(folder: Path, name: str, source: Path, row: int) -> Path | None:
    """The image that a cell names; None if it is not there."""
    if not name:
        raise LabelError(f"{source}, row {row} names no image; name one, or remove the row")
    posix, windows = PurePosixPath(name), PureWindowsPath(name)
    if posix.is_absolute() or windows.drive or windows.root or ".." in windows.parts:
        raise LabelError(
            f"{source}, row {row}: image {name!r} does not stay inside {folder}; "
            "name images relative to the folder, without '..'"
        )
    for path in (folder / posix, folder / "images" / posix):
        if path.exists():
            if not path.resolve().is_relative_to(folder.resolve()):
                raise LabelError(
                    f"{source}, row {row}: image {name!r} is a link that leads out of {folder}; copy the "
                    f"image there"
                )
            return path.resolve()
    return None


def _check_once(paths: Sequence[Path], source: Path) -> None:
    first: dict[Path, int] = {}
    for i, path in enumerate(paths):
        if path in first:
            raise LabelError(
                f"{source}: {rows_text([first[path], i])} name the same image, {path.name!r}; keep one of "
                f"the rows"
            )
        first[path] = i


def _check_no_strays(folder: Path, paths: Sequence[Path], source: Path) -> None:
    named = set(paths)
    images = (path for path in folder.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
    strays = sorted(
        path.relative_to(folder).as_posix()
        for path in images
        if not is_hidden(path, folder) and path.resolve() not in named
    )
    if strays:
        raise LabelError(
            f"{len(strays)} images in {folder} have no row in {source}: {', '.join(strays[:_SHOWN])}; "
            "add their rows, move them away, or allow unlabelled images to leave them out"
        )


def _check_numbers(table: pd.DataFrame, source: Path) -> None:
    for name, kind in label_kinds(table).items():
        if kind != "number":
            continue
        bad = np.flatnonzero(~np.isfinite(table[name].to_numpy()))
        if bad.size:
            raise LabelError(
                f"{source}, {rows_text(bad)}: column {name!r} holds no finite number there; fill it in, or "
                "remove the rows with their images, or the column"
            )


def _same_kind(paths: Sequence[Path]) -> Iterator[np.ndarray]:
    shape: tuple[int, ...] | None = None
    for path in paths:
        image = read_image(path)
        shape = shape or image.shape
        if image.shape != shape:
            raise ImageError(
                f"{path} is {_shape_text(image.shape)} and {paths[0]} is {_shape_text(shape)}; "
                "the images of one run are of one size and all grey or all colour: convert them, or import "
                "two runs"
            )
        yield image


def _shape_text(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} × {shape[0]} px, {'grey' if len(shape) == 2 else 'colour'}"


def _times_ns(table: pd.DataFrame, source: Path, rate_hz: float | None, column: str | None) -> np.ndarray:
    if column is None:
        if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0):
            raise InputError(f"rate {rate_hz} Hz: a rate is above 0 Hz; leave it out where there is none")
        return _nanoseconds(np.arange(len(table)) / (rate_hz or 1.0))
    if rate_hz is not None:
        raise InputError(f"both a rate ({rate_hz} Hz) and a column of times ({column!r}) are given; give one")
    if column not in table.columns or label_kinds(table)[column] != "number":
        raise LabelError(f"{source} has no column of numbers {column!r}; times are numbers, in seconds")
    times_s = table[column].to_numpy()
    late = np.flatnonzero(np.diff(times_s) <= 0) + 1
    if late.size:
        raise LabelError(
            f"{source}, {rows_text(late)}: the time in {column!r} is not after that of the row before; "
            "sort the rows"
        )
    # Times of our own count from the run's beginning already; others may count from anywhere.
    return _nanoseconds(times_s if column == TIME_COLUMN else times_s - times_s[0])


def _nanoseconds(times_s: np.ndarray) -> np.ndarray:
    return np.asarray(np.rint(times_s * NS_PER_S), dtype=np.int64)


def _labels(table: pd.DataFrame, image_column: str) -> pd.DataFrame:
    """Labels that the run keeps: all but the exporter's own columns; image names where runs look for them."""
    kept = table.drop(columns=[FILE_COLUMN, TIME_COLUMN], errors="ignore")
    return kept if NAME_COLUMN in kept.columns else kept.rename(columns={image_column: NAME_COLUMN})


def _exported_manifest(folder: Path, image_column: str) -> Manifest | None:
    """The manifest of the run that a folder was exported from, which says what CSV cannot; else None."""
    return Manifest.read(folder) if image_column == FILE_COLUMN and (folder / MANIFEST).is_file() else None


def _row(table: pd.DataFrame, i: int) -> dict[str, Any]:
    cells = {str(name): table[name].iloc[i] for name in table.columns}
    # numpy's scalars become Python's, which is what a run's labels are made of
    return {name: cell.item() if isinstance(cell, np.generic) else cell for name, cell in cells.items()}


def _report(table: pd.DataFrame) -> ImportReport:
    numbers = [name for name, kind in label_kinds(table).items() if kind == "number"]
    return ImportReport(
        frames=len(table),
        columns=tuple(str(name) for name in table.columns),
        units={name: split_column(name)[1].symbol for name in numbers if has_unit(name)},
        unitless=tuple(name for name in numbers if not has_unit(name)),
    )


def _tell(progress: ProgressCount | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done, total)
