"""Pins distinguished from other bright spots by their lattice, each named by its cell.

Hexagonal lattice and rings about a middle pin (`ring_layout`) are tried, then a square lattice. Cells count
from the middle of the field, so that names do not depend on hidden pins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from palpate.core import Bool, Float, Int, ndarray
from palpate.estimators.lattice.lattice_growth import MIN_MARKS, GrownLattice, grow_lattices
from palpate.estimators.lattice.ring_layout import (
    DIRECTIONS,
    MAX_RINGS,
    SETTLED,
    fill_hexagon,
    lay_rings,
    ring_of,
    ring_sites,
    share_named,
    upright,
)

PinLayoutKind = Literal["hexagonal", "rings", "square"]
MIN_FILLED = 0.9  # ratio of its rings' cells; pins in circular rings leave more empty
MIN_SHARE = 0.65  # with less, marks stand on no lattice
MIN_OF_ALL = 0.45  # ratio of all marks
SHEARED = 1.25  # a square's diagonal is 1.41 of its side
OUTWARDS = (2, 1), (4, 3), (6, 3)  # rings, and the degree of the map that leads there
OFF = 0.2  # of the distance of neighbours, between where a pin is and where the map has it
NEARLY_EMPTY, NEARLY_FULL = 0.15, 0.6  # ratios of a ring's cells
EMPTY_COSTS = 0.5  # of a mark
MIN_NEXT = 3  # neighbours of a pin on the edge of a hexagonal field

Points = Float[ndarray, "n 2"]


@dataclass(frozen=True, eq=False)
class PinLattice:
    """Marks on a pin lattice.

    Attributes:
        cells: (column, row) ``[m 2]``; (0, 0) is the field's middle, axes are 60 degrees apart unless square.
        marks: Index of the mark in each cell ``[m]``.
        pitch: Median distance of neighbors [px].
        share: Ratio of the marks in the field that are named.
    """

    kind: PinLayoutKind
    cells: Int[ndarray, "m 2"]
    marks: Int[ndarray, " m"]
    pitch: float
    share: float

    @property
    def filled(self) -> float:
        """Ratio of the cells of whole rings that are present."""
        rings = int(ring_of(self.cells).max())
        return len(self.cells) / (3 * rings * (rings + 1) + 1)

    @property
    def whole(self) -> bool:
        """Whether all cells of whole rings are present without marks between them."""
        return self.kind != "square" and self.share == self.filled == 1.0

    @property
    def settled(self) -> bool:
        """Whether no other layout needs to be tried."""
        return self.share > SETTLED and (self.kind != "hexagonal" or self.filled > MIN_FILLED)


def name_pins(places: Points, size: tuple[int, int], kind: PinLayoutKind | None = None) -> PinLattice | None:
    """Return the lattice that holds most marks, or None.

    Args:
        places: Marks ``[n 2]`` [px].
        size: Height and width of the image [px].
        kind: Layout, if known.
    """
    whole = _whole(places, "hexagonal") or _whole(places, "rings")
    if whole is not None and kind in (None, whole.kind):
        return whole
    if kind == "rings":
        return _sound(_of("rings", lay_rings(places, size), places), places)
    best = _hexagonal(places, size)
    if kind == "hexagonal":
        return _sound(best, places)
    if best is None or not best.settled:
        best = _better(best, _of("rings", lay_rings(places, size), places))
    if best is None or best.share < MIN_SHARE or _is_sheared(best, places):
        best = _better(_of("square", _largest(places, "square"), places), best)
    return _sound(best, places)


def _sound(found: PinLattice | None, places: Points) -> PinLattice | None:
    sound = found is not None and found.share >= MIN_SHARE and len(found.marks) >= MIN_OF_ALL * len(places)
    return found if sound else None


def _whole(places: Points, kind: Literal["hexagonal", "rings"]) -> PinLattice | None:
    """Quick match of marks that are exactly whole rings about the middle one."""
    rings = round((math.sqrt(12 * max(len(places), 1) - 3) - 3) / 6)
    if not (2 <= rings <= MAX_RINGS and 3 * rings * (rings + 1) + 1 == len(places)):
        return None
    tree, sites = cKDTree(places), ring_sites(kind)
    middle = int(np.argmin(((places - places.mean(axis=0)) ** 2).sum(axis=1)))
    far, near = tree.query(places[middle], k=7)
    angle = np.arctan2(*(places[near[1:]] - places[middle]).T[::-1])
    first = angle[np.argmin(np.abs(angle))]
    marks = np.append(middle, near[1:][np.argsort((angle - first + 0.1) % (2 * np.pi))])
    for lead in _leads(kind, rings):
        off, marks = tree.query(lead @ places[marks])
    if len(np.unique(marks)) < len(places) or off.max() > OFF * far[1]:
        return None
    return PinLattice(kind, upright(sites.cells[: len(marks)], places[marks]), marks, float(far[1]), 1.0)


@cache
def _leads(kind: str, rings: int) -> list[Float[ndarray, "s k"]]:
    """Matrices from the positions of inner rings to those of the next ones, step by step."""
    sites, known, leads = ring_sites(kind), 7, []
    for upto, degree in (*((ring, d) for ring, d in OUTWARDS if ring < rings), (rings, 3), (rings, 5)):
        terms = _terms(sites.places[: sites.upto(upto)], min(degree, rings))
        leads.append(terms @ np.linalg.pinv(terms[:known]))
        known = len(terms)
    return leads


def _terms(plane: Float[ndarray, "s 2"], degree: int) -> Float[ndarray, "s k"]:
    x, y = (plane / MAX_RINGS).T
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)


def _is_sheared(one: PinLattice, places: Points) -> bool:
    """Whether the directions of a hexagonal lattice differ in length as in a square one."""
    design = np.column_stack([np.ones(len(one.cells)), one.cells])
    axes = np.linalg.lstsq(design, places[one.marks], rcond=None)[0][1:]
    long = np.hypot(*np.stack([axes[0], axes[1], axes[0] - axes[1]]).T)
    return bool(long.max() > SHEARED * long.min())


def _better(one: PinLattice | None, other: PinLattice | None) -> PinLattice | None:
    """Lattice with more marks, of those that hold most of the marks among them."""
    sound = [found for found in (one, other) if found is not None]
    return max(sound, key=lambda found: found.share * len(found.marks), default=None)


def _largest(places: Points, kind: str) -> GrownLattice | None:
    grown = grow_lattices(places, kind) if len(places) >= MIN_MARKS else []
    return grown[0] if grown else None


def _hexagonal(places: Points, size: tuple[int, int]) -> PinLattice | None:
    grown = _largest(places, "hexagonal")
    if grown is None or (grown := _centred(grown)) is None:
        return None
    named = _of("hexagonal", grown, places)
    if named is None or named.whole:
        return named
    return _of("hexagonal", _centred(fill_hexagon(grown, places, size)), places)


def _centred(lattice: GrownLattice) -> GrownLattice | None:
    """Hexagonal lattice without strays, with cells counted from its middle, or None."""
    kept = _in_field(lattice.cells)
    cells = lattice.cells[kept]
    return GrownLattice(cells - _middle(cells), lattice.marks[kept], lattice.pitch) if len(cells) else None


def _in_field(cells: Int[ndarray, "m 2"]) -> Bool[ndarray, " m"]:
    """Which marks of a hexagonal lattice are no strays on its next ring."""
    there = set(map(tuple, cells.tolist()))
    beside = np.array([sum((c + i, r + j) in there for i, j in DIRECTIONS.tolist()) for c, r in cells])
    firm = beside >= MIN_NEXT
    if not firm.any():
        return firm
    away = ring_of(cells - _middle(cells[firm]))
    kept = firm | ((away <= away[firm].max()) & (beside > 0))
    filled = np.bincount(away[kept]) / np.maximum(6 * np.arange(away[kept].max() + 1), 1)
    strays = np.flatnonzero((filled[1:] < NEARLY_EMPTY) & (filled[:-1] > NEARLY_FULL)) + 1
    return np.asarray(kept & (away < strays[0]) if len(strays) else kept)


def _middle(cells: Int[ndarray, "m 2"]) -> Int[ndarray, 2]:
    """Cell about which whole rings hold most cells and fewest gaps."""
    low, high = cells.min(axis=0), cells.max(axis=0)
    grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), -1)
    ways = grid.reshape(-1, 2)
    away = ring_of((cells - ways[:, None]).reshape(-1, 2)).reshape(len(ways), -1)
    rings = np.arange(away.max() + 1)
    inside = (away[:, :, None] <= rings).sum(axis=1)
    held = inside - EMPTY_COSTS * (3 * rings * (rings + 1) + 1 - inside)
    return np.asarray(ways[np.lexsort([away.sum(axis=1), -held.max(axis=1)])[0]])


def _of(kind: PinLayoutKind, lattice: GrownLattice | None, places: Points) -> PinLattice | None:
    if lattice is None or not len(lattice.cells):
        return None
    cells = lattice.cells - (np.rint(lattice.cells.mean(axis=0)).astype(int) if kind == "square" else 0)
    return PinLattice(kind, cells, lattice.marks, lattice.pitch, share_named(places, lattice.marks))
