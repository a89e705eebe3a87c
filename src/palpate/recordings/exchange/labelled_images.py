"""Labels and their images brought together: by a column of names, a file an image, names, or order."""

from __future__ import annotations

import glob
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from palpate.core import InputError, LabelError, is_hidden
from palpate.recordings.exchange.image_files import IMAGE_SUFFIXES
from palpate.recordings.exchange.label_files import (
    holds_one_object,
    json_table,
    read_json_object,
    read_label_file,
)
from palpate.recordings.label_tables import (
    FIRST_ROW,
    Decimal,
    label_kinds,
    names_text,
    refuse_formulas,
    rows_text,
    typed_column,
)
from palpate.recordings.manifest import LabelKind

IMAGE_COLUMNS = (
    "frame_file", "image_file", "image", "image_name", "image_path", "sensor_image", "img", "file_name",
    "filename", "file", "path", "frame",
)  # fmt: skip
"""Columns that name images by custom, looked for where none is named; the first that is there is taken."""
SESSION_COLUMN = "session"
IMAGE_FOLDERS = ("", "images", "processed_images", "frames")
"""Where below a table's own folder an image may lie."""
_SHOWN = 5
_FIELD = re.compile(r"\{([^{}]*)\}")


@dataclass(frozen=True, slots=True)
class LabelLayout:
    """Location of the labels and their assignment to images.

    Attributes:
        labels: Label file or a pattern such as ``*/labels.csv`` or ``*.json``; None with `name_pattern`.
        image_column: Column that names the image of each row; None takes the first of `IMAGE_COLUMNS`.
        name_pattern: Pattern of image names, such as ``x{x_mm}_f{force_N}.png``.
        columns: Column names of a file without a header.
        in_order: Assign row ``i`` to the ``i``-th image, ordered by the numbers in the names.
        allow_unlabelled: Ignore images that do not match the pattern.
    """

    labels: Path | None
    image_column: str | None = None
    name_pattern: str | None = None
    columns: tuple[str, ...] = ()
    decimal: Decimal = "auto"
    in_order: bool = False
    allow_unlabelled: bool = False

    def __post_init__(self) -> None:
        if (self.labels is None) == (self.name_pattern is None):
            raise InputError(
                "labels come from a file (--labels) or from the images' names (--name-pattern): one"
            )
        if self.in_order and (self.image_column or self.name_pattern):
            raise InputError(
                "--in-order is for labels that name no image; leave out the column and the pattern"
            )


@dataclass(frozen=True, slots=True)
class LabelledImages:
    """Images and their labels, in the same order.

    Attributes:
        names: Image names as in the labels.
        source: Origin of the labels, for messages.
        image_column: Column that named the images; empty for none.
    """

    table: pd.DataFrame
    paths: tuple[Path, ...]
    names: tuple[str, ...]
    source: str
    image_column: str


