"""Calibrations as one file: nested dataclasses as flat plain arrays, without pickles; the id is that of the
contents.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_type_hints
from zipfile import BadZipFile

import numpy as np

from palpate.core import CertificateError, ndarray, new_file, storage_errors
from palpate.core.array_files import MAX_ARRAY_BYTES, read_arrays
from palpate.core.parsing import parser
from palpate.version import __version__

FORMAT = 1
Kept = TypeVar("Kept")


def contents_id(record: Any, kind: str) -> str:
    """Return the name by the contents: the kind, and 12 hexadecimal digits of their SHA-256."""
    digest = hashlib.sha256()
    for name, value in sorted(flat_arrays(record).items()):
        digest.update(name.encode() + np.ascontiguousarray(value).tobytes())
    return f"{kind}-{digest.hexdigest()[:12]}"


def save_record(record: Any, path: Path) -> None:
    """Write one ``.npz``, whole or not at all."""
    with new_file(path) as building, building.open("wb") as file:
        np.savez_compressed(file, **flat_arrays(record), format=np.array(FORMAT))  # type: ignore[arg-type]


@parser("calibration record", CertificateError, max_bytes=MAX_ARRAY_BYTES)
def load_record(kind: type[Kept], path: Path, what: str, maker: str) -> Kept:
    """Read what `save_record` wrote; no code in it is run.

    Args:
        what, maker: kind of calibration, and the command that makes one, for the message.
    """
    try:
        with storage_errors(path):
            data = read_arrays(path)
        if (layout := int(data.pop("format"))) != FORMAT:
            raise CertificateError(
                f"{path} has format {layout}, and palpate {__version__} reads format {FORMAT}: open it "
                "with the version of palpate that wrote it, or calibrate anew"
            )
        record = from_flat_arrays(kind, data)
    except (KeyError, ValueError, TypeError, BadZipFile, EOFError) as e:
        raise CertificateError(
            f"{path} is no calibration of {what}, or a damaged one; `{maker}` makes them"
        ) from e
    assert isinstance(record, kind)
    return record


def flat_arrays(record: Any, prefix: str = "") -> dict[str, ndarray]:
    """Return fields of nested dataclasses under their dotted names, without None."""
    arrays: dict[str, ndarray] = {}
    for field in fields(record):
        value, name = getattr(record, field.name), prefix + field.name
        if is_dataclass(value):
            arrays |= flat_arrays(value, f"{name}.")
        elif value is not None:
            arrays[name] = np.asarray(value)
    return arrays


def from_flat_arrays(kind: type, data: Mapping[str, ndarray], prefix: str = "") -> Any:
    """Restore the dataclass that `flat_arrays` took apart."""
    values: dict[str, Any] = {}
    for name, hint in get_type_hints(kind).items():
        full, (inner, optional) = prefix + name, _plain(hint)
        if optional and not any(key == full or key.startswith(f"{full}.") for key in data):
            values[name] = None
        elif is_dataclass(inner):
            values[name] = from_flat_arrays(inner, data, f"{full}.")  # type: ignore[arg-type]
        else:
            values[name] = _value(data[full], inner)
    return kind(**values)


def _plain(hint: Any) -> tuple[Any, bool]:
    """A type without its None, and whether it had one."""
    if isinstance(hint, UnionType):
        rest = [one for one in get_args(hint) if one is not type(None)]
        return rest[0], len(rest) < len(get_args(hint))
    return hint, False


def _value(value: ndarray, kind: Any) -> Any:
    if kind in (int, float, str):
        return kind(value.item())
    return tuple(value.tolist()) if getattr(kind, "__origin__", None) is tuple else value
