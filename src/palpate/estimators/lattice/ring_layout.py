"""Marks in rings around a middle one, as the pins of a TacTip, each named by its cell.

Ring k has 6 k marks, named as the rings of a hexagonal lattice. No local rule names them, since four marks
form a square where two sixths meet; so rings are laid over the marks from the middle outward, each predicted
by an affine map of the layout around each position.

Pins distinguished from other bright spots by their lattice, each named by its cell.

Hexagonal lattice and rings about a middle pin (`ring_layout`) are tried, then a square lattice. Cells count
from the middle of the field, so that names do not depend on hidden pins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from palpate.core import Bool, Float, Int, ndarray
from palpate.estimators.lattice.lattice_growth import MIN_MARKS, GrownLattice, grow_lattices

MAX_RINGS = 13
REACH = 2.9  # pitches within which known marks predict others
WIDTH = 1.4  # pitches; standard deviation of their weights
MIN_KNOWN = 4
WITHIN = 0.36  # of the local pitch, how far a mark may lie from where it must
KEPT_WITHIN = 0.1, 0.3  # of the pitch: bounds of six times the usual distance, beyond which it is left out
FIRST_RINGS = 5  # by which beginnings are compared
MIDDLES = 24  # marks and gaps that are tried as the middle
RECHOICES = 2
MAX_TRIES = 4
MIN_JOINED = 0.55  # ratio of the positions next to a seed that have a mark
MIN_FILLED = 0.5  # ratio of a ring's positions inside the image
# sites that a mark near the middle may be: the middle, or where too much is hidden there, of one sixth
BEGINNINGS = (0,), (1, 7, 8, 19, 20, 21)
SETTLED = 0.93  # ratio of named marks within the layout with which no other is tried
# cells around one, 60 degrees apart, the first along the columns
DIRECTIONS = np.array([[1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1]])

Points = Float[ndarray, "n 2"]
Cells = Int[ndarray, "n 2"]


def ring_of(cells: Cells) -> Int[ndarray, " n"]:
    """Return the ring of each cell of a hexagonal lattice about (0, 0)."""
    column, row = np.asarray(cells).T
    return (np.abs(column) + np.abs(row) + np.abs(column + row)) // 2


def plane_of(cells: Cells) -> Points:
    """Return positions of a hexagonal lattice's cells in the plane [pitches]."""
    column, row = np.asarray(cells, float).T
    return np.stack([column + row / 2, np.sqrt(0.75) * row], axis=1)


@dataclass(frozen=True, eq=False)
class RingSites:
    """Cells of rings, the inner ones first, and their positions in pitches.

    Attributes:
        cells: (column, row) ``[s 2]``; (0, 0) is the middle.
        weight, across, down: Weight of each site for each other, and the offset between them ``[s s]``.
    """

    cells: Cells
    ring: Int[ndarray, " s"]
    places: Points
    weight: Float[ndarray, "s s"]
    across: Float[ndarray, "s s"]
    down: Float[ndarray, "s s"]

    def upto(self, ring: int) -> int:
        return min(3 * ring * (ring + 1) + 1, len(self.cells))


