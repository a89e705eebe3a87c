"""Marks of a square or hexagonal lattice named by their cell, from frame to frame.

A lattice grows from a mark with all neighbors, cell by cell, by an affine map through the cells around the
next one, which tolerates rotation, shear, lens curvature, and missing marks. Marks off their predicted
position are omitted. Cells are known up to a step and a turn; marks vote for the step to the nearest mark of
a reference.

Marks of a skin's pattern by their cell of the lattice, with the place of each and its standard error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import cv2
import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from palpate.core import Float, InputError, Int, RangeError, ndarray

Cells = Int[ndarray, "n 2"]
Places = Float[ndarray, "n 2"]


@dataclass(frozen=True, slots=True, eq=False)
class ControlPoints:
    """Marks of one frame, at most one in a cell.

    Attributes:
        cells: (column, row) in the lattice, the mark's name over time ``[n 2]``; cells may be missing.
        places: (x, y) ``[n 2]`` [`unit`].
        sigma: Standard error along each axis ``[n]`` [`unit`].
        unit: "px" in an image, "m" on the skin.
    """

    cells: Cells
    places: Places
    sigma: Float[ndarray, " n"]
    unit: Literal["px", "m"] = "px"

    def __post_init__(self) -> None:
        n = len(self.cells)
        if not (len(self.places) == len(self.sigma) == n):
            raise InputError(
                f"{n} cells, {len(self.places)} places, {len(self.sigma)} errors; give as many of each"
            )
        if len(set(map(tuple, self.cells.tolist()))) != n:
            raise InputError("a cell of the lattice comes twice; give each mark a cell of its own")
        if not (np.isfinite(self.places).all() and np.isfinite(self.sigma).all() and (self.sigma >= 0).all()):
            raise InputError(
                "a place or its standard error is not finite, or an error is below 0; leave it out"
            )

    def __len__(self) -> int:
        return len(self.cells)

    def shared_with(self, reference: ControlPoints) -> tuple[Places, Places, Cells]:
        """Return the reference's positions, these positions, and the cells of the marks that both have."""
        if self.unit != reference.unit:
            raise InputError(
                f"control points in {self.unit} and {reference.unit}; use one unit", code="unit-differs"
            )
        own = {tuple(cell): i for i, cell in enumerate(self.cells.tolist())}
        pairs = [(i, own[cell]) for i, cell in enumerate(map(tuple, reference.cells.tolist())) if cell in own]
        theirs, ours = np.array(pairs, int).reshape(-1, 2).T
        return reference.places[theirs], self.places[ours], reference.cells[theirs]


LatticeKind = Literal["square", "hexagonal"]
Points = Float[ndarray, "n 2"]

KEPT_WITHIN = 0.1, 0.22  # of the local pitch: bounds of six times the usual distance from where it must lie
MIN_AROUND = 3  # cells that agree
MAX_BETWEEN = 0.15  # ratio of marks halfway between two, beyond which the lattice is finer
MIN_MARKS = 9  # fewer are no lattice
MIN_DETERMINANT = 0.05  # of the cells around: less are nearly on one line
MAX_SEEDS = 12  # marks from which it is begun
HELD = 0.02  # relative weight of the penalty on curvature
MARGIN = 4  # empty cells around the known ones


@dataclass(frozen=True)
class GrowthStep:
    """Conditions on a cell before a mark is assigned to it.

    Attributes:
        reach: Cells to each side used for the prediction.
        least_around: Least number of known cells within that reach.
        least_next: Least number of known adjacent cells.
        within: Greatest distance from the prediction, in local pitches.
        curved: Whether the lattice's curvature is used.
    """

    reach: int
    least_around: int
    least_next: int
    within: float
    curved: bool = False


NEXT = GrowthStep(2, MIN_AROUND, 3, 0.28)
OVER_A_GAP = GrowthStep(3, 5, 0, 0.2)
AROUND_A_BEND = GrowthStep(3, 7, 2, 0.2, curved=True)


@dataclass(frozen=True, eq=False)
class GrownLattice:
    """Connected marks by their cell.

    Attributes:
        cells: (column, row) ``[n 2]``, from 0, roughly along the image's columns and rows.
        marks: Index of the mark in each cell ``[n]``.
        pitch: Median distance of neighbors [px].
    """

    cells: Cells
    marks: Int[ndarray, " n"]
    pitch: float


