"""The packed training set: prepared frames of a run in one array on disk, larger than memory if need be."""

from __future__ import annotations

import copy
import json
import os
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pandas as pd

from palpate.core import (
    Images,
    Indices,
    InputError,
    Lens,
    PathText,
    RecordingError,
    new_folder,
    sha256_of,
    storage_errors,
)
from palpate.core.parsing import parser
from palpate.recordings.label_tables import read_table, write_table
from palpate.recordings.preparation import Preparation
from palpate.recordings.run_reader import Run
from palpate.version import __version__

FRAMES_NAME = "frames.npy"
INDEX_NAME, FORMER_INDEX_NAME = "index.csv.gz", "index.parquet"
CARD_NAME = "card.json"
_FORMAT = "palpate-packed-1"
# With a colon, so that no label of a run takes their place.
_NAME, _TIME = "frame:name", "frame:time_s"


class PackedSet:
    """Prepared frames on disk, read by row, with their labels.

    A read takes the memory of the requested rows only. Threads and processes may share it.

    Attributes:
        table: One row a frame: labels, ``frame`` (name), and ``time_s``, unless labels have these names.
        times_s: Frame times on the run's clock [s].
        preparation: Preparation of the frames.
        run_hash, run_id: Source run.
        units: Unit symbol of each label that has one.
    """

    def __init__(self, folder: Path, card: dict[str, Any], index: pd.DataFrame, offset: int) -> None:
        self.folder = folder
        self.names: list[str] = [str(name) for name in index[_NAME]]
        self.times_s: np.ndarray = index[_TIME].to_numpy(dtype=np.float64)
        self.table = _table(index)
        self.preparation = _preparation(card["preparation"])
        self.run_hash = str(card["run_hash"])
        self.run_id = str(card["run_id"])
        self.units: dict[str, str] = {str(k): str(v) for k, v in card["units"].items()}
        self._whole: PackedSet | None = None
        self._places: Indices = np.arange(len(self.names))
        self._offset = offset
        self._handle = os.open(folder / FRAMES_NAME, os.O_RDONLY)
        weakref.finalize(self, os.close, self._handle)

    @classmethod
    @parser("packed set", RecordingError)
    def open(cls, folder: PathText, verify: bool = False) -> PackedSet:
        """Open a packed set.

        Args:
            folder: where `pack` put it.
            verify: also compute the checksums of its arrays and compare them with the card's.
        """
        folder = Path(folder)
        card = _read_card(folder)
        with storage_errors(folder):
            try:
                name = INDEX_NAME if INDEX_NAME in card["sha256"] else FORMER_INDEX_NAME
                (folder / name).stat()  # raises FileNotFoundError, which a parser converts
                index = read_table(folder / name)
                packed = cls(folder, card, index, _check_frames(folder / FRAMES_NAME, len(index), card))
            except (ValueError, KeyError, TypeError, AttributeError, FileNotFoundError) as e:
                raise RecordingError(
                    f"packed set {folder} is damaged ({e}); {_REMEDY}", code="packed-damaged"
                ) from e
        for part in (FRAMES_NAME, name) if verify else ():
            if sha256_of(folder / part) != card["sha256"].get(part):
                raise RecordingError(f"{folder / part} is not what its card says, by checksum; {_REMEDY}")
        return packed

    def __len__(self) -> int:
        return len(self.names)

    def only(self, rows: Indices) -> PackedSet:
        """The same set with some of its rows, numbered anew from 0; nothing is copied.

        Args:
            rows: which, counted from 0.
        """
        part = copy.copy(self)
        part._whole = self  # whose end closes the file
        part._places = self._places[rows]
        part.names = [self.names[row] for row in rows]
        part.times_s = self.times_s[rows]
        part.table = self.table.iloc[rows].reset_index(drop=True)
        return part

    @property
    def shape(self) -> tuple[int, int, int]:
        """Height, width and channels of every frame."""
        return (*self.preparation.size_px, self.preparation.channels)

    def read(self, rows: Sequence[int] | Indices) -> Images:
        """Read some frames, in the order asked for.

        Args:
            rows: which, counted from 0; a row may stand there twice.

        Returns:
            8-bit ``[n h w c]``.
        """
        wanted = np.asarray(rows, dtype=np.int64).reshape(-1)
        if wanted.size and (wanted.min() < 0 or wanted.max() >= len(self)):
            raise InputError(
                f"rows {wanted.min()} to {wanted.max()} asked for; the set has rows 0 to {len(self) - 1}",
                code="index-range",
            )
        out = np.empty((len(wanted), *self.shape), dtype=np.uint8)
        size, handle = int(np.prod(self.shape)), self._handle
        offsets = (self._offset + self._places[wanted] * size).tolist()
        for part, offset in zip(out.reshape(len(wanted), size), offsets, strict=True):
            count = os.preadv(handle, (part.data,), offset)
            if count < size:
                self._fill(part.data[count:], offset + count)
        return out

    def batches(self, rows: Sequence[int] | Indices, size: int) -> Iterator[Images]:
        """Read some frames, at most `size` at a time."""
        if size < 1:
            raise InputError(f"batches of {size} frames: a batch has at least 1")
        for start in range(0, len(rows), size):
            yield self.read(rows[start : start + size])

    def _fill(self, view: memoryview, offset: int) -> None:
        """Go on where one read gave less than was asked for."""
        done = 0
        while done < len(view):
            count = os.preadv(self._handle, [view[done:]], offset + done)
            if count == 0:
                raise RecordingError(
                    f"{self.folder / FRAMES_NAME} was cut while in use; {_REMEDY}", code="file-truncated"
                )
            done += count


