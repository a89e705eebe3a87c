"""Cells of a lattice named as in a reference, so that a mark keeps its name from frame to frame.

A lattice's cells are known up to a step and a quarter (or sixth) turn. Each mark votes for the step to the
nearest reference mark; a lattice without a majority is not named.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from palpate.core import Float, Int, ndarray
from palpate.estimators.lattice.control_points import ControlPoints
from palpate.estimators.lattice.lattice_growth import GrownLattice

MAX_MOVE = 0.7  # of the pitch, from the reference: halfway to the next corner of the same kind
MAX_DOT_MOVE = 0.5  # the same where all marks are alike
MIN_AGREED = 0.6  # share of the votes
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
    """Cells of one lattice in the reference's names; none if its marks disagree about the step."""
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