@cache
def ring_sites(kind: str = "rings") -> RingSites:
    """Return the sites of a layout: "rings" on circles, or "hexagonal" with straight rings."""
    cells, places = [np.zeros((1, 2), int)], [np.zeros((1, 2))]
    for k in range(1, MAX_RINGS + 1):
        number = np.arange(6 * k)
        side, step = number // k, number % k
        cells.append(k * DIRECTIONS[side] + step[:, None] * DIRECTIONS[(side + 2) % 6])
        angle = 2 * np.pi * number / (6 * k)
        places.append(k * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    cell = np.concatenate(cells)
    at = np.concatenate(places) if kind == "rings" else plane_of(cell)
    across, down = (np.subtract.outer(at[:, a], at[:, a]).T for a in (0, 1))
    away2 = across**2 + down**2
    weight = np.where((away2 > 0) & (away2 < REACH**2), np.exp(-away2 / (2 * WIDTH**2)), 0.0)
    return RingSites(cell, ring_of(cell), at, weight, across, down)


def fill_hexagon(lattice: GrownLattice, places: Points, size: tuple[int, int]) -> GrownLattice:
    """Return a hexagonal lattice about its middle with the marks that its growth omitted."""
    ring = ring_of(lattice.cells)
    if ring.max() > MAX_RINGS:
        return lattice
    laid = _Laying(places, cKDTree(places), size, "hexagonal")
    number = {cell: i for i, cell in enumerate(map(tuple, laid.sites.cells.tolist()))}
    laid.mark[[number[cell] for cell in map(tuple, lattice.cells.tolist())]] = lattice.marks
    laid.reached = int(ring.max())
    laid.grow(laid.reached)
    laid.trim()
    return laid.lattice() or lattice


def empty_sites(
    kind: str, cells: Int[ndarray, "m 2"], at: Float[ndarray, "m 2"], size: tuple[int, int]
) -> tuple[Int[ndarray, "e 2"], Float[ndarray, "e 2"]]:
    """Return cells within a field's rings without a mark, and their predicted positions [px]."""
    laid = _Laying(at, cKDTree(at), size, kind)
    number = {cell: i for i, cell in enumerate(map(tuple, laid.sites.cells.tolist()))}
    laid.mark[[number[cell] for cell in map(tuple, cells.tolist())]] = np.arange(len(at))
    count = laid.sites.upto(int(ring_of(cells).max()))
    empty = np.flatnonzero(laid.mark[:count] < 0)
    expected, _ = laid._expected(empty, count)
    x, y = expected.T
    with np.errstate(invalid="ignore"):
        inside = (x > 1) & (y > 1) & (x < size[1] - 2) & (y < size[0] - 2)
    return laid.sites.cells[empty[inside]], expected[inside]


def lay_rings(places: Points, size: tuple[int, int]) -> GrownLattice | None:
    """Return the rings that hold most marks, named from their middle, or None.

    Args:
        places: Marks ``[n 2]`` [px].
        size: Height and width of the image [px].
    """
    if len(places) < 7:
        return None
    tree, best = cKDTree(places), None
    around = _candidates(places, tree)
    for sites in BEGINNINGS:
        tries: list[tuple[float, int, _Laying]] = []
        for middle in around:
            for site in sites:
                laid = _Laying(places, tree, size)
                start = _begun_at(site, middle, places, tree)
                if start is not None and laid.begin(site, start):
                    laid.grow(FIRST_RINGS)
                    tries.append((laid.fit, len(tries), laid))
        for _, _, laid in sorted(tries, key=lambda one: (-one[0], one[1]))[:MAX_TRIES]:
            laid.grow(MAX_RINGS)
            laid.trim()
            if best is None or laid.fit > best.fit:
                best = laid
            if share_named(places, best.mark[best.mark >= 0]) > SETTLED:
                return best.lattice()
    return None if best is None else best.lattice()


def share_named(places: Points, marks: Int[ndarray, " m"]) -> float:
    """Return the ratio of the marks within the outline of some that belong to these."""
    try:
        among = Delaunay(places[marks]).find_simplex(places) >= 0
    except (QhullError, ValueError):
        return 0.0
    among[marks] = True
    return len(marks) / float(among.sum())


def _candidates(places: Points, tree: cKDTree) -> Float[ndarray, "c 2"]:
    """Marks and mark-sized gaps that may be the middle, from the center outwards."""
    near = tree.query(places, k=2)[0][:, 1]
    candidates = np.concatenate([places, _gaps(places, near)])
    order = np.argsort(np.hypot(*(candidates - np.median(places, axis=0)).T))
    return candidates[order[:MIDDLES]]


def _gaps(places: Points, near: Float[ndarray, " n"]) -> Float[ndarray, "g 2"]:
    """Centers of the largest empty circles, where a mark may be missing."""
    try:
        corners = Delaunay(places).simplices
    except QhullError:  # all on one line
        return np.empty((0, 2))
    a, b, c = places[corners].transpose(1, 0, 2)
    ab, ac = b - a, c - a
    cross = 2 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    sound = np.abs(cross) > 1e-9
    ab, ac, a, cross, corners = ab[sound], ac[sound], a[sound], cross[sound], corners[sound]
    ab2, ac2 = (ab**2).sum(axis=1), (ac**2).sum(axis=1)
    to = np.stack([ac[:, 1] * ab2 - ab[:, 1] * ac2, ab[:, 0] * ac2 - ac[:, 0] * ab2], axis=1) / cross[:, None]
    share = np.hypot(*to.T) / np.median(near[corners], axis=1)
    return (a + to)[(share > 0.8) & (share < 1.3)]


@cache
def _beside(site: int) -> Int[ndarray, " b"]:
    sites = ring_sites()
    away = np.hypot(sites.across[site], sites.down[site])
    return np.flatnonzero((away > 0) & (away < 1.3))


def _begun_at(
    site: int, middle: Float[ndarray, 2], places: Points, tree: cKDTree
) -> Float[ndarray, "3 2"] | None:
    """Affine map from pitches to pixels by which most sites around a mark have one."""
    far, which = tree.query(middle, k=min(9, len(places)))
    others = far > 0.25 * far[-1]  # not the place's own mark
    best, most = None, -np.inf
    sites = ring_sites()
    out = sites.places[_beside(site)] - sites.places[site]
    first = out[0] / (out[0] ** 2).sum()
    for f, i in zip(far[others][:6], which[others][:6], strict=True):
        x, y = places[i] - middle
        c, s = first @ [x, y], first[0] * y - first[1] * x  # turn and size that bring the first site there
        gap, mark = tree.query(middle + out @ np.array([[c, s], [-s, c]]))
        near = gap < WITHIN * f
        count = int(near.sum())
        if count < MIN_KNOWN or len(set(mark[near].tolist())) < count:
            continue
        design = np.column_stack([np.ones(count), out[near]])
        fit = np.linalg.lstsq(design, places[mark[near]], rcond=None)[0]
        left = np.hypot(*(design @ fit - places[mark[near]]).T).mean() / f
        good = count - left - 2 * f / far[others][0]
        if np.hypot(*(fit[0] - middle)) < WITHIN * f and good > most:
            best, most = fit, good
    if best is None:
        return None
    best[0] = best[0] - sites.places[site] @ best[1:]
    return best


def upright(cells: Cells, places: Points) -> Cells:
    """Return cells rotated by sixths until columns run nearly with the image's columns."""
    design = np.column_stack([np.ones(len(cells)), plane_of(cells)])
    along = np.linalg.lstsq(design, places, rcond=None)[0][1:]
    out = plane_of(DIRECTIONS) @ along
    first = int(np.argmax(out[:, 0] / np.hypot(*out.T)))
    for _ in range(6 - first):
        cells = np.stack([-cells[:, 1], cells.sum(axis=1)], axis=1)
    return cells


class _Laying:
    """Assignment of marks to ring sites, ring by ring."""

    def __init__(self, places: Points, tree: cKDTree, size: tuple[int, int], kind: str = "rings") -> None:
        self.places, self.tree, self.size = places, tree, size
        self.sites = ring_sites(kind)
        self.mark = np.full(len(self.sites.cells), -1)
        self.expected = np.full((len(self.mark), 2), np.nan)
        self.reached = 1

    @property
    def fit(self) -> float:
        """Return assigned sites less empty ones inside the image."""
        return float((self.mark >= 0).sum() - 0.5 * (self._inside() & (self.mark < 0)).sum())

    def begin(self, site: int, start: Float[ndarray, "3 2"]) -> bool:
        """Assign the middle and its surroundings; return whether more join."""
        which = np.append(_beside(site), site)
        expected = np.column_stack([np.ones(len(which)), self.sites.places[which]]) @ start
        self._take(which, expected, np.full(len(which), np.linalg.svd(start[1:], compute_uv=False)[1]))
        self.reached = int(self.sites.ring[which].max())
        free = np.setdiff1d(np.arange(self.sites.upto(self.reached + 1)), which)
        expected, pitch = self._expected(free, self.sites.upto(self.reached + 1))
        told = np.isfinite(pitch)
        far, _ = self.tree.query(expected[told])
        return bool((far < WITHIN * pitch[told]).mean() > MIN_JOINED) if told.any() else False

    def grow(self, rings: int) -> None:
        """Assign marks up to a ring, as long as a ring finds some."""
        self._settle(self.reached)
        for ring in range(self.reached + 1, rings + 1):
            self._settle(ring)
            here = self.sites.ring == ring
            inside = here & self._inside()
            if (self.mark[here] >= 0).sum() < MIN_FILLED * max(inside.sum(), 1):
                self.mark[here] = -1
                break
            self.reached = ring
        self._settle(self.reached)

    def trim(self) -> None:
        """Reassign each site, and remove marks off their predicted position."""
        count = self.sites.upto(self.reached)
        for _ in range(RECHOICES):
            expected, pitch = self._expected(np.arange(count), count)
            self.mark[:] = -1
            self._take(np.arange(count), expected, pitch)
            if (self.mark >= 0).sum() < MIN_KNOWN:
                return
        self._drop(count)
        self._settle(self.reached)
        self._drop(count)

    def _drop(self, count: int) -> None:
        """Remove marks off their predicted position."""
        known = np.flatnonzero(self.mark >= 0)
        expected, pitch = self._expected(known, count)
        if not np.isfinite(pitch).any():
            self.mark[known] = -1
            return
        off = np.hypot(*(expected - self.places[self.mark[known]]).T) / pitch
        usual = np.nanmedian(off)
        self.mark[known[~(off < np.clip(6 * usual, *KEPT_WITHIN))]] = -1

    def lattice(self) -> GrownLattice | None:
        known = np.flatnonzero(self.mark >= 0)
        if len(known) < 7:
            return None
        _, pitch = self._expected(known, self.sites.upto(self.reached))
        cells = upright(self.sites.cells[known], self.places[self.mark[known]])
        return GrownLattice(cells, self.mark[known], float(np.nanmedian(pitch)))

    def _inside(self) -> np.ndarray:
        x, y = self.expected.T
        with np.errstate(invalid="ignore"):
            inside = (x > 0) & (y > 0) & (x < self.size[1] - 1) & (y < self.size[0] - 1)
        return inside & (self.sites.ring <= self.reached + 1)

    def _settle(self, ring: int) -> None:
        """Fill sites up to a ring until no more marks are assigned."""
        count = self.sites.upto(ring)
        while True:
            free = np.flatnonzero(self.mark[:count] < 0)
            expected, pitch = self._expected(free, count)
            if not self._take(free, expected, pitch):
                return

    def _expected(self, which: Int[ndarray, " m"], count: int) -> tuple[Points, Float[ndarray, " m"]]:
        """Predicted positions of sites by affine maps; NaN where too few are known."""
        known = np.flatnonzero(self.mark[:count] >= 0)
        grid = np.ix_(which, known)
        w, dx, dy = self.sites.weight[grid], self.sites.across[grid], self.sites.down[grid]
        xy = self.places[self.mark[known]]
        terms = (np.ones_like(w), dx, dy)
        matrix = np.stack([np.stack([(w * p * q).sum(axis=1) for q in terms], -1) for p in terms], -1)
        sides = np.stack([(w * p) @ xy for p in terms], axis=1)
        enough = ((w > 0).sum(axis=1) >= MIN_KNOWN) & (np.linalg.det(matrix) > 1e-3 * matrix[:, 0, 0] ** 3)
        place, pitch = np.full((len(which), 2), np.nan), np.full(len(which), np.nan)
        fit = np.linalg.solve(matrix[enough], sides[enough])
        place[enough] = fit[:, 0]
        pitch[enough] = np.linalg.svd(fit[:, 1:], compute_uv=False)[:, 1]
        return place, pitch

    def _take(self, which: Int[ndarray, " m"], expected: Points, pitch: Float[ndarray, " m"]) -> bool:
        """Assign to each site the mark next to its prediction, each mark to its nearest site."""
        self.expected[which] = expected
        told = np.flatnonzero(np.isfinite(expected).all(axis=1))
        if not len(told):
            return False
        far, mark = self.tree.query(expected[told])
        off = far / np.maximum(pitch[told], 1e-9)
        used = set(self.mark[self.mark >= 0].tolist())
        taken = False
        for i in np.argsort(off):
            if off[i] < WITHIN and int(mark[i]) not in used:
                used.add(int(mark[i]))
                self.mark[which[told[i]]] = mark[i]
                taken = True
        return taken


PinLayoutKind = Literal["hexagonal", "rings", "square"]
MIN_FILLED_CELLS = 0.9  # ratio of its rings' cells; pins in circular rings leave more empty
MIN_SHARE = 0.65  # with less, marks stand on no lattice
MIN_OF_ALL = 0.45  # ratio of all marks
SHEARED = 1.25  # a square's diagonal is 1.41 of its side
OUTWARDS = (2, 1), (4, 3), (6, 3)  # rings, and the degree of the map that leads there
OFF = 0.2  # of the distance of neighbours, between where a pin is and where the map has it
NEARLY_EMPTY, NEARLY_FULL = 0.15, 0.6  # ratios of a ring's cells
EMPTY_COSTS = 0.5  # of a mark
MIN_NEXT = 3  # neighbours of a pin on the edge of a hexagonal field


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
        return self.share > SETTLED and (self.kind != "hexagonal" or self.filled > MIN_FILLED_CELLS)


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
        best = _better(_of("square", _largest_by_turn(places, "square"), places), best)
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


def _largest_by_turn(places: Points, kind: str) -> GrownLattice | None:
    grown = grow_lattices(places, kind) if len(places) >= MIN_MARKS else []
    return grown[0] if grown else None


def _hexagonal(places: Points, size: tuple[int, int]) -> PinLattice | None:
    grown = _largest_by_turn(places, "hexagonal")
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
