"""Tables on disk that read back to the last bit: CSV packed by gzip, and Parquet as it was written before.

Every text stands in double quotes and nothing else does, so that ``"007"`` stays a text and ``7.0`` a
number. A number has as many digits as tell it from its neighbours (Python's ``repr``), a flag is ``true`` or
``false``, and a cell that is not known is empty. Any reader of CSV opens it once unpacked, and some as it is.
"""

from __future__ import annotations

import gzip
import re
import zlib
from pathlib import Path
from typing import Any

import pandas as pd

from palpate.core import InputError
from palpate.core.optional_imports import require
from palpate.core.parsing import parser

MAX_TABLE_BYTES = 1 << 30
"""Of a table, unpacked; a file that unpacks to more is refused before it takes the memory."""

_CELL = re.compile(r'("(?:[^"]|"")*"|[^",\n]*)([,\n])')
_FLAGS = {"true": True, "false": False, "": None}
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
    if all(cell in _FLAGS for cell in cells):
        return pd.Series([_FLAGS[cell] for cell in cells], dtype=object if "" in cells else bool)
    if all(cell.removeprefix("-").isdecimal() for cell in cells):
        return pd.Series([int(cell) for cell in cells])
    return pd.Series([float(cell) for cell in cells])