def find_labelled_images(
    folder: Path, layout: LabelLayout, kinds: Mapping[str, LabelKind] | None = None
) -> LabelledImages:
    """Read labels and find the image of each row.

    Args:
        folder: where the images are, themselves or in a folder ``images``.
        layout: where the labels are.
        kinds: of columns where a reader must not guess.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder of images; check the name", code="folder-missing")
    if layout.name_pattern is not None:
        found = _by_names(folder, layout.name_pattern, allow_unlabelled=layout.allow_unlabelled)
    else:
        labels = Path(layout.labels or "")
        files = _label_files(folder, labels)
        if _is_pattern(folder, labels) and all(map(holds_one_object, files)):
            found = _by_files(folder, layout, files)
        else:
            found = _by_tables(folder, layout, files, kinds or {})
    _check_once(found)
    return found


def images_in(folder: Path) -> list[Path]:
    """All images below a folder, in the order of the numbers in their names; hidden ones left out."""
    found = (path for path in folder.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
    return sorted((p for p in found if not is_hidden(p, folder)), key=lambda p: natural_order(p, folder))


def natural_order(path: Path, folder: Path) -> list[tuple[int, int, str]]:
    """A key that sorts ``tap_9`` before ``tap_10``."""
    parts = re.split(r"(\d+)", path.relative_to(folder).as_posix())
    return [(1, int(part), part) if part.isdecimal() else (0, 0, part) for part in parts]


def _is_pattern(folder: Path, labels: Path) -> bool:
    there = labels.is_file() or (folder / labels).is_file()
    return glob.has_magic(str(labels)) and not there


def _label_files(folder: Path, labels: Path) -> list[Path]:
    if not _is_pattern(folder, labels):
        return [labels if labels.is_file() else folder / labels]
    if labels.is_absolute() or ".." in labels.parts:
        raise LabelError(
            f"the pattern {labels} does not stay inside {folder}; write it relative to that folder"
        )
    found = [path for path in folder.glob(str(labels)) if path.is_file() and not is_hidden(path, folder)]
    if not found:
        raise LabelError(
            f"no file in {folder} matches {str(labels)!r}; check the pattern, and put it in quotes"
        )
    return sorted(found, key=lambda path: natural_order(path, folder))


def _by_tables(
    folder: Path, layout: LabelLayout, files: Sequence[Path], kinds: Mapping[str, LabelKind]
) -> LabelledImages:
    """Labels from tables, one or one a session."""
    if layout.in_order and len(files) > 1 and (rows := _single_rows(layout, files)) is not None:
        refuse_gaps(rows, f"the files in {folder}")
        return _in_order(folder, rows, f"{len(files)} files in {folder}")
    parts = [_of_table(folder, layout, file, kinds, alone=len(files) == 1) for file in files]
    if len(parts) == 1:
        return parts[0]
    columns = [list(part.table.columns) for part in parts]
    odd = next((i for i, names in enumerate(columns) if set(names) != set(columns[0])), None)
    if odd is not None:
        missing = sorted(set(columns[0]) ^ set(columns[odd]))
        raise LabelError(
            f"{parts[odd].source} and {parts[0].source} differ in the columns {', '.join(missing)}; tables "
            "of one "
            "run have the same columns"
        )
    table = pd.concat([part.table for part in parts], ignore_index=True)
    if SESSION_COLUMN not in table.columns:
        sessions = _session_names(folder, files)
        table[SESSION_COLUMN] = np.repeat(sessions, [len(part.table) for part in parts]).astype(object)
    home = folder.resolve()
    names = tuple(path.relative_to(home).as_posix() for part in parts for path in part.paths)
    if parts[0].image_column:
        table[parts[0].image_column] = list(names)  # tap_1.png of each session is another
    return LabelledImages(
        table,
        tuple(path for part in parts for path in part.paths),
        names,
        f"{len(parts)} tables in {folder}",
        parts[0].image_column,
    )


def _single_rows(layout: LabelLayout, files: Sequence[Path]) -> pd.DataFrame | None:
    """The rows of files that hold one each, an image's; None where a file holds more."""
    tables = []
    for file in files:
        tables.append(read_label_file(file, names=layout.columns, decimal=layout.decimal))
        if len(tables[-1]) != 1:
            return None
    return pd.concat(tables, ignore_index=True)


def _session_names(folder: Path, files: Sequence[Path]) -> list[str]:
    """A name for each table: its folder, or, where tables share a folder, its own name too."""
    places = [file.parent.relative_to(folder).as_posix() for file in files]
    if len(set(places)) == len(places):
        return places
    return [file.relative_to(folder).with_suffix("").as_posix() for file in files]