def grow_lattices(
    places: Points, kind: str = "square", turn: Float[ndarray, " n"] | None = None
) -> list[GrownLattice]:
    """Return connected lattices among marks, the one with most marks first.

    Args:
        places: Marks ``[n 2]`` [px].
        kind: "square", or "hexagonal" with axes 60 degrees apart.
        turn: Angle of a checkerboard's corners, which must differ by half a turn between neighbors.
    """
    if kind not in ("square", "hexagonal"):
        raise RangeError(f'a lattice is "square" or "hexagonal", not {kind!r}')
    free = np.arange(len(places))
    found: list[GrownLattice] = []
    while len(free) >= MIN_MARKS:
        grown = _largest(places[free], kind, None if turn is None else turn[free])
        if grown is None:
            break
        found.append(GrownLattice(grown.cells, free[grown.marks], grown.pitch))
        free = np.delete(free, grown.marks)
    return sorted(found, key=lambda lattice: -len(lattice.cells))


def _largest(places: Points, kind: str, turn: Float[ndarray, " n"] | None) -> GrownLattice | None:
    """Lattice with most marks from several seeds."""
    best, reached = None, np.zeros(len(places), bool)
    tries = 0
    for seed, axes in _seeds(places, kind):
        if reached[seed]:
            continue
        grown = _Growth(places, kind, turn).grown_from(seed, axes)
        tries += 1
        if grown is not None:
            reached[grown.marks] = True
            if best is None or len(grown.cells) > len(best.cells):
                best = grown
        if tries == MAX_SEEDS or (best is not None and 2 * len(best.cells) > len(places)):
            break
    return best


def _seeds(places: Points, kind: str) -> list[tuple[int, np.ndarray]]:
    """Marks between opposite neighbors, and the two axes there, from the middle outwards."""
    count = 4 if kind == "square" else 6
    near, which = cKDTree(places).query(places, k=count + 1)
    near, out = near[:, 1:], places[which[:, 1:]] - places[:, None]
    typical = np.median(near[:, 0])
    mirror = np.hypot(*(out[:, :, None] + out[:, None]).transpose(3, 0, 1, 2)).min(axis=2)
    whole = (mirror < 0.35 * near[:, :1]) & (near < (1.7 if count == 4 else 1.45) * near[:, :1])
    apart = np.hypot(*(places - np.median(places, axis=0)).T)
    order = np.argsort(apart * (1 + np.abs(np.log(near[:, 0] / typical))))
    seeds = []
    for i in order[whole.sum(axis=1)[order] >= 4]:
        axes = _axes(out[i][whole[i]], count)
        if axes is not None:
            seeds.append((int(i), axes))
    return seeds


def _axes(around: Points, count: int) -> np.ndarray | None:
    """Both axes of a lattice from a mark's neighbors, the first nearly along the image's columns."""
    first = around[np.argmax(around[:, 0] / np.hypot(*around.T))]
    angle = np.arctan2(around[:, 1], around[:, 0]) - np.arctan2(first[1], first[0])
    for wanted, add in ((np.pi / 2, 0.0),) if count == 4 else ((np.pi / 3, 0.0), (2 * np.pi / 3, 1.0)):
        off = np.abs((angle - wanted + np.pi) % (2 * np.pi) - np.pi)
        if off.min() < (0.75 if count == 4 else 0.5):
            return np.stack([first, around[np.argmin(off)] + add * first])
    return None


