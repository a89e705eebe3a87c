"""Neighbouring marks that have moved against all others."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label

from palpate.core import Bool, Float, Int, ndarray
from palpate.estimators.surface_strain import StrainFields

STRAYED = 8.0  # times a mark's standard error
MIN_GROUP = 3  # neighbouring marks: noise moves one, rarely two
NEIGHBOURS = np.ones((3, 3), bool)


def strayed(fields: StrainFields) -> int:
    """Number of marks in the largest group that has moved beside an affine motion of all."""
    error = np.sqrt(fields.variances.sum(axis=0))
    off = np.hypot(*_beside_affine(fields.rest, fields.moved).T)
    return largest_group(fields.basis.cells, off > STRAYED * error)


def _beside_affine(at: Float[ndarray, "n 2"], moved: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
    """Shifts less an affine motion of all, marks that stray left out of it."""
    basis = np.column_stack([np.ones(len(at)), at / max(float(np.abs(at).max()), 1e-12)])
    sound = np.ones(len(at), bool)
    off = moved
    for _ in range(3):
        off = moved - basis @ np.linalg.lstsq(basis[sound], moved[sound], rcond=None)[0]
        size = np.hypot(*off.T)
        sound = size <= 3 * max(float(np.median(size)), 1e-12)
    return off


def largest_group(cells: Int[ndarray, "n 2"], which: Bool[ndarray, " n"]) -> int:
    """Number of marks in the largest group of neighbours."""
    if not which.any():
        return 0
    column, row = (cells[which] - cells.min(axis=0)).T
    grid = np.zeros((int(row.max()) + 1, int(column.max()) + 1), bool)
    grid[row, column] = True
    groups, _ = label(grid, NEIGHBOURS)
    return int(np.bincount(groups.ravel())[1:].max())
