"""Files that hold labels: tables of text and Parquet, JSON, NumPy arrays; each becomes a table."""

from __future__ import annotations

import io
import json
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.core import LabelError, storage_errors
from palpate.core.array_files import arrays_of
from palpate.core.parsing import parser
from palpate.recordings.exchange.image_files import IMAGE_SUFFIXES
from palpate.recordings.label_tables import (
    MAX_CELLS,
    MAX_LABEL_BYTES,
    Decimal,
    check_names,
    read_labels,
    refuse_formulas,
    typed_column,
)
from palpate.recordings.manifest import LabelKind

_NPY, _NPZ, _PICKLES = b"\x93NUMPY", b"PK\x03\x04", (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")
KEY_COLUMN = "image_file"
"""Column that the names become in a JSON object with an object for each image's name."""
_MAX_DEPTH = 8  # of objects inside objects in JSON


@parser("label file", LabelError, max_bytes=MAX_LABEL_BYTES)
def read_label_file(
    path: Path,
    *,
    names: Sequence[str] = (),
    decimal: Decimal = "auto",
    kinds: Mapping[str, LabelKind] | None = None,
    holds_all: bool = False,
) -> pd.DataFrame:
    """Read labels, one row an image, from a file that is recognised by content.

    JSON is one object a line, a list of objects, or an object with one for each image's name;
    ``{"force": {"x": 1}}`` becomes the column ``force_x`` and ``{"pose": [0, 1]}`` the columns ``pose_0`` and
    ``pose_1``. A NumPy file holds one array ``[n k]``, whose columns `names` names, or one with fields; an
    archive of them holds a column (or ``[n k]``) each.

    Args:
        names: of the columns, where the file itself has none.
        decimal: what stands before decimals in a table of text, see `read_labels`.
        kinds: of columns where a reader must not guess.
        holds_all: whether the file is that of all images, so that one object of JSON with one list of objects
            in it holds its rows there.
    """
    if not path.is_file():
        raise LabelError(f"table of labels {path} is not there (or no plain file); check the name")
    with storage_errors(path):
        if path.stat().st_size > MAX_LABEL_BYTES:
            raise LabelError(f"{path} has more than {MAX_LABEL_BYTES} bytes; divide the table")
        with path.open("rb") as file:
            start = file.read(64)
    if start.startswith(_PICKLES):
        raise LabelError(
            f"{path} is a pickle, which can run code as it is opened and is not read; save its numbers as a "
            "table or by numpy.save"
        )
    if start.startswith((_NPY, _NPZ)):
        return _checked(_array_columns(path, tuple(names)), path)
    if start.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in (b"{", b"["):
        rows = _json_rows(path)
        return json_table(_listed_rows(rows) if holds_all else rows, path)
    return read_labels(path, kinds=kinds, names=names, decimal=decimal)


def json_table(rows: Sequence[Any], source: Path) -> pd.DataFrame:
    """A table of JSON objects, a row each, in the columns of all of them."""
    flat: list[dict[str, Any]] = []
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, dict):
            raise LabelError(
                f"{source}, object {number} is {str(row)[:40]!r}; labels are objects, name: value"
            )
        flat.append(dict(_flat("", row, f"{source}, object {number}")))
    names = list(dict.fromkeys(name for row in flat for name in row))
    if len(names) * len(flat) > MAX_CELLS:
        raise LabelError(
            f"{source} makes {len(flat)} rows of {len(names)} columns. Up to {MAX_CELLS} cells are read.",
            code="table-size",
        )
    return _checked(
        {name: _json_column([row.get(name) for row in flat], name, source) for name in names}, source
    )


def _flat(prefix: str, value: Any, where: str, depth: int = 0) -> list[tuple[str, Any]]:
    """Names and values of what stands in an object, those of inner ones joined by ``_``."""
    if depth > _MAX_DEPTH:
        raise LabelError(f"{where} holds objects in objects more than {_MAX_DEPTH} deep; labels lie flatter")
    if isinstance(value, dict):
        inner = [(str(name), one) for name, one in value.items()]
    elif isinstance(value, list):
        inner = [(str(i), one) for i, one in enumerate(value)]
    else:
        return [(prefix, value)]
    joined = [(f"{prefix}_{name}" if prefix else name, one) for name, one in inner]
    flat = [pair for name, one in joined for pair in _flat(name, one, where, depth + 1)]
    counts = Counter(name for name, _ in flat) if depth == 0 else Counter()
    twice = [name for name, count in counts.items() if count > 1]
    if twice:
        raise LabelError(f"{where} names {twice[0]!r} twice, once as an object's part; rename one")
    return flat


def _json_column(values: Sequence[Any], name: str, source: Path) -> pd.Series[Any]:
    known = [value for value in values if value is not None]
    if known and all(isinstance(value, bool) for value in known) and len(known) == len(values):
        return pd.Series(list(values), dtype=bool)
    if known and all(isinstance(value, int | float) and not isinstance(value, bool) for value in known):
        return pd.Series([np.nan if value is None else float(value) for value in values], dtype=np.float64)
    if all(isinstance(value, str) for value in known):
        return pd.Series(["" if value is None else value for value in values], dtype=str)
    raise LabelError(
        f"{source}: column {name!r} holds values of several kinds, or flags with gaps; a column is all "
        "numbers, "
        "all texts, or all true and false"
    )


