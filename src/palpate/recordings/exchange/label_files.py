"""Files that hold labels: tables of text and Parquet, JSON, NumPy arrays; each becomes a table.

Units of imported columns: given by name where they have none, and doubted where the numbers are odd.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.core import UNITS, LabelError, Unit, UnitError, has_unit, split_column, storage_errors, unit
from palpate.core.array_files import arrays_of
from palpate.core.parsing import parser
from palpate.recordings.exchange.image_files import IMAGE_SUFFIXES
from palpate.recordings.label_tables import (
    MAX_CELLS,
    MAX_LABEL_BYTES,
    Decimal,
    check_names,
    label_kinds,
    names_text,
    read_labels,
    refuse_formulas,
    refuse_reserved,
    rows_text,
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


def with_units(
    table: pd.DataFrame, renames: Mapping[str, str], units: Mapping[str, str], source: str
) -> pd.DataFrame:
    """Rename columns, and append a unit to the names of those that have none.

    Args:
        units: a column's name, or its new one -> its unit; ``depth`` in ``mm`` becomes ``depth_mm``.
    """
    _refuse_strangers(table, renames, source)
    for old, new in renames.items():
        if not new.strip():
            raise LabelError(f"{source}: column {old!r} is renamed to nothing; give a name such as depth_mm")
    table = table.rename(columns=dict(renames))
    _refuse_strangers(table, units, source)
    for name, symbol in units.items():
        unit(symbol)
        if has_unit(name):
            raise UnitError(
                f"{source}: column {name!r} has a unit already, {split_column(name)[1].symbol}; to correct "
                "it say "
                f"--rename {name}={split_column(name)[0]}_{symbol}"
            )
    table = table.rename(columns={name: f"{name}_{symbol}" for name, symbol in units.items()})
    names = [str(name) for name in table.columns]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise LabelError(f"{source}: two columns would be called {twice[0]!r}; rename one otherwise")
    refuse_reserved([*renames.values()], source)
    return table


def _refuse_strangers(table: pd.DataFrame, names: Mapping[str, str], source: str) -> None:
    for name in names:
        if name not in table.columns:
            raise LabelError(f"{source} has no column {name!r}; its columns are {names_text(table.columns)}")


GUESSES = (
    (("depth", "indent", "shear", "position", "dist", "height", "radius", "disp", "edge"), "mm"),
    (("force", "load"), "N"),
    (("torque", "moment"), "Nmm"),
    (("angle", "tilt", "twist", "yaw", "roll", "pitch", "rot", "theta"), "deg"),
    (("mass", "weight"), "g"),
    (("pressure", "modulus", "stiffness"), "kPa"),
    (("time", "stamp"), "s"),
)
"""Parts of names, and the unit that such a quantity mostly is in."""
_LETTERS = {
    "x": "mm",
    "y": "mm",
    "z": "mm",
    "fx": "N",
    "fy": "N",
    "fz": "N",
    "tx": "Nmm",
    "ty": "Nmm",
    "tz": "Nmm",
}


def guessed_unit(name: str) -> str | None:
    """Unit that a column of this name mostly is in; None where the name tells nothing."""
    plain = name.lower()
    if plain in _LETTERS:
        return _LETTERS[plain]
    return next((symbol for parts, symbol in GUESSES if any(part in plain for part in parts)), None)


@dataclass(frozen=True, slots=True)
class UsualSize:
    """Sizes that touch has of a quantity: the largest magnitude of a column usually lies between."""

    smallest: float
    largest: float
    why: str


_DEEP = ("depth", "indent", "shear", "approach")
_TOUCH_DEEP = UsualSize(2e-5, 0.05, "50 mm, further than a skin yields")
USUAL: dict[str, UsualSize] = {
    "m": UsualSize(2e-5, 2.0, "2 m, the reach of an arm"),
    "N": UsualSize(2e-3, 500.0, "500 N, more than a soft skin bears"),
    "Nm": UsualSize(1e-5, 20.0, "20 Nm, more than a touch makes"),
    "rad": UsualSize(math.radians(0.2), math.radians(370.0), "a full turn"),
    "kg": UsualSize(1e-5, 50.0, "50 kg, more than a soft skin bears"),
    "m2": UsualSize(1e-9, 0.1, "a tenth of a square metre"),
    "m2_per_N": UsualSize(1e-10, 1e-2, "a hundredth of a square metre per newton"),
    "Pa": UsualSize(1.0, 1e12, "that of diamond"),
    "N_per_m": UsualSize(1e-2, 1e8, "that of a machine's frame"),
    "ratio": UsualSize(0.0, math.inf, ""),
    "px": UsualSize(0.0, 1e5, "the size of any picture"),
    "s": UsualSize(0.0, math.inf, ""),
}
_HALF_TURNS = (math.pi / 2, math.pi, 2 * math.pi)


def unit_doubts(table: pd.DataFrame) -> tuple[str, ...]:
    """Sentences on columns whose numbers do not look like the unit in their name."""
    doubts = []
    for name, kind in label_kinds(table).items():
        if not has_unit(name):
            continue
        if kind == "number":
            doubts += [text for text in [_doubt(name, table[name].to_numpy(np.float64))] if text]
        elif kind == "text":
            odd = [i for i, cell in enumerate(table[name]) if not _is_number(str(cell))]
            cell = str(table[name].iloc[(odd or [0])[0]])[:40]
            remove = f"; fill in or remove {rows_text(odd)}" if 0 < len(odd) < len(table) else ""
            doubts.append(
                f"column {name} names a unit and holds text, e.g. {cell!r} in {rows_text((odd or [0])[:1])}: "
                f"it cannot be a target{remove}"
            )
    return tuple(doubts)


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _doubt(name: str, values: np.ndarray) -> str:
    quantity, named = split_column(name)
    size = float(np.abs(values).max())
    usual = _TOUCH_DEEP if named.si == "m" and quantity.lower().startswith(_DEEP) else USUAL[named.si]
    if size == 0 or not np.isfinite(size):
        return ""
    if text := _missing(name, values, named.to_si(size) > usual.largest):
        return text
    span = f"column {name} runs from {values.min():.4g} to {values.max():.4g} {named.symbol}"
    if named.to_si(size) > usual.largest:
        return f"{span}, beyond {usual.why}{_instead(name, quantity, named, size, usual)}"
    if named.symbol == "deg" and _ends_as_radians(size, len(values)):
        return f"{span}, which looks like radians; if so, say --rename {name}={quantity}_rad"
    if named.to_si(size) < usual.smallest:
        return f"{span}, less than touch usually has{_instead(name, quantity, named, size, usual)}"
    return ""


MISSING = frozenset(sign * (10**digits - 1) for sign in (-1, 1) for digits in range(2, 7))
"""Numbers such as -999 that stand, by custom, where nothing was measured."""
MAX_MISSING = 0.1
"""Share of rows that may be such; more, and the numbers may be meant."""
FAR = 10
"""How far from the middle three fifths of the rows, over their span."""


def _missing(name: str, values: np.ndarray, unusual: bool) -> str:
    """A sentence where a few rows lie far outside the rest, as codes of missing values do; else nothing."""
    low, high = np.quantile(values, [0.2, 0.8])
    rows = np.flatnonzero((values < low - FAR * (high - low)) | (values > high + FAR * (high - low)))
    codes = MISSING.issuperset(values[rows].tolist())
    if not (high > low and 0 < len(rows) <= MAX_MISSING * len(values) and (unusual or codes)):
        return ""
    kept = np.delete(values, rows)
    held = ", ".join(f"{value:g}" for value in np.unique(values[rows])[:3])
    return (
        f"column {name} runs from {kept.min():.4g} to {kept.max():.4g} {split_column(name)[1].symbol}, and "
        f"{len(rows)} {'row holds' if len(rows) == 1 else 'rows hold'} {held}, as where nothing was measured "
        f"({rows_text(rows)}); remove {'it' if len(rows) == 1 else 'them'}"
    )


def _ends_as_radians(size: float, rows: int) -> bool:
    """True where the largest angle lies just below a quarter, a half or a whole turn in radians."""
    reach = min(5 / rows, 0.03)
    return any(turn * (1 - reach) <= size <= turn * 1.001 for turn in _HALF_TURNS)


def _instead(name: str, quantity: str, named: Unit, size: float, usual: UsualSize) -> str:
    """Units in which the numbers would be usual, nearest in size first."""
    fitting = [
        one
        for one in UNITS.values()
        if one.si == named.si and one != named and usual.smallest <= one.to_si(size) <= usual.largest
    ]
    if not fitting:
        return "; check the unit and the numbers"
    likely = min(fitting, key=lambda one: abs(math.log(one.factor / named.factor)))
    return f"; it may be in {likely.symbol}: if so, say --rename {name}={quantity}_{likely.symbol}"


def mending_options(bare: Sequence[str]) -> list[str]:
    """Options of the import that give columns without a unit one, guessed from the name where that tells."""
    return [f"{name}={guessed_unit(name) or 'UNIT'}" for name in bare]
