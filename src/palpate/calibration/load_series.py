"""Photographs of one specimen at several loads: the light of some patches, exposure divided out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from PIL.JpegImagePlugin import JpegImageFile

from palpate.core import (
    Bool,
    Float,
    Image,
    ImageError,
    InputError,
    LabelError,
    Progress,
    UInt8,
    Unit,
    UnitError,
    has_unit,
    ndarray,
    split_column,
    unit,
)
from palpate.core.parsing import parser
from palpate.estimators.fringe_order import check_loads
from palpate.optics.colour import Tone, linear_light
from palpate.recordings import read_image, read_labels
from palpate.recordings.label_tables import FIRST_ROW, rows_text

Region = tuple[int, int, int, int]
LOADS = ("load", "force", "normal_force", "mass", "weight")
STANDARD_GRAVITY = unit("kgf").factor  # [m/s^2]
PATCHES = 12
MIN_SIDE = 4  # of a patch [px]
SATURATED = 254  # code from which a channel may hold more light than it says
CLIPPED_SHARE = 0.1  # of a patch's pixels
_EXIF, _SECONDS, _F_NUMBER, _ISO = 0x8769, 33434, 33437, 34855


@dataclass(frozen=True, slots=True)
class Series:
    """Light of a series of photographs.

    Attributes:
        images: names of the photographs, in the table's order.
        paths: their files; the one between parallel polarizers comes last.
        light: median linear light over exposure ``[photograph patch channel]``.
        clipped: more than a tenth of a patch was saturated.
        open_light: photograph between parallel polarizers, or None.
        grey: photographs have one channel (repeated three times in `light`).
        centre_px: (x, y) of each patch's centre [px].
        remarks: assumptions on the exposure, in sentences.
    """

    images: tuple[str, ...]
    paths: tuple[Path, ...]
    load_column: str
    load_n: Float[ndarray, " n"]
    light: Float[ndarray, "n p 3"]
    clipped: Bool[ndarray, "n p 3"]
    open_light: Float[ndarray, "p 3"] | None
    grey: bool
    centre_px: Float[ndarray, "p 2"]
    remarks: tuple[str, ...]


@parser("load series", InputError)
def read_series(
    folder: Path,
    labels: Path,
    region_px: Region,
    image_column: str,
    load_column: str | None,
    parallel: Path | None,
    tone: Tone,
    progress: Progress,
    patches: int = PATCHES,
) -> Series:
    """Read the photographs that a table names; see `fit_stress_optic` for the arguments."""
    source = labels if labels.is_file() else folder / labels
    table = read_labels(source, kinds={image_column: "text"})
    column = load_column or _load_column(table, source)
    load_n = _loads(table, column, source)
    check_loads(load_n)
    names = _names(table, image_column, source)
    paths = [folder / name for name in names] + ([parallel] if parallel is not None else [])
    pixels = []
    for i, path in enumerate(paths):
        progress("reading", i, len(paths))
        pixels.append(_region(_read(path, source, i, len(names)), path, region_px))
    progress("reading", len(paths), len(paths))
    if len({one.ndim for one in pixels}) > 1:
        raise ImageError("some photographs are grey and some in colour; take all alike")
    exposure, remark = _exposures(paths)
    cut = [_patches(one, patches) for one in pixels]
    light = np.stack([_light(p, tone) / e for p, e in zip(cut, exposure, strict=True)])
    clipped = np.stack([[(one >= SATURATED).mean(axis=(0, 1)) > CLIPPED_SHARE for one in p] for p in cut])
    n = len(names)
    if parallel is not None and clipped[n].any():
        raise ImageError(f"{parallel} is saturated in the region; expose it and all the others less")
    over = int(clipped[:n].any(axis=(1, 2)).sum())
    saturated = (f"{over} photograph(s) are saturated in part of the region",) if over else ()
    return Series(
        images=names,
        paths=tuple(paths),
        load_column=column,
        load_n=load_n,
        light=light[:n],
        clipped=clipped[:n],
        open_light=light[n] if parallel is not None else None,
        grey=pixels[0].ndim == 2,
        centre_px=_centres(region_px, patches),
        remarks=(remark, *saturated),
    )


def _load_column(table: pd.DataFrame, source: Path) -> str:
    columns = [c for c in table.columns if has_unit(c) and split_column(c)[0] in LOADS and _newtons(c)]
    if not columns:
        raise LabelError(
            f"{source} has no column of loads; name one load_N, load_kgf or mass_g, or say which it is"
        )
    return min(columns, key=lambda c: (split_column(c)[1].symbol != "N", columns.index(c)))


def _newtons(column: str) -> float:
    """One of a column's unit in N; 0 if it is no force's and no mass's."""
    one: Unit = split_column(column)[1]
    return one.factor * {"N": 1.0, "kg": STANDARD_GRAVITY}.get(one.si, 0.0)