_REMEDY = "pack the run again into a new folder"


def pack(
    run: Run, folder: PathText, preparation: Preparation, progress: Callable[[int, int], None] | None = None
) -> PackedSet:
    """Prepare every frame of a run and write them as one array into a new folder.

    The folder holds ``frames.npy`` (8-bit ``[n h w c]``), ``index.csv.gz`` (names, times, labels), and
    ``card.json`` (source, preparation, checksums).
    """
    if len(run) == 0:
        raise RecordingError(f"run {run.manifest.run_id} has no frames, so there is nothing to pack")
    folder = Path(folder)
    with new_folder(folder) as building:
        with (building / FRAMES_NAME).open("wb") as file:
            names = _write_frames(file, run, preparation, progress)
        write_table(_index(run, names), building / INDEX_NAME)
        sums = {name: sha256_of(building / name) for name in (FRAMES_NAME, INDEX_NAME)}
        (building / CARD_NAME).write_text(_card_text(run, preparation, sums), encoding="utf-8")
    return PackedSet.open(folder)


def _write_frames(
    file: BinaryIO, run: Run, preparation: Preparation, progress: Callable[[int, int], None] | None
) -> list[str]:
    """Names of the frames, once they are written."""
    shape = (len(run), *preparation.size_px, preparation.channels)
    np.lib.format.write_array_header_1_0(file, {"descr": "|u1", "fortran_order": False, "shape": shape})
    names = []
    for i in range(len(run)):
        frame = run.frame(i)
        file.write(preparation.apply(frame.image).tobytes())
        names.append(frame.name or str(i))
        if progress is not None:
            progress(i + 1, len(run))
    return names


def _index(run: Run, names: Sequence[str]) -> pd.DataFrame:
    labels = run.labels.reset_index(drop=True)
    own = pd.DataFrame({_NAME: pd.Series(names, dtype=str), _TIME: np.asarray(run.times_s, dtype=np.float64)})
    return pd.concat([own, labels], axis=1)


def _table(index: pd.DataFrame) -> pd.DataFrame:
    renamed = index.rename(columns={_NAME: "frame", _TIME: "time_s"})
    return pd.DataFrame(renamed.loc[:, ~renamed.columns.duplicated(keep="last")])


def _card_text(run: Run, preparation: Preparation, sums: dict[str, str]) -> str:
    card = {
        "format": _FORMAT,
        "software": f"palpate {__version__}",
        "run_id": run.manifest.run_id,
        "run_hash": run.hash,
        "frames": len(run),
        "preparation": _preparation_card(preparation),
        "labels": dict(run.manifest.labels),
        "units": dict(run.manifest.units),
        "sha256": sums,
    }
    return json.dumps(card, indent=2, allow_nan=False)


def _read_card(folder: Path) -> dict[str, Any]:
    path = folder / CARD_NAME
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as e:
        raise RecordingError(
            f"{folder} is no packed set: its card cannot be read ({e}); {_REMEDY}", code="not-a-packed-set"
        ) from e
    if not isinstance(card, dict) or card.get("format") != _FORMAT:
        raise RecordingError(f"{path} is no card of a {_FORMAT} set; {_REMEDY}", code="packed-card")
    return card


def _preparation(card: dict[str, Any]) -> Preparation:
    crop, beside = (None if box is None else tuple(box) for box in (card["crop_px"], card.get("beside_px")))
    height, width = card["size_px"]
    lens = None if card.get("lens") is None else Lens.from_card(card["lens"])
    return Preparation(crop, (height, width), card["channels"], beside, lens)


def _preparation_card(preparation: Preparation) -> dict[str, Any]:
    card = asdict(replace(preparation, lens=None))
    del card["lens"]
    return card if preparation.lens is None else card | {"lens": preparation.lens.card()}


def _check_frames(path: Path, rows: int, card: dict[str, Any]) -> int:
    """Offset of the array in its file, once header, card, index and size agree."""
    with path.open("rb") as file:
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError(f"{path.name} is of an unknown version")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        offset = file.tell()
    preparation = _preparation(card["preparation"])
    shape_by_card = (rows, *preparation.size_px, preparation.channels)
    if (shape, fortran, dtype) != (shape_by_card, False, np.dtype(np.uint8)):
        raise ValueError(f"{path.name} holds {dtype} {shape}, not what card and index say")
    size, expected = path.stat().st_size, offset + int(np.prod(shape))
    if size != expected:
        raise ValueError(f"{path.name} has {size} bytes where {expected} belong")
    if card["frames"] != rows:
        raise ValueError(f"the index has {rows} rows where the card says {card['frames']}")
    return offset