def _json_rows(path: Path) -> list[Any]:
    with storage_errors(path):
        text = path.read_bytes()
    try:
        decoded = text.decode("utf-8-sig")
        if decoded.lstrip().startswith("["):
            return list(_parsed(decoded))
        try:
            return _rows_of_object(_parsed(decoded))  # over as many lines as it likes
        except ValueError:
            return [_parsed(line) for line in decoded.splitlines() if line.strip()]
    except (ValueError, RecursionError) as e:
        raise LabelError(f"{path} is not JSON: neither one value nor one object a line ({e})") from e


def _rows_of_object(whole: Any) -> list[Any]:
    """Rows of an object that has an object for each image's name; another one is a row itself."""
    images = (
        isinstance(whole, dict)
        and whole
        and all(
            isinstance(row, dict) and Path(name).suffix.lower() in IMAGE_SUFFIXES
            for name, row in whole.items()
        )
    )
    return [{KEY_COLUMN: name} | row for name, row in whole.items()] if images else [whole]


def _listed_rows(rows: list[Any]) -> list[Any]:
    """Rows of the one list of objects in a single object, which may say more of them all; else as given."""
    if len(rows) != 1 or not isinstance(rows[0], dict):
        return rows
    lists = [one for one in rows[0].values() if isinstance(one, list) and len(one) > 1]
    of_objects = [one for one in lists if all(isinstance(row, dict) for row in one)]
    return of_objects[0] if len(of_objects) == 1 else rows


def _parsed(text: str) -> Any:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is no number in JSON")

    return json.loads(text, parse_constant=refuse)


@parser("label object test", LabelError, max_bytes=MAX_LABEL_BYTES)
def holds_one_object(path: Path) -> bool:
    """True where a file is JSON and one object that is no table itself."""
    with storage_errors(path), path.open("rb") as file:
        start = file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip()
    if not start.startswith(b"{") or path.stat().st_size > MAX_LABEL_BYTES:
        return False
    rows = _json_rows(path)
    return len(rows) == 1 and isinstance(rows[0], dict)


@parser("label object", LabelError, max_bytes=MAX_LABEL_BYTES)
def read_json_object(path: Path) -> dict[str, Any]:
    """The one object of a file that labels one image."""
    if not path.is_file() or path.stat().st_size > MAX_LABEL_BYTES:
        raise LabelError(f"{path} is no plain file, or too large")
    rows = _json_rows(path)
    if len(rows) != 1 or not isinstance(rows[0], dict):
        raise LabelError(f"{path} holds {len(rows)} values; a file that labels one image holds one object")
    return rows[0]


def _array_columns(path: Path, names: tuple[str, ...]) -> dict[str, pd.Series[Any]]:
    with storage_errors(path):
        data = path.read_bytes()
    try:
        if data.startswith(_NPZ):
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                arrays = arrays_of(archive, str(path))
        else:
            arrays = {"": np.load(io.BytesIO(data), allow_pickle=False)}
    except Exception as e:  # a damaged archive may raise anything
        raise LabelError(
            f"{path} cannot be read as a NumPy array of plain numbers or texts ({e}); save it again by "
            "numpy.save, "
            "without objects"
        ) from e
    columns: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        columns |= _columns_of(path, name, array, names)
    if len({len(column) for column in columns.values()}) > 1:
        sizes = ", ".join(f"{name} {len(column)}" for name, column in columns.items())
        raise LabelError(f"{path} holds columns of different lengths ({sizes}); each has a row an image")
    return {name: _array_column(path, name, column) for name, column in columns.items()}


def _columns_of(path: Path, name: str, array: np.ndarray, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    if array.dtype.names:
        return {field: array[field] for field in array.dtype.names}
    if array.ndim == 1 and name:
        return {name: array}
    is_one_row = array.ndim == 1 and len(names) == array.size > 1
    table = array[None] if is_one_row else array[:, None] if array.ndim == 1 else array
    if table.ndim != 2:
        raise LabelError(f"{path} holds an array of shape {list(array.shape)}; labels are [rows, columns]")
    if name:
        return {f"{name}_{k}": table[:, k] for k in range(table.shape[1])}
    if len(names) != table.shape[1]:
        raise LabelError(
            f"{path} holds {table.shape[1]} columns without names, and {len(names)} are named; name each in "
            "their "
            "order, as in --columns x_mm,y_mm,force_N"
        )
    check_names(path, names)
    return {column: table[:, k] for k, column in enumerate(names)}


def _array_column(path: Path, name: str, values: np.ndarray) -> pd.Series[Any]:
    if values.ndim != 1:
        raise LabelError(f"{path}: column {name!r} has the shape {list(values.shape)}; a column is [rows]")
    if values.dtype.kind == "b":
        return pd.Series(values, dtype=bool)
    if values.dtype.kind in "iuf":
        return pd.Series(values.astype(np.float64))
    if values.dtype.kind == "U":
        return typed_column([str(value) for value in values])
    raise LabelError(f"{path}: column {name!r} is of kind {values.dtype}; labels are numbers, texts or flags")


def _checked(columns: Mapping[str, pd.Series[Any]], path: Path) -> pd.DataFrame:
    check_names(path, list(columns))
    table = pd.DataFrame(dict(columns))
    if table.empty:
        raise LabelError(f"{path} holds no rows; labels have one row an image")
    refuse_formulas(table, path)
    return table