def _of_table(
    folder: Path, layout: LabelLayout, file: Path, kinds: Mapping[str, LabelKind], *, alone: bool
) -> LabelledImages:
    read = partial(read_label_file, file, names=layout.columns, decimal=layout.decimal, holds_all=alone)
    given = layout.image_column
    table = read(kinds={**kinds, given: "text"} if given else kinds)
    refuse_gaps(table, str(file))
    home = folder if alone and not file.resolve().is_relative_to(folder.resolve()) else file.parent
    if layout.in_order:
        return _in_order(folder if alone else home, table, str(file))
    column = given or next((name for name in IMAGE_COLUMNS if name in table.columns), None)
    if column is None or column not in table.columns:
        asked = f"no column {column!r}" if column else "no column named as those of images are"
        raise LabelError(
            f"{file} has {asked}; its columns are {names_text(table.columns)}; name the one with "
            "--image-column, or "
            "say --in-order where row i belongs to image i"
        )
    if not given and is_numeric_dtype(table[column].dtype):
        table = read(kinds={**kinds, column: "text"})  # 007 is a name, and no 7
    names = [_plain(cell) for cell in table[column]]
    homes = list(dict.fromkeys([folder, home]) if alone else [home, folder])
    places = [place / inner for place in homes for inner in IMAGE_FOLDERS]
    paths = [_inside(folder, places, name, f"{file}, row {row}") for row, name in enumerate(names, FIRST_ROW)]
    missing = [i for i, path in enumerate(paths) if path is None]
    if missing:
        shown = ", ".join(repr(names[i]) for i in missing[:_SHOWN])
        raise LabelError(
            f"{file}, {rows_text(missing)}: no such image in {folder} or {folder / 'images'}: {shown}; "
            "copy the images there, or remove the rows"
        )
    table = table.assign(**{column: names})
    return LabelledImages(table, tuple(p for p in paths if p is not None), tuple(names), str(file), column)


def _plain(cell: object) -> str:
    """A name as text; a whole number, which a table of numbers holds as 7.0, without its point."""
    return str(int(cell)) if isinstance(cell, float) and cell.is_integer() else str(cell)


def _in_order(home: Path, table: pd.DataFrame, source: str) -> LabelledImages:
    paths = images_in(home)
    if len(paths) != len(table):
        raise LabelError(
            f"{source}: {len(table)} rows, and {len(paths)} images in {home}; rows belong to images in "
            "their order only "
            "where there are as many"
        )
    names = tuple(path.relative_to(home).as_posix() for path in paths)
    return LabelledImages(table, tuple(path.resolve() for path in paths), names, source, "")


def _by_files(folder: Path, layout: LabelLayout, files: Sequence[Path]) -> LabelledImages:
    """Labels from files of one object each; the image is named in it, or is the one of the same name."""
    table = json_table([read_json_object(file) for file in files], folder)
    refuse_gaps(table, f"the files in {folder}")
    given = layout.image_column or next((name for name in IMAGE_COLUMNS if name in table.columns), None)
    if layout.image_column and layout.image_column not in table.columns:
        raise LabelError(f"the objects in {folder} have no {given!r}; they have {names_text(table.columns)}")
    names = [_plain(cell) for cell in table[given]] if given else [file.stem for file in files]
    paths = []
    for file, name in zip(files, names, strict=True):
        around = [file.parent, file.parent.parent] if file.parent != folder else [folder]
        places = [place / inner for place in around for inner in IMAGE_FOLDERS]
        path = _inside(folder, places, name, str(file))
        if path is None:
            raise LabelError(
                f"{file}: no image {name!r} beside it or in {folder / 'images'}; name it in the file"
            )
        paths.append(path)
    if given:
        table = table.assign(**{given: names})
    home = folder.resolve()
    shown = tuple(path.relative_to(home).as_posix() for path in paths)
    return LabelledImages(table, tuple(paths), shown, f"{len(files)} files in {folder}", given or "")


def _by_names(folder: Path, pattern: str, *, allow_unlabelled: bool) -> LabelledImages:
    """Labels from the images' own names."""
    fields, expression = name_expression(pattern)
    every = [(path, path.relative_to(folder).as_posix()) for path in images_in(folder)]
    found = [(path, name, match) for path, name in every if (match := _match(expression, name))]
    if not found or (len(found) < len(every) and not allow_unlabelled):
        fitting = {name for _, name, _ in found}
        strange = [name for _, name in every if name not in fitting]
        shown = ", ".join(map(repr, strange[:_SHOWN])) or "none is there"
        raise LabelError(
            f"{len(strange)} of {len(every)} images in {folder} are not named {pattern!r}, e.g. {shown}; "
            "write the whole name, with {NAME} for each label, or allow unlabelled images to leave them out"
        )
    columns = {name: typed_column([m.groups()[k] for _, _, m in found]) for k, name in enumerate(fields)}
    table = pd.DataFrame(columns)
    refuse_formulas(table, folder)
    refuse_gaps(table, f"names in {folder}")
    paths, names = tuple(path.resolve() for path, _, _ in found), tuple(name for _, name, _ in found)
    return LabelledImages(table, paths, names, f"names in {folder}", "")


