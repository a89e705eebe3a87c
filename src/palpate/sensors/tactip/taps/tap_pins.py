"""Identify the pins of separate taps, each from its own image.

Each pin is named by its lattice cell (`estimators.lattice.ring_layout`), counted from the field's middle; a
tip rotated by 30 degrees or more would be misidentified.
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
from palpate.estimators.lattice.ring_layout import PinLattice, PinLayoutKind, name_pins
from palpate.recordings.exchange.image_files import opencv_image

Spots = Float[ndarray, "_ 2"]  # number varies by image
Layout = Float[ndarray, "p 2"]
Cell = tuple[int, int]

MIN_AREA, MAX_AREA = 0.4, 1.9  # area limits over the median spot's
SPECK_PX = 20.0  # minimum area of a spot [px^2], so that many specks cannot set the median
ROUND = 0.55  # minimum filled fraction of a spot's box; a disc has 0.79
MIN_SHARE = 0.95  # minimum fraction of identified pins of a tap
KIND_BY = 9  # taps that determine the lattice kind


@dataclass(frozen=True)
class NamedPins:
    """Pin layout of a tip.

    Attributes:
        size: Height and width of the images [px].
        cells: Lattice cells of the pins in their order.
    """

    size: tuple[int, int]
    kind: PinLayoutKind
    cells: tuple[Cell, ...]


@parser("tap image", ImageError, max_bytes=1 << 30)
def read_image(path: Path) -> UInt8[ndarray, "h w"]:
    """Read an image file as 8-bit grey."""
    image = None
    if path.is_file():
        with storage_errors(path):
            data = np.frombuffer(path.read_bytes(), np.uint8)
        image = opencv_image(data, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ImageError(f"{path} cannot be read as an image", code="image-unreadable")
    return np.asarray(image, np.uint8)


def spots(image: UInt8[ndarray, "h w"]) -> Spots:
    """Return centres (x, y) of the round bright spots of similar size in a binarised image [px]."""
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
    """Return the most common lattice kind of a few taps' spots."""
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
    """Return the cells seen in more than half of the taps, in order."""
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
    """Return the pins of one tap in the order of their cells [px]; NaN for missing ones."""
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
    """Return pin positions of many taps and their layout; taps with under 95 % of the pins are NaN.

    Args:
        found: Spots of every tap [px].
        size: Height and width of the images [px].
        pins: Number of pins.
        progress: Callback for identified taps.
        layout: Known pin layout.
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
