"""Import of a folder of single images with a table of labels.

Rows shifted against their images are detected by a linear map from changes of small pictures to changes of a
label, fitted on half of the rows and scored on the other, for several shifts.

Press as a multi-page TIFF or a video, with a table of force, turned into a run.

Frames carry force, position and the contact's area at their own time as labels, as far as the table has them;
its samples go into the run's own streams at their own rate, force as z of the wrench and position as z of the
stage.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
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
    new_folder,
    refuse_existing,
    split_column,
)
from palpate.core.provenance import Provenance
from palpate.recordings.exchange.frame_sequences import FrameSequence, open_sequence
from palpate.recordings.exchange.image_files import read_image
from palpate.recordings.exchange.label_files import unit_doubts, with_units
from palpate.recordings.exchange.labelled_images import (
    LabelLayout,
    LabelledImages,
    find_labelled_images,
    refuse_strays,
)
from palpate.recordings.exchange.press_export import FILE_COLUMN, TIME_COLUMN
from palpate.recordings.exchange.press_table import PressTable, read_press_table
from palpate.recordings.label_tables import Decimal, label_kinds, rows_text
from palpate.recordings.manifest import MANIFEST, Manifest
from palpate.recordings.run_reader import NAME_COLUMN
from palpate.recordings.run_writer import RunWriter
from palpate.recordings.splits import CONVENTIONAL_GROUPS

_GROUP_NAMES = frozenset(name for columns in CONVENTIONAL_GROUPS for name in columns) | {"session"}


@dataclass(frozen=True, slots=True)
class ImportReport:
    """Result of an import.

    Attributes:
        units: Unit of each number column that names one.
        unitless: Number columns without a unit; they can group frames, but not be targets.
        doubts: Warnings about implausible units and shifted rows.
    """

    frames: int
    columns: tuple[str, ...]
    units: Mapping[str, str]
    unitless: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def no_targets(self) -> tuple[str, ...]:
        """Columns of `unitless` that are not called as groups are: somebody may want one for a target."""
        return tuple(name for name in self.unitless if name not in _GROUP_NAMES)


def import_images(
    folder: PathText,
    run: PathText,
    *,
    labels: PathText | None = None,
    image_column: str | None = None,
    name_pattern: str | None = None,
    columns: Sequence[str] = (),
    decimal: Decimal = "auto",
    in_order: bool = False,
    rename: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    sensor: str = "",
    licence: str = "",
    origin: str = "",
    provenance: Provenance | None = None,
    rig: str = "",
    rate_hz: float | None = None,
    time_column: str | None = None,
    order_by: str | None = None,
    allow_unlabelled: bool = False,
    strict: bool = False,
    progress: ProgressCount | None = None,
) -> ImportReport:
    """Import a folder of images with labels as a new run; row ``i`` of the labels becomes frame ``i``.

    All rows and images are checked before the run is created. A folder written by `export_folder` keeps its
    frames, times, labels, and, unless given, its sensor, rig, license, and origin.

    Args:
        folder: Folder that holds the images, directly or in ``images``.
        labels: Label file, absolute or inside `folder`: text table, JSON, NumPy array, or Parquet. A pattern
            such as ``*/labels.csv`` takes one table a session, whose folder becomes the label ``session``;
            ``*.json`` takes one file an image.
        image_column: Column with the image of each row, relative to `folder`, to the table's folder, or to
            ``images`` in these; None takes the first of `IMAGE_COLUMNS`.
        name_pattern: Alternative to `labels`: pattern of the image names, such as ``x{x_mm}_f{force_N}.png``.
        columns: Column names of a file without a header.
        decimal: ``point``, ``comma``, or ``auto``, which rejects ambiguous numbers.
        in_order: Assign row ``i`` to the ``i``-th image, ordered by the numbers in the names.
        rename: Column name -> name in the run.
        units: Column name after `rename` -> unit; ``depth`` in ``mm`` becomes ``depth_mm``.
        provenance: Measured, simulated, or derived; by default that of an exported run, else measured.
        rate_hz: Constant frame rate. Without it and `time_column`, frame ``i`` is at ``i`` seconds (ordinal).
        time_column: Column of strictly increasing times [s].
        order_by: Number column that states the recording order. Without it, labels in image names leave the
            order unknown, unless a rate or time column is given.
        allow_unlabelled: Ignore images without a row.
        strict: Reject number columns without a unit unless they are group columns such as ``press``.
    """
    folder, run = Path(folder), Path(run)
    refuse_existing(run)
    layout = LabelLayout(
        None if labels is None else Path(labels),
        image_column,
        name_pattern,
        tuple(columns),
        decimal,
        in_order,
        allow_unlabelled,
    )
    found, exported = _found(folder, layout)
    if not allow_unlabelled:
        refuse_strays(folder, found)
    kept = with_units(_labels(found), rename or {}, units or {}, found.source)
    if order_by is not None:
        found, kept = _in_order_of(order_by, found, kept)
    when = found.table if exported else kept
    times_ns = _times_ns(when, found.source, rate_hz, TIME_COLUMN if exported else time_column)
    timed = exported.clock == "measured" if exported else (rate_hz is not None or time_column is not None)
    if strict and (bare := _report(kept).no_targets):
        raise UnitError(
            f"{found.source}: columns of numbers without a unit: {', '.join(bare)}; give each one, as by "
            "--unit "
            "depth=mm (a dimensionless one is a ratio), or import without strict and use them as groups only",
            code="unit-missing",
        )
    about = {"sensor": sensor, "rig": rig, "licence": licence, "origin": origin}
    by_name = name_pattern is not None and not timed and order_by is None
    digests: list[bytes] = []
    with whole_run(run, _manifest(about, provenance, exported, kept, timed, by_name)) as writer:
        for i, image in enumerate(_same_kind(found.paths)):
            digests.append(sha256(image.tobytes()).digest())
            writer.frame(image, time_ns=int(times_ns[i]), labels=_row(kept, i))
            _tell(progress, i + 1, len(found.paths))
    return _report(kept, (*unit_doubts(kept), *_two_labels(digests, found.names, kept)))


def _two_labels(digests: Sequence[bytes], names: Sequence[str], kept: pd.DataFrame) -> list[str]:
    """What equal pictures with different labels give to doubt; the sensor at rest looks the same anywhere."""
    numbers = [str(name) for name, kind in label_kinds(kept).items() if kind == "number" and has_unit(name)]
    touch = [name for name in numbers if split_column(name)[0].endswith(("depth", "force"))]
    moved = [name for name in numbers if split_column(name)[0] != "time"]
    values = kept[moved].to_numpy(np.float64)
    at_rest = (kept[touch] == 0).all(axis=1).to_numpy() & bool(touch)
    first: dict[bytes, int] = {}
    pairs = []
    for row in np.flatnonzero(~at_rest).tolist():
        other = first.setdefault(digests[row], row)
        if not np.array_equal(values[row], values[other]):
            pairs.append((names[other], names[row]))
    if not pairs:
        return []
    text = (
        f"the same picture has two labels ({', '.join(pairs[0])}), in {len(pairs)} "
        f"{'case' if len(pairs) == 1 else 'cases'}: at least one is wrong, so check which and remove its row"
    )
    return [text]


def _in_order_of(
    column: str, found: LabelledImages, kept: pd.DataFrame
) -> tuple[LabelledImages, pd.DataFrame]:
    """Images and labels by the numbers of a column, which say when each was taken."""
    if column not in kept.columns or label_kinds(kept)[column] != "number":
        raise LabelError(f"{found.source} has no column of numbers {column!r} to put the rows in order by")
    order = np.argsort(kept[column].to_numpy(), kind="stable")
    if (twice := np.flatnonzero(kept[column].duplicated())).size:
        raise LabelError(
            f"{found.source}, {rows_text(twice)}: {column!r} has the number of another row; rows are put in "
            "order by a number of their own"
        )
    paths, names = ([each[i] for i in order] for each in (found.paths, found.names))
    table = found.table.iloc[order].reset_index(drop=True)
    found = replace(found, table=table, paths=tuple(paths), names=tuple(names))
    return found, kept.iloc[order].reset_index(drop=True)


def _found(folder: Path, layout: LabelLayout) -> tuple[LabelledImages, Manifest | None]:
    """Images and labels, and the manifest of the run that the folder was exported from, where it was."""
    found = find_labelled_images(folder, layout)
    if found.image_column != FILE_COLUMN or not (folder / MANIFEST).is_file():
        return found, None
    exported = Manifest.read(folder)  # says what CSV cannot, such as that 007 is a text
    return find_labelled_images(folder, layout, exported.labels), exported


def _manifest(
    about: dict[str, str],
    provenance: Provenance | None,
    exported: Manifest | None,
    kept: pd.DataFrame,
    timed: bool,
    by_name: bool,
) -> Manifest:
    """Manifest by what the caller says, else by what an exported folder says of itself."""
    texts = {name: text or (getattr(exported, name) if exported else "") for name, text in about.items()}
    return Manifest.new(
        sensor=texts["sensor"],
        rig=texts["rig"],
        licence=texts["licence"],
        origin=texts["origin"],
        provenance=provenance or (exported.provenance if exported else Provenance.MEASURED),
        targets=tuple(one for one in exported.targets if one in kept) if exported else (),
        seed=exported.seed if exported else None,
        labels=label_kinds(kept),
        clock="measured" if timed else "ordinal",
        order="names" if by_name or (exported and exported.order == "names") else "recorded",
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


def _times_ns(table: pd.DataFrame, source: str, rate_hz: float | None, column: str | None) -> np.ndarray:
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


def _labels(found: LabelledImages) -> pd.DataFrame:
    """Labels that the run keeps: all but the exporter's own columns; image names where runs look for them."""
    kept = found.table.drop(columns=[FILE_COLUMN, TIME_COLUMN], errors="ignore")
    if NAME_COLUMN in kept.columns:
        return kept
    if found.image_column in kept.columns:
        return kept.rename(columns={found.image_column: NAME_COLUMN})
    if found.image_column == FILE_COLUMN:
        return kept  # as an exported run had none, whose frames are called by their numbers
    return pd.DataFrame({NAME_COLUMN: list(found.names)}).join(kept)