def name_expression(pattern: str) -> tuple[list[str], re.Pattern[str]]:
    """Fields of a pattern such as ``x{x_mm}_f{force_N}.png``, and an expression with a group for each."""
    parts = _FIELD.split(pattern)
    fields, texts = parts[1::2], parts[::2]
    if not fields or len(set(fields)) < len(fields) or not all(map(str.isidentifier, fields)):
        raise InputError(
            f"the pattern {pattern!r} names {fields or 'no label'}; write each once, as in "
            f"x{{x_mm}}_f{{force_N}}.png"
        )
    if not all(texts[1:-1]):
        raise InputError(
            f"the pattern {pattern!r} has two labels without anything between to tell them apart"
        )
    middle = "".join(f"([^/]+?){re.escape(text)}" for text in texts[1:])
    return fields, re.compile(re.escape(texts[0]) + middle)


def _match(expression: re.Pattern[str], name: str) -> re.Match[str] | None:
    """The whole name by the pattern, or its end where the pattern names no folder."""
    if (match := expression.fullmatch(name)) is not None:
        return match
    count = expression.pattern.replace(r"[^/]", "").count("/")
    return expression.fullmatch("/".join(name.split("/")[-1 - count :]))


def _inside(folder: Path, places: Sequence[Path], name: str, where: str) -> Path | None:
    """The image that a cell names, with or without its suffix; None if it is not there."""
    if not name:
        raise LabelError(f"{where} names no image; name one, or remove the row")
    posix, windows = PurePosixPath(name), PureWindowsPath(name)
    if posix.is_absolute() or windows.drive or windows.root or ".." in windows.parts:
        raise LabelError(
            f"{where}: image {name!r} does not stay inside {folder}; "
            "name images relative to the folder, without '..'"
        )
    path = _existing([place / posix for place in places])
    if path is None and posix.suffix.lower() not in IMAGE_SUFFIXES:
        suffixed = [[place / f"{posix}{suffix}" for suffix in sorted(IMAGE_SUFFIXES)] for place in places]
        path = next((one for paths in suffixed if (one := _only(paths, where))), None)
    if path is not None and not path.resolve().is_relative_to(folder.resolve()):
        raise LabelError(
            f"{where}: image {name!r} is a link that leads out of {folder}; copy the image there"
        )
    return None if path is None else path.resolve()


def _existing(paths: Sequence[Path]) -> Path | None:
    return next((path for path in paths if path.exists()), None)


def _only(paths: Sequence[Path], where: str) -> Path | None:
    there = [path for path in paths if path.is_file()]
    if len(there) > 1:
        raise LabelError(
            f"{where} may mean {there[0].name} or {there[1].name}; write the suffix too",
            code="image-ambiguous",
        )
    return there[0] if there else None


def _check_once(found: LabelledImages) -> None:
    first: dict[Path, int] = {}
    for i, path in enumerate(found.paths):
        if path in first:
            raise LabelError(
                f"{found.source}: {rows_text([first[path], i])} name the same image, {path.name!r}; keep "
                "one of "
                f"the rows"
            )
        first[path] = i


def refuse_gaps(table: pd.DataFrame, source: str) -> None:
    """Raise if a column of numbers has a cell without a finite one."""
    for name, kind in label_kinds(table).items():
        if kind != "number":
            continue
        bad = np.flatnonzero(~np.isfinite(table[name].to_numpy()))
        if bad.size:
            raise LabelError(
                f"{source}, {rows_text(bad)}: column {name!r} holds no finite number there; fill it in, or "
                "remove the rows with their images, or the column"
            )


def refuse_strays(folder: Path, found: LabelledImages) -> None:
    """Raise if an image in the folder has no labels."""
    named = set(found.paths)
    strays = sorted(
        path.relative_to(folder).as_posix() for path in images_in(folder) if path.resolve() not in named
    )
    if strays:
        raise LabelError(
            f"{len(strays)} images in {folder} have no row in {found.source}: {', '.join(strays[:_SHOWN])}; "
            "add their rows, move them away, or allow unlabelled images to leave them out"
        )
