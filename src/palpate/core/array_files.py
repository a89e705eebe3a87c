"""Arrays in ``.npz`` archives, whose sizes are checked before anything is unpacked."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core.errors import InputError

MAX_ARRAY_BYTES = 256 << 20  # of an archive of arrays, unpacked
MAX_ARRAYS = 1000  # in one archive
CHUNK_BYTES = 16 << 20


def read_arrays(path: Path, *, max_bytes: int = MAX_ARRAY_BYTES) -> dict[str, np.ndarray]:
    """Read the arrays of an ``.npz`` archive whose sizes are checked before anything is unpacked.

    Args:
        path: archive as `numpy.savez` writes it.
        max_bytes: most that the arrays may take together.

    Returns:
        Arrays by name.
    """
    with path.open("rb") as file, zipfile.ZipFile(file) as archive:
        return arrays_of(archive, str(path), max_bytes)


def arrays_of(
    archive: zipfile.ZipFile, source: str, max_bytes: int = MAX_ARRAY_BYTES
) -> dict[str, np.ndarray]:
    """Read the arrays of an open archive, see `read_arrays`."""
    members = archive.infolist()
    total = sum(member.file_size for member in members)
    if total > max_bytes or len(members) > MAX_ARRAYS:
        raise InputError(
            f"{source} unpacks to {total} bytes in {len(members)} arrays. The limits are {max_bytes} bytes "
            f"and {MAX_ARRAYS} arrays.",
            code="file-size",
        )
    arrays: dict[str, np.ndarray] = {}
    for member in members:
        name = member.filename.removesuffix(".npy")
        if name in arrays:
            raise InputError(f"{source} holds two arrays named {name[:60]!r}.", code="file-damaged")
        with archive.open(member) as file:
            arrays[name] = _array(file, member.file_size, f"{source}, array {name[:60]!r}")
    return arrays


def _array(file: Any, size: int, source: str) -> np.ndarray:
    version = np.lib.format.read_magic(file)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
    shape, by_columns, dtype = read(file)
    count = math.prod(shape)
    if dtype.hasobject or min(shape, default=0) < 0 or count * dtype.itemsize != size - file.tell():
        raise InputError(
            f"{source} holds objects, or other bytes than its header states.", code="file-damaged"
        )
    array = np.empty(count, dtype)
    data = array.view(np.uint8).data if array.nbytes else memoryview(b"")
    at = 0
    while at < len(data):
        part = file.read(min(CHUNK_BYTES, len(data) - at))
        if not part:
            raise InputError(f"{source} is truncated.", code="file-damaged")
        data[at : at + len(part)] = part
        at += len(part)
    return array.reshape(shape, order="F" if by_columns else "C")