def _row(table: pd.DataFrame, i: int) -> dict[str, Any]:
    cells = {str(name): table[name].iloc[i] for name in table.columns}
    # numpy's scalars become Python's, which is what a run's labels are made of
    return {name: cell.item() if isinstance(cell, np.generic) else cell for name, cell in cells.items()}


def _report(table: pd.DataFrame, doubts: tuple[str, ...] = ()) -> ImportReport:
    numbers = [name for name, kind in label_kinds(table).items() if kind == "number"]
    return ImportReport(
        frames=len(table),
        columns=tuple(str(name) for name in table.columns),
        units={name: split_column(name)[1].symbol for name in numbers if has_unit(name)},
        unitless=tuple(name for name in numbers if not has_unit(name)),
        doubts=doubts,
    )


def _tell(progress: ProgressCount | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done, total)


def import_press(
    frames: Path,
    run: Path,
    *,
    force: Path,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
    sensor: str = "",
    licence: str = "",
    origin: str = "",
    provenance: Provenance | None = None,
    progress: ProgressCount | None = None,
) -> ImportReport:
    """Turn one press into a run, which appears whole or not at all.

    Args:
        run: the run to make; must not exist.
        force: the table; see `read_press_table` for it and its columns.
    """
    refuse_existing(run)
    with open_sequence(frames) as sequence:
        table = read_press_table(
            force, len(sequence), force_column=force_column, position_column=position_column, rate_hz=rate_hz
        )
        names = _label_names(table)
        manifest = Manifest.new(
            sensor=sensor,
            licence=licence,
            origin=origin,
            provenance=provenance or Provenance.MEASURED,
            labels=dict.fromkeys(names, "number"),
        )
        with whole_run(run, manifest) as writer:
            _samples(writer, table)
            _frames(writer, table, sequence, progress)
    units = {name: name.rpartition("_")[2] for name in names}
    return ImportReport(len(table.frame_sample), names, units, ())