class _Growth:
    """Grid of cells [row, column] that is filled with marks."""

    def __init__(self, places: Points, kind: str, turn: Float[ndarray, " n"] | None) -> None:
        self.places, self.turn, self.kind = places, turn, kind
        self.tree = cKDTree(places)

    def grown_from(self, seed: int, axes: np.ndarray) -> GrownLattice | None:
        self._begin(seed, axes)
        while self._extend(NEXT) or self._extend(OVER_A_GAP) or self._extend(AROUND_A_BEND):
            pass
        while self._drop():
            pass
        self._keep_one_piece()
        return None if self._is_sublattice() else self._lattice()

    def _begin(self, seed: int, axes: np.ndarray) -> None:
        """Start with the seed and its neighbors along both axes."""
        self.mark = np.full((2 * MARGIN + 3,) * 2, -1)
        pitch = np.hypot(*axes.T).min()
        for column, row in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            far, which = self.tree.query(self.places[seed] + column * axes[0] + row * axes[1])
            if far < NEXT.within * pitch and not (self.mark == which).any():
                self.mark[MARGIN + 1 + row, MARGIN + 1 + column] = which

    def _predicted(
        self, reach: int = 2, curved: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Predicted position of each cell's mark by a map fitted to those around it."""
        known = self.mark >= 0
        xy = np.where(known[..., None], self.places[self.mark], 0.0)
        w, u, v = _weights(reach, self.kind)
        terms = [np.ones_like(u), u, v, *((u * u, u * v, v * v) if curved else ())]
        whole = known.astype(np.float64)
        matrix = np.stack([np.stack([_correlate(whole, w * p * q) for q in terms], -1) for p in terms], -1)
        (m0, mu, mv), (_, muu, muv), mvv = (*matrix[..., :2, :3].transpose(2, 3, 0, 1), matrix[..., 2, 2])
        determinant = m0 * (muu * mvv - muv**2) - mu * (mu * mvv - muv * mv) + mv * (mu * muv - muu * mv)
        spans = determinant > MIN_DETERMINANT * np.maximum(m0, 1e-9) ** 3
        sides = np.stack(
            [
                np.stack([_correlate(np.ascontiguousarray(xy[..., a]), w * p) for p in terms], -1)
                for a in (0, 1)
            ],
            axis=-1,
        )
        held = np.diag([0.0] * 3 + [HELD] * (len(terms) - 3))
        fit = np.linalg.solve(matrix[spans] + held * m0[spans][:, None, None], sides[spans])
        place, pitch = np.full(xy.shape, np.nan), np.full(m0.shape, np.nan)
        place[spans] = fit[:, 0]
        pitch[spans] = np.hypot(fit[:, 1:3, 0], fit[:, 1:3, 1]).min(axis=1)
        return place, pitch, np.rint(_correlate(whole, (w > 0).astype(np.float64))), spans

    def _extend(self, step: GrowthStep) -> bool:
        """Assign marks at predicted positions next to known cells; return whether there were any."""
        place, pitch, count, spans = self._predicted(step.reach, step.curved)
        known = np.float64(self.mark >= 0)
        ready = (self.mark < 0) & spans & (count >= step.least_around)
        ready &= (
            cv2.boxFilter(known, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
            >= step.least_next - 0.5
        )
        row, column = np.nonzero(ready)
        if not len(row):
            return False
        far, which = self.tree.query(place[row, column])
        off = far / np.maximum(pitch[row, column], 1e-9)
        good = (off < step.within) & self._turned(row, column, which)
        good &= ~np.isin(which, self.mark[self.mark >= 0])
        taken: set[int] = set()
        for i in np.argsort(off):
            if good[i] and which[i] not in taken:  # the nearest cell has it
                taken.add(which[i])
                self.mark[row[i], column[i]] = which[i]
        self._make_room()
        return bool(taken)

    def _make_room(self) -> None:
        row, column = np.nonzero(self.mark >= 0)
        rows, columns = self.mark.shape
        need = [(row.min(), rows - 1 - row.max()), (column.min(), columns - 1 - column.max())]
        self.mark = np.pad(
            self.mark, [[max(0, MARGIN - int(n)) for n in side] for side in need], constant_values=-1
        )

    def _turned(self, row: np.ndarray, column: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Whether corners are rotated as the parity of their cells requires."""
        if self.turn is None:
            return np.ones(len(row), bool)
        signs = np.where(np.indices(self.mark.shape).sum(axis=0) % 2, -1.0, 1.0)
        known = np.where(self.mark >= 0, np.exp(1j * self.turn[self.mark]) * signs, 0)
        w, _, _ = _weights(2, self.kind)
        around = _correlate(np.ascontiguousarray(known.real), w) + 1j * _correlate(
            np.ascontiguousarray(known.imag), w
        )
        own = np.exp(1j * self.turn[which]) * signs[row, column]
        return (own * np.conj(around[row, column])).real > 0.3 * np.abs(around[row, column])

    def _drop(self) -> bool:
        """Remove marks off their predicted position; return whether there were any."""
        place, pitch, count, spans = self._predicted()
        curved, _, _, _ = self._predicted(3, curved=True)
        row, column = np.nonzero(self.mark >= 0)
        which = self.mark[row, column]
        off, by_curve = (np.hypot(*(p[row, column] - self.places[which]).T) for p in (place, curved))
        off = np.fmin(off, by_curve)
        bad = ~spans[row, column] | (count[row, column] < MIN_AROUND)
        share = off / np.maximum(pitch[row, column], 1e-9)
        usual = np.median(share[~bad]) if (~bad).any() else 0.0
        bad |= ~(share < np.clip(6 * usual, *KEPT_WITHIN))
        bad |= ~self._turned(row, column, which)
        far = np.zeros(self.mark.shape)
        far[row, column] = np.nan_to_num(off)
        worst = bad & (off >= 0.999 * ndimage.maximum_filter(far, 5)[row, column])
        worst |= bad & ~(spans[row, column] & (count[row, column] >= MIN_AROUND))
        self.mark[row[worst], column[worst]] = -1
        return bool(worst.any())

    def _keep_one_piece(self) -> None:
        """Keep the largest part whose marks lie within two cells of each other."""
        parts, n = ndimage.label(ndimage.binary_dilation(self.mark >= 0, np.ones((3, 3))), np.ones((3, 3)))
        if n > 1:
            sizes = np.bincount(parts[self.mark >= 0], minlength=n + 1)
            self.mark[parts != sizes.argmax()] = -1

    def _is_sublattice(self) -> bool:
        """Whether unassigned marks lie halfway between cells, as of a finer lattice."""
        xy = np.where((self.mark >= 0)[..., None], self.places[self.mark], np.nan)
        free = np.ones(len(self.places), bool)
        free[self.mark[self.mark >= 0]] = False
        for row, column in ((0, 1), (1, 0), (1, 1), (1, -1)):
            other = np.roll(xy, (-row, -column), axis=(0, 1))
            halfway, apart = (xy + other) / 2, np.hypot(*np.moveaxis(other - xy, -1, 0))
            told = np.isfinite(apart)
            if not told.any():
                continue
            far, which = self.tree.query(halfway[told])
            if ((far < 0.15 * apart[told]) & free[which]).mean() > MAX_BETWEEN:
                return True
        return False

    def _lattice(self) -> GrownLattice | None:
        row, column = np.nonzero(self.mark >= 0)
        if len(row) < MIN_MARKS:
            return None
        _, pitch, _, _ = self._predicted()
        cells = np.stack([column - column.min(), row - row.min()], axis=1)
        return GrownLattice(cells, self.mark[row, column], float(np.median(pitch[row, column])))


@cache
def _weights(reach: int, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights of the cells around one by distance, and their offsets."""
    steps = np.arange(-reach, reach + 1.0)
    column, row = np.meshgrid(steps, steps)
    away = column**2 + row**2 + (column * row if kind == "hexagonal" else 0)
    return np.where(away > 0, np.maximum(away, 1) ** -1.5, 0.0), column, row


def _correlate(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return cv2.filter2D(image, cv2.CV_64F, mask, borderType=cv2.BORDER_CONSTANT)


MAX_MOVE = 0.7  # of the pitch, from the reference: halfway to the next corner of the same kind
MAX_DOT_MOVE = 0.5  # the same where all marks are alike
MIN_AGREED = 0.6  # ratio of the votes
MIN_VOTES = 5
QUARTER = np.array([[0, 1], [-1, 0]])
SIXTH = np.array([[0, 1], [-1, 1]])


def named_as(
    reference: ControlPoints,
    lattices: list[GrownLattice],
    places: Float[ndarray, "n 2"],
    kind: str = "square",
    max_move: float = MAX_DOT_MOVE,
) -> tuple[Int[ndarray, "m 2"], Int[ndarray, " m"]]:
    """Return cells in the reference's names, and the index of the mark in each.

    Args:
        reference: Marks of an earlier frame of the same camera.
        lattices: Lattices grown in this frame, each named by itself.
        places: Marks of this frame ``[n 2]`` [px].
        kind: Kind of both lattices.
        max_move: Distance in pitches beyond which a mark has no vote.
    """
    tree, taken = cKDTree(reference.places), set()
    cells: list[tuple[int, int]] = []
    marks: list[int] = []
    for lattice in lattices:
        named = _named(reference, tree, lattice, places[lattice.marks], kind, max_move)
        if named is None:
            continue
        for cell, mark in zip(map(tuple, named.tolist()), lattice.marks.tolist(), strict=True):
            if cell not in taken:
                taken.add(cell)
                cells.append(cell)
                marks.append(mark)
    return np.array(cells, int).reshape(-1, 2), np.array(marks, int)


def _named(
    reference: ControlPoints,
    tree: cKDTree,
    lattice: GrownLattice,
    places: Float[ndarray, "n 2"],
    kind: str,
    max_move: float,
) -> Int[ndarray, "n 2"] | None:
    """Cells of one lattice in the reference's names; none without a majority."""
    far, which = tree.query(places)
    near = far < max_move * lattice.pitch
    turn = QUARTER if kind == "square" else SIXTH
    best, agreed, step = lattice.cells, 0, np.zeros(2, int)
    cells = lattice.cells
    for _ in range(4 if kind == "square" else 6):
        steps, votes = np.unique(reference.cells[which[near]] - cells[near], axis=0, return_counts=True)
        if len(votes) and votes.max() > agreed:
            best, agreed, step = cells, int(votes.max()), steps[votes.argmax()]
        cells = cells @ turn
    if agreed < max(MIN_VOTES, MIN_AGREED * len(places)):
        return None
    return best + step
