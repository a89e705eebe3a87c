"""Pins of separate taps of a TacTip given their names, each tap by its own image alone.

Taps are no sequence, so that no pin can be followed, and a pose to be read is not known before. But pins
stand on a lattice, in rings or hexagonal, and a touch bends it without tearing it: each is named by its cell
(`estimators.lattice.pin_lattice`). Cells are counted from the field's middle and along the image, so that a
tip turned by 30 degrees or more would take others' names.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from palpate.core import Float, ImageError, InputError, Progress, UInt8, ndarray, silent, storage_errors
from palpate.core.parsing import parser
from palpate.estimators.lattice.pin_lattice import PinLattice, PinLayoutKind, name_pins
from palpate.recordings.exchange.image_files import opencv_image

Spots = Float[ndarray, "_ 2"]  # as many as each image has
Layout = Float[ndarray, "p 2"]
Cell = tuple[int, int]

MIN_AREA, MAX_AREA = 0.4, 1.9  # of the median spot's: smaller are specks, larger run together
SPECK_PX = 20.0  # spots below this area never count, so that a thousand specks cannot be the median [px^2]
ROUND = 0.55  # least share of its box that a spot fills; a disc fills 0.79
MIN_SHARE = 0.95  # of pins that a well-named tap has
KIND_BY = 9  # taps that say what kind the layout is


@dataclass(frozen=True)
class NamedPins:
    """How the pins of a tip stand, by which they are named in an image.

    Attributes:
        size: height and width of the images [px].
        kind: of the lattice.
        cells: of the pins in it, in their order.
    """

    size: tuple[int, int]
    kind: PinLayoutKind
    cells: tuple[Cell, ...]


@parser("tap image", ImageError, max_bytes=1 << 30)
def read_image(path: Path) -> UInt8[ndarray, "h w"]:
    """An image of a file, 8-bit grey."""
    image = None
    if path.is_file():
        with storage_errors(path):
            data = np.frombuffer(path.read_bytes(), np.uint8)
        image = opencv_image(data, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ImageError(f"{path} cannot be read as an image", code="image-unreadable")
    return np.asarray(image, np.uint8)


def spots(image: UInt8[ndarray, "h w"]) -> Spots:
    """Centres (x, y) of the round bright spots of one size in a binarised image [px]."""
    _, _, stats, centres = cv2.connectedComponentsWithStats((image > 127).astype(np.uint8), connectivity=4)
    box = np.asarray(stats[1:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]], np.float64)
    area, at = np.asarray(stats[1:, cv2.CC_STAT_AREA], np.float64), np.asarray(centres[1:], np.float64)
    large = area > SPECK_PX
    if not large.any():
        return np.zeros((0, 2))
    usual = np.median(area[large])
    fits = large & (area > MIN_AREA * usual) & (area < MAX_AREA * usual)
    return at[fits & (area > ROUND * box.prod(axis=1)) & (box.max(axis=1) < 1.8 * box.min(axis=1))]


def layout_kind(found: Sequence[Spots], size: tuple[int, int]) -> PinLayoutKind:
    """What kind of lattice most of a few taps' spots stand on."""
    some = np.linspace(0, len(found) - 1, min(KIND_BY, len(found))).astype(int)
    named = [name_pins(found[i], size) for i in dict.fromkeys(some.tolist())]
    kinds = Counter(each.kind for each in named if each is not None)
    if not kinds:
        raise InputError(
            f"in none of {len(named)} taps bright spots stand on a lattice, in rings, hexagonal or square; "
            "give binarised images with bright pins",
            code="no-lattice",
        )
    return kinds.most_common(1)[0][0]


def pin_cells(named: Iterable[PinLattice | None], pins: int) -> list[Cell]:
    """Cells of a tip's pins: those that are there in more than half of its taps, in order."""
    there = [each for each in named if each is not None]
    seen = Counter(cell for each in there for cell in map(tuple, each.cells.tolist()))
    cells = sorted(cell for cell, count in seen.items() if 2 * count > len(there))
    if len(cells) != pins:
        raise InputError(
            f"{len(there)} taps show a lattice of {len(cells)} pins, for {pins}; give the number of pins "
            "that the tip has, and binarised images with bright pins",
            code="pin-count",
        )
    return cells


def placed(spots_px: Spots, lattice: PinLattice | None, cells: Sequence[Cell]) -> Layout:
    """Places of the pins of one tap in the order of their cells [px]; NaN for those not found."""
    places = np.full((len(cells), 2), np.nan)
    if lattice is not None:
        order = {cell: i for i, cell in enumerate(cells)}
        for cell, mark in zip(map(tuple, lattice.cells.tolist()), lattice.marks, strict=True):
            if cell in order:
                places[order[cell]] = spots_px[mark]
    return places


def named_taps(
    found: Sequence[Float[ndarray, "_ 2"]],
    size: tuple[int, int],
    pins: int,
    progress: Progress = silent,
    layout: NamedPins | None = None,
) -> tuple[Float[ndarray, "t p 2"], NamedPins]:
    """Places of the pins of many taps, and the layout by which they were named.

    A tap of which fewer than 95 % of the pins were found is all NaN: one that lost a border may be counted
    from another middle.

    Args:
        found: spots of every tap [px].
        size: height and width of the images [px].
        pins: how many the tip has.
        progress: called with how many taps are named.
        layout: of the tip's pins, where it is known.
    """
    if layout is not None and layout.size != size:
        raise ImageError(
            f"images of {size[1]} x {size[0]} px; this tip's have {layout.size[1]} x {layout.size[0]}"
        )
    kind = layout_kind(found, size) if layout is None else layout.kind
    named = []
    for i, spots_px in enumerate(found):
        named.append(name_pins(spots_px, size, kind))
        progress("naming pins", i + 1, len(found))
    if layout is None:
        layout = NamedPins(size, kind, tuple(pin_cells(named, pins)))
    places = np.stack([placed(*each, layout.cells) for each in zip(found, named, strict=True)])
    places[np.isfinite(places[..., 0]).mean(axis=1) < MIN_SHARE] = np.nan
    return places, layout