def _label_names(table: PressTable) -> tuple[str, ...]:
    position = () if table.position_m is None else ("position_mm",)
    area = () if table.area_column is None else (table.area_column,)
    return ("force_N", *position, *area)


def _samples(writer: RunWriter, table: PressTable) -> None:
    for i, (seconds, newtons) in enumerate(zip(table.time_s, table.force_n, strict=True)):
        time_ns = round(seconds * NS_PER_S)
        writer.force((0.0, 0.0, float(newtons), 0.0, 0.0, 0.0), time_ns=time_ns)
        if table.position_m is not None:
            writer.stage((0.0, 0.0, float(table.position_m[i])), time_ns=time_ns)


def _frames(
    writer: RunWriter, table: PressTable, sequence: FrameSequence, progress: ProgressCount | None
) -> None:
    for k, (image, sample) in enumerate(zip(sequence, table.frame_sample, strict=True)):
        labels = {"force_N": float(table.force_n[sample])}
        if table.position_m is not None:
            labels["position_mm"] = 1e3 * float(table.position_m[sample])
        if table.area_m2 is not None and table.area_column and np.isfinite(table.area_m2[sample]):
            labels[table.area_column] = 1e6 * float(table.area_m2[sample])
        writer.frame(image, time_ns=round(table.time_s[sample] * NS_PER_S), labels=labels)
        if progress is not None:
            progress(k + 1, len(table.frame_sample))
