"""Marks of a skin's pattern by their cell of the lattice, with the place of each and its standard error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from palpate.core import Float, InputError, Int, ndarray

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