def _column(table: pd.DataFrame, column: str, source: Path) -> pd.Series:
    if column not in table:
        raise LabelError(f"{source} has no column {column!r}; its columns are {', '.join(table.columns)}")
    return table[column]


def _loads(table: pd.DataFrame, column: str, source: Path) -> ndarray:
    loads = _column(table, column, source)
    if not _newtons(column):
        raise UnitError(f"column {column!r} is no load; its name ends in _N, _mN, _kgf, _kg or _g")
    values = pd.to_numeric(loads, errors="coerce").to_numpy(dtype=np.float64)
    bad = np.flatnonzero(~(np.isfinite(values) & (values >= 0)))
    if bad.size:
        raise LabelError(f"{source}: {column!r} holds no load of 0 or more in {rows_text(bad)}")
    return np.asarray(values * _newtons(column))


def _names(table: pd.DataFrame, column: str, source: Path) -> tuple[str, ...]:
    names = tuple(str(name) for name in _column(table, column, source))
    for i, name in enumerate(names):
        if not name or name in names[:i]:
            what = f"{name!r} a second time" if name else "no photograph"
            raise LabelError(f"{source}, row {i + FIRST_ROW} names {what}; each row has its own photograph")
    return names


def _read(path: Path, source: Path, i: int, rows: int) -> Image:
    try:
        return read_image(path)
    except ImageError as e:
        where = f"{source}, row {i + FIRST_ROW}: " if i < rows else ""
        raise ImageError(f"{where}{e}") from e


def _region(image: Image, path: Path, region_px: Region) -> UInt8[ndarray, "high wide *c"]:
    x, y, w, h = region_px
    high, wide = image.shape[:2]
    if min(w, h) < MIN_SIDE:
        raise InputError(f"region of {w} × {h} px is too small; give {MIN_SIDE} × {MIN_SIDE} px or more")
    if x < 0 or y < 0 or x + w > wide or y + h > high:
        raise InputError(
            f"region x {x} to {x + w}, y {y} to {y + h} px leaves {path.name}, which is {wide} × {high} px; "
            "move it or make it smaller"
        )
    return image[y : y + h, x : x + w]


def _grid(w: int, h: int, patches: int) -> tuple[int, int, int, int]:
    """Rows and columns of near-square patches, and their height and width [px]."""
    columns = int(np.clip(round(np.sqrt(patches * w / h)), 1, min(patches, w // MIN_SIDE)))
    rows = int(np.clip(patches // columns, 1, h // MIN_SIDE))
    return rows, columns, h // rows, w // columns


def _centres(region_px: Region, patches: int) -> Float[ndarray, "p 2"]:
    x, y, w, h = region_px
    rows, columns, high, wide = _grid(w, h, patches)
    down, across = np.mgrid[0:rows, 0:columns]
    half = (np.array([wide, high]) - 1) / 2
    return np.stack([x + across * wide, y + down * high], axis=-1).reshape(-1, 2) + half


def _patches(pixels: UInt8[ndarray, "h w *c"], patches: int) -> list[UInt8[ndarray, "_ _ 3"]]:
    h, w = pixels.shape[:2]
    rows, columns, high, wide = _grid(w, h, patches)
    colour = np.dstack([pixels] * 3) if pixels.ndim == 2 else pixels
    return [
        colour[r * high : (r + 1) * high, c * wide : (c + 1) * wide]
        for r in range(rows)
        for c in range(columns)
    ]


def _light(patches: list[UInt8[ndarray, "_ _ 3"]], tone: Tone) -> Float[ndarray, "p 3"]:
    """Median light of each patch, 0 to 1: dust and a scratch do not move a median."""
    return linear_light(np.array([np.median(one, axis=(0, 1)) for one in patches]), tone)


def _exposures(paths: list[Path]) -> tuple[ndarray, str]:
    """Time times sensitivity over the squared aperture, 1 at the greatest, where every file notes them."""
    exposures = [_exposure(path) for path in paths]
    values = np.array([e for e in exposures if e is not None])
    if len(values) < len(paths):
        return np.ones(len(paths)), "not all files note an exposure: all are taken as exposed alike"
    if np.ptp(values) == 0:
        return np.ones(len(paths)), "all files note the same exposure"
    return values / values.max(), (
        f"exposure differs up to {values.max() / values.min():.2g} times between files, and was divided out "
        "by what they note; a fixed exposure is better"
    )


def _exposure(path: Path) -> float | None:
    with path.open("rb") as file:
        if file.read(3) != b"\xff\xd8\xff":
            return None
    with JpegImageFile(path) as image:
        tags = image.getexif().get_ifd(_EXIF)
    try:
        exposure = float(tags[_SECONDS]) * float(tags[_ISO]) / float(tags.get(_F_NUMBER, 1.0)) ** 2
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    return exposure if np.isfinite(exposure) and exposure > 0 else None
