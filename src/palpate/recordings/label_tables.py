"""Labels of frames: tables of text or Parquet, kinds of columns, targets as numbers with units.

Tables on disk that read back to the last bit: CSV packed by gzip, and Parquet as it was written before.

Every text stands in double quotes and nothing else does, so that ``"007"`` stays a text and ``7.0`` a
number. A number has as many digits as tell it from its neighbours (Python's ``repr``), a flag is ``true`` or
``false``, and a cell that is not known is empty. Any reader of CSV opens it once unpacked, and some as it is.
"""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pandas.api.types import is_bool_dtype, is_numeric_dtype

from palpate.core import InputError, LabelError, PathText, UnitError, Values, split_column, storage_errors
from palpate.core.optional_imports import require
from palpate.core.parsing import parser
from palpate.recordings.manifest import LabelKind

MAX_TABLE_BYTES = 1 << 30
"""Of a table, unpacked; a file that unpacks to more is refused before it takes the memory."""

_CELL = re.compile(r'("(?:[^"]|"")*"|[^",\n]*)([,\n])')
_OPTIONAL_FLAGS = {"true": True, "false": False, "": None}
_PARQUET = b"PAR1"


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table of numbers, texts and flags; the same table gives the same bytes.

    Args:
        table: columns of numbers, texts or flags; its index is not kept.
        path: the file to write, by custom ``.csv.gz``.
    """
    columns = [[_cell(value) for value in table[name].tolist()] for name in table.columns]
    with (
        path.open("wb") as file,
        gzip.GzipFile("", "wb", 6, file, mtime=0) as packed,
    ):
        packed.write(_line([_cell(str(name)) for name in table.columns]))
        packed.writelines(map(_line, zip(*columns, strict=True)))


@parser("stored table", InputError, max_bytes=MAX_TABLE_BYTES)
def read_table(path: Path) -> pd.DataFrame:
    """Read what `write_table` wrote, or a Parquet file; which of the two is told by content."""
    data = path.read_bytes()
    try:
        if data.startswith(_PARQUET):
            pyarrow_for(path)
            return pd.read_parquet(path)
        return _table(_unpacked(data).decode("utf-8"))
    except (ValueError, zlib.error) as e:
        raise InputError(
            f"{path} cannot be read as a table ({e}); restore it", code="table-unreadable"
        ) from e


def pyarrow_for(path: Path) -> Any:
    """The package that reads Parquet, for a file that needs it."""
    require("pyarrow.parquet", f"The Parquet file {path}")
    return require("pyarrow", f"The Parquet file {path}")


def _cell(value: object) -> str:
    match value:
        case None:
            return ""
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value)
        case str():
            return '"' + value.replace('"', '""') + '"'
    raise InputError(f"a table holds numbers, texts and flags, not {value!r:.80}", code="cell-kind")


def _line(cells: list[str] | tuple[str, ...]) -> bytes:
    return f"{','.join(cells)}\n".encode()


def _unpacked(data: bytes) -> bytes:
    unpacker = zlib.decompressobj(31)  # gzip's own header and checksum
    text = unpacker.decompress(data, MAX_TABLE_BYTES)
    if not unpacker.eof:
        raise ValueError(f"it is cut short, or unpacks to more than {MAX_TABLE_BYTES} bytes")
    return text


def _table(text: str) -> pd.DataFrame:
    cells, ends, read = [], [], 0
    for cell in _CELL.finditer(text):
        if cell.start() != read:
            break
        cells.append(cell[1])
        ends.append(cell[2])
        read = cell.end()
    if read != len(text) or "\n" not in ends:
        raise ValueError(f"it is damaged at character {read}")
    count = ends.index("\n") + 1
    if len(ends) % count or ends != ([","] * (count - 1) + ["\n"]) * (len(ends) // count):
        raise ValueError(f"a row has not the {count} cells of the header")
    return pd.DataFrame({_text(cells[i]): _column(cells[count + i :: count]) for i in range(count)})


def _text(cell: str) -> str:
    return cell[1:-1].replace('""', '"')


def _column(cells: list[str]) -> pd.Series[Any]:
    if any(cell.startswith('"') for cell in cells):
        return pd.Series([_text(cell) if cell.startswith('"') else None for cell in cells], dtype=str)
    if all(cell in _OPTIONAL_FLAGS for cell in cells):
        return pd.Series([_OPTIONAL_FLAGS[cell] for cell in cells], dtype=object if "" in cells else bool)
    if all(cell.removeprefix("-").isdecimal() for cell in cells):
        return pd.Series([int(cell) for cell in cells])
    return pd.Series([float(cell) for cell in cells])


Label = float | str | bool
Decimal = Literal["auto", "point", "comma"]


def finite(values: Sequence[float] | np.ndarray, count: int, what: str) -> list[float]:
    """Convert so many finite numbers to plain floats."""
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise InputError(f"{what} takes {count} finite numbers, got {values!r:.200}", code="finite-numbers")
    return [float(value) for value in array]


def label_values(labels: Mapping[str, object], kinds: Mapping[str, LabelKind]) -> dict[str, Label]:
    """Labels as plain numbers, texts and flags."""
    return {name: _value(name, value, kinds) for name, value in labels.items()}


def _value(name: str, value: object, kinds: Mapping[str, LabelKind]) -> Label:
    if name not in kinds:
        raise LabelError(
            f"label column {name!r} is not in the run's manifest, which lists {', '.join(kinds) or 'none'}; "
            "name every column when the manifest is made",
            code="label-unknown",
        )
    match kinds[name]:
        case "flag" if isinstance(value, bool | np.bool_):
            return bool(value)
        case "text" if isinstance(value, str):
            return str(value)
        case "number" if _is_finite_number(value):
            return float(value)  # type: ignore[arg-type]
    raise LabelError(
        f"label {name!r} is a {kinds[name]} by the manifest, got {value!r:.80}; numbers are finite, and a "
        "label that is not known is left out",
        code="label-kind",
    )


def _is_finite_number(value: object) -> bool:
    if isinstance(value, Integral):
        return not isinstance(value, bool)
    return isinstance(value, Real) and math.isfinite(value)


FIRST_ROW = 2  # as a person counts in a spreadsheet: the header is row 1
_SHOWN = 5
MAX_LABEL_BYTES = 256 << 20  # of a file
MAX_CELLS = 20_000_000  # of a table whose encoding can state cells without storing them
_FLAGS = {"true": True, "false": False}


@parser("table of labels", LabelError, max_bytes=MAX_LABEL_BYTES)
def read_labels(
    path: PathText,
    *,
    kinds: Mapping[str, LabelKind] | None = None,
    names: Sequence[str] = (),
    decimal: Decimal = "auto",
) -> pd.DataFrame:
    """Read a table of labels, one row an image, in file order.

    A column is ``flag`` if all cells are true or false, ``number`` if all are numbers or empty (NaN), else
    ``text``.

    Args:
        path: UTF-8 file with a header and separated by commas, semicolons, or tabs; or Parquet, by content.
        kinds: Kinds of columns that must not be guessed, such as a text column with ``007``.
        names: Column names of a file without a header, which may also be separated by spaces.
        decimal: Decimal mark. ``auto`` accepts commas unless they could separate thousands.
    """
    path = Path(path)
    if not path.is_file():
        raise LabelError(f"table of labels {path} is not there (or no plain file); check the name")
    with storage_errors(path):
        data = path.read_bytes()
    if not data.strip():
        raise LabelError(
            f"{path} is empty; a table of labels has a header and one row an image", code="table-empty"
        )
    if data.startswith(b"PAR1"):
        columns = _parquet_columns(path, data)
    else:
        columns = _text_columns(path, _decoded(path, data), kinds or {}, tuple(names), decimal)
    table = pd.DataFrame(columns)
    if table.empty:
        raise LabelError(f"{path} has a header and no rows; a table of labels has one row an image")
    refuse_formulas(table, path)
    return table


def label_kinds(table: pd.DataFrame) -> dict[str, LabelKind]:
    """The kind of every column: ``number``, ``text`` or ``flag``."""
    return {str(name): _kind(table[name]) for name in table.columns}


def targets_from(
    table: pd.DataFrame, columns: Sequence[str], source: str, *, constant: bool = False
) -> Values:
    """Return target columns of a label table ``[n t]``, each in the unit of its name.

    Args:
        columns: Target columns in the desired order.
        source: Origin of the table, for messages.
        constant: Accept columns with a single value, as for scoring.
    """
    twice = [name for name, count in Counter(columns).items() if count > 1]
    if twice or not columns:
        raise LabelError(f"targets {list(columns)}: name at least one column, and each once")
    return np.column_stack([_target(table, name, source, constant) for name in columns])


OWN = "own:"
RESERVED = (
    OWN, "estimate:", "half_width:", "low:", "high:", "joint_half_width:", "frame:", "set:", "output:",
)  # fmt: skip
"""Prefixes of columns that the code adds to a table of labels; no label may begin so."""


def with_own(table: pd.DataFrame, columns: Mapping[str, Sequence[Any] | np.ndarray]) -> pd.DataFrame:
    """Add columns of the code's own to a table of labels, without taking a label's place.

    Args:
        columns: values of each. It is added as ``own:NAME``, and as ``NAME`` where no label has that name.
    """
    own = {f"{OWN}{name}": values for name, values in columns.items()}
    short = {name: values for name, values in columns.items() if name not in table.columns}
    return table.assign(**own, **short)


def own_column(table: pd.DataFrame, name: str) -> pd.Series[Any]:
    """A column that `with_own` added; in tables from before it did, the one of its short name."""
    return table[f"{OWN}{name}" if f"{OWN}{name}" in table.columns else name]


def refuse_reserved(names: Sequence[str], source: str) -> None:
    """Raise if a label's name begins as the code's own columns do."""
    for name in names:
        if name.startswith(RESERVED):
            raise LabelError(
                f"{source}: label column {name!r} begins with {name.partition(':')[0]}:, as columns do that "
                "a calibration adds; rename it"
            )


def names_text(names: Iterable[Any], most: int = 10) -> str:
    """Names for a message, the first ones where they are many.

    Example:
        >>> names_text("abcd", most=2)
        'a, b and 2 more'
    """
    every = [str(name) for name in names]
    return ", ".join(every[:most]) + (f" and {len(every) - most} more" if len(every) > most else "")


def rows_text(positions: np.ndarray | Sequence[int]) -> str:
    """Name rows as a person counts them: ``row 2`` or ``rows 2, 3, 7 and 12 more``."""
    rows = [int(i) + FIRST_ROW for i in positions]
    shown = ", ".join(str(row) for row in rows[:_SHOWN])
    more = f" and {len(rows) - _SHOWN} more" if len(rows) > _SHOWN else ""
    return f"row{'s' if len(rows) > 1 else ''} {shown}{more}"


def refuse_formulas(table: pd.DataFrame, path: Path) -> None:
    """Raise if a name or a text cell begins as a formula does, which a spreadsheet would run."""
    for name in table.columns:
        if _is_formula(str(name)):
            raise LabelError(f"{path}, row 1: column name {name!r} begins as a formula does; rename it")
        if _kind(table[name]) != "text":
            continue
        for i, cell in enumerate(table[name]):
            if _is_formula(str(cell)):
                raise LabelError(
                    f"{path}, row {i + FIRST_ROW}: column {name!r} holds {str(cell)[:40]!r}, which a "
                    "spreadsheet would run as a formula; write the value itself",
                    code="spreadsheet-formula",
                )


def _is_formula(cell: str) -> bool:
    if cell.startswith(("=", "@", "\t", "\r")):
        return True
    return len(cell) > 1 and cell[0] in "+-" and not _is_number(cell)


def _target(table: pd.DataFrame, name: str, source: str, constant: bool) -> np.ndarray:
    if name not in table.columns:
        numbers = [c for c, kind in label_kinds(table).items() if kind == "number"]
        raise LabelError(f"{source} has no column {name!r}; its columns of numbers are {', '.join(numbers)}")
    try:
        split_column(name)
    except UnitError as e:
        raise UnitError(f"{source}: {e}; `palpate import images` gives it one: --unit {name}=mm") from e
    column = table[name]
    if _kind(column) != "number":
        odd = [i for i, cell in enumerate(column) if not _is_number(str(cell))]
        cell = f", e.g. {str(column.iloc[odd[0]])[:40]!r} in row {odd[0] + FIRST_ROW}" if odd else ""
        raise LabelError(
            f"{source}: target {name!r} holds {_kind(column)} values{cell}; a target is all numbers"
        )
    values = column.to_numpy(dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise LabelError(
            f"{source}: target {name!r} holds no finite number in {rows_text(bad)}; "
            "fill these in, or remove the rows and their images",
            code="not-finite",
        )
    if np.ptp(values) == 0 and not constant:
        raise LabelError(
            f"{source}: target {name!r} is {values[0]:g} everywhere: there is nothing to learn from"
        )
    return values


def _kind(column: pd.Series) -> LabelKind:
    known = column.dropna() if column.dtype == object else column
    if is_bool_dtype(column.dtype) or (
        len(known) and all(isinstance(cell, bool | np.bool_) for cell in known)
    ):
        return "flag"
    return "number" if is_numeric_dtype(column.dtype) else "text"


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python reads 1_000, a spreadsheet does not


def _text_columns(
    path: Path, text: str, kinds: Mapping[str, LabelKind], given: tuple[str, ...], decimal: Decimal
) -> dict[str, pd.Series]:
    rows = list(_cells(path, text, _separator(text, len(given))))
    while rows and not rows[-1]:
        rows.pop()
    names = list(given) or [name.strip() for name in rows[0]]
    check_names(path, names)
    for number, row in enumerate(rows, start=1):
        if len(row) != len(names):
            raise LabelError(
                f"{path}, row {number} has {len(row)} cells where {_expected(given, names)}; "
                "add or remove separators, or put a text that holds one in double quotes"
            )
    cells = list(zip(*rows[not given :], strict=True)) or [()] * len(names)
    columns = with_decimal_points(dict(zip(names, cells, strict=True)), str(path), kinds, decimal)
    try:
        return {name: typed_column(cell, kinds.get(name)) for name, cell in columns.items()}
    except (KeyError, ValueError) as e:
        raise LabelError(f"{path}: a cell is not of the kind that its column is said to be ({e})") from e


def _expected(given: tuple[str, ...], names: list[str]) -> str:
    return f"{len(given)} columns are named" if given else f"the header has {len(names)}"


def _separator(text: str, count: int) -> str:
    """The mark that parts the first line into the most cells, or into as many as there are names; a space
    parts only where names are given and no other mark does.
    """
    first = next((line for line in text.splitlines() if line.strip()), "")
    parts = {mark: len(next(csv.reader([first], delimiter=mark), [])) for mark in SEPARATORS}
    if count:
        fitting = [mark for mark, cells in parts.items() if cells == count]
        return fitting[0] if fitting else "," if max(parts.values()) > 1 else " "
    return max(SEPARATORS, key=lambda mark: parts[mark])


SEPARATORS = (",", ";", "\t")


_WITH_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
_WITH_POINT = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?")


def with_decimal_points(
    columns: Mapping[str, Sequence[str]], source: str, kinds: Mapping[str, LabelKind], decimal: Decimal
) -> dict[str, Sequence[str]]:
    """Write numbers with decimal commas as Python does.

    ``1,5`` can only be one and a half; ``1,234`` is a thousand and some in English, and little more than one
    elsewhere. A column of such numbers alone is read as what the file's other numbers are, or refused.
    """
    if decimal == "point":
        return dict(columns)
    commas = [name for name in columns if kinds.get(name) != "text" and _has_decimal_commas(columns[name])]
    sure = [name for name in commas if not all(map(_could_be_thousands, columns[name]))]
    pointed = any(_WITH_POINT.fullmatch(cell) for cells in columns.values() for cell in cells)
    open_ = [name for name in commas if name not in sure and (pointed or not sure)]
    if open_ and decimal == "auto":
        example = next(cell for cell in columns[open_[0]] if "," in cell)
        raise LabelError(
            f"{source}: column {open_[0]!r} holds {example!r}, which is {example.replace(',', '.')} with a "
            f"decimal comma and {example.replace(',', '')} with a comma between thousands; say --decimal "
            "comma, "
            "or write the numbers without commas"
        )
    return {
        name: [cell.replace(",", ".") for cell in cells] if name in commas else cells
        for name, cells in columns.items()
    }


def _has_decimal_commas(cells: Sequence[str]) -> bool:
    numbers = [cell for cell in cells if cell]
    return any("," in cell for cell in numbers) and all(
        _WITH_COMMA.fullmatch(cell) or (_is_number(cell) and "." not in cell) for cell in numbers
    )


def _could_be_thousands(cell: str) -> bool:
    return "," not in cell or bool(_THOUSANDS.fullmatch(cell))


def _decoded(path: Path, data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        row = data.count(b"\n", 0, e.start) + 1
        raise LabelError(f"{path}, row {row} is not UTF-8 text; save the table as 'CSV UTF-8'") from e


def _cells(path: Path, text: str, separator: str) -> Iterator[list[str]]:
    if separator == " ":
        yield from (line.split() for line in text.splitlines())
        return
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator)
    row = 0
    try:
        for row, cells in enumerate(reader, start=1):  # noqa: B007 -- the error below names the row
            yield cells
    except csv.Error as e:
        raise LabelError(f"{path}, row {row + 1} is not separated text ({e}); check its quotes") from e


def check_names(path: Path, names: Sequence[str]) -> None:
    """Raise if a column has no name, or two have one."""
    if "" in names:
        raise LabelError(f"{path}, row 1: column {names.index('') + 1} has no name; name it or delete it")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise LabelError(
            f"{path}, row 1: column {twice[0]!r} stands there more than once; rename or delete one"
        )


def typed_column(cells: Sequence[str], kind: LabelKind | None = None) -> pd.Series:
    """A column of flags, numbers or texts, by its cells or as it is said to be."""
    kind = kind or _guessed(cells)
    if kind == "flag":
        return pd.Series([_FLAGS[cell.lower()] for cell in cells], dtype=bool)
    if kind == "number":
        return pd.Series([float(cell) if cell else np.nan for cell in cells], dtype=np.float64)
    return pd.Series(list(cells), dtype=str)


def _guessed(cells: Sequence[str]) -> LabelKind:
    if all(cell.lower() in _FLAGS for cell in cells):
        return "flag"
    return "number" if all(not cell or _is_number(cell) for cell in cells) else "text"


def _parquet_columns(path: Path, data: bytes) -> dict[str, pd.Series]:
    pa = pyarrow_for(path)
    try:
        opened = pa.parquet.ParquetFile(pa.BufferReader(data))
        _check_cells(opened.metadata, path)
        table = opened.read()
    except (pa.ArrowException, OSError, ValueError) as e:
        raise LabelError(f"{path} begins as Parquet and cannot be read ({e}); write it again") from e
    check_names(path, table.column_names)
    return {name: _arrow_typed(pa, path, name, table.column(name)) for name in table.column_names}


def _check_cells(about: Any, path: Path) -> None:
    groups = [about.row_group(i) for i in range(about.num_row_groups)]
    cells = sum(group.column(j).num_values for group in groups for j in range(group.num_columns))
    unpacked = sum(group.total_byte_size for group in groups)
    if max(cells, about.num_rows * about.num_columns) > MAX_CELLS or unpacked > MAX_LABEL_BYTES:
        raise LabelError(
            f"{path} states {cells} cells in {unpacked} bytes. Up to {MAX_CELLS} cells in {MAX_LABEL_BYTES} "
            "bytes are read.",
            code="table-size",
        )


def _arrow_typed(pa: Any, path: Path, name: str, column: Any) -> pd.Series:
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    cells = column.to_pylist()
    if pa.types.is_boolean(kind) and column.null_count == 0:
        return pd.Series(cells, dtype=bool)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return pd.Series([np.nan if cell is None else float(cell) for cell in cells], dtype=np.float64)
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return pd.Series(["" if cell is None else cell for cell in cells], dtype=str)
    raise LabelError(
        f"{path}: column {name!r} is of type {kind}{' with gaps' if column.null_count else ''}; "
        "labels are numbers, texts, or true and false without gaps"
    )
