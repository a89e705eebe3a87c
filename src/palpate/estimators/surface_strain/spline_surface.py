"""Tensor B-spline surface through a lattice's marks, some of which may be missing.

    S(u, v) = sum_ij N_i(u) M_j(v) P_ij,    u and v from 0 to 1 over the lattice's columns and rows,

on even knots. The control net P is a least-squares fit with a small penalty on second differences, which
bridges missing marks and keeps affine lattices. Evaluation and derivatives are matrices, kept for each set of
cells.

Reference: P. H. C. Eilers and B. D. Marx, Statistical Science 11, 89 (1996), doi:10.1214/ss/1038425655.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from palpate.core import Bool, Float, InputError, Int, RangeError, ndarray

Operator = Literal["value", "u", "v"]
Rows = Float[ndarray, "_ _"]

SAMPLES = (164, 164)  # along u and v: what the published constant alpha goes with
HELD = 1e-7  # of a squared misfit: weight of the net's second differences
MAX_DEGREE = 5
MAX_MARKS = 4000  # the fit is dense
MIN_CORNERS = 3  # of the four marks around a sample


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceBasis:
    """Fixed operators of a set of cells; see `surface_basis`.

    Attributes:
        cells: Marks, (column, row) ``[n 2]``.
        u, v: Parameters of the samples, 0 to 1.
        supported: Samples with at least three of the four marks around them ``[nv nu]``.
        fitting: Map from marks to the net ``[rows columns n]``.
        along_u, along_v: Basis functions at the samples, and their derivatives.
    """

    cells: Int[ndarray, "n 2"]
    degree: int
    u: Float[ndarray, " nu"]
    v: Float[ndarray, " nv"]
    supported: Bool[ndarray, "nv nu"]
    fitting: Float[ndarray, "rows columns n"]
    along_u: tuple[Rows, Rows]
    along_v: tuple[Rows, Rows]

    @property
    def count(self) -> int:
        return len(self.u) * len(self.v)

    def net(self, places: Float[ndarray, "n 2"]) -> Float[ndarray, "2 rows columns"]:
        """Return the control net P of marks in the order of the cells, in their unit."""
        if places.shape != self.cells.shape:
            raise InputError(
                f"places of the shape {places.shape} for {len(self.cells)} cells; give (x, y) of each"
            )
        return np.moveaxis(self.fitting @ places, -1, 0)

    def sampled(
        self, net: Float[ndarray, "2 rows columns"], operator: Operator = "value"
    ) -> Float[ndarray, "2 nv nu"]:
        """Return the surface of a net at the samples, or its derivative by u or v."""
        Nu, Nv = self._rows(operator)
        return np.asarray(Nv @ net @ Nu.T)

    def _rows(self, operator: Operator) -> tuple[Rows, Rows]:
        return self.along_u[operator == "u"], self.along_v[operator == "v"]


def surface_basis(
    cells: Int[ndarray, "n 2"],
    degree: int = 1,
    samples: tuple[int, int] = SAMPLES,
    cells_per_knot: float = 1.0,
    held: float = HELD,
) -> SurfaceBasis:
    """Return the operators of a set of visible cells; the same set gives the same object.

    Args:
        cells: (column, row) of each mark, none twice; u and v run from 0 to 1 over their bounds.
        degree: Degree of the spline, 1 to 5.
        samples: Number along u and along v, 2 or more.
        cells_per_knot: Distance of knots [cells], 1 or more.
        held: Weight of the penalty on second differences.
    """
    if degree not in range(1, MAX_DEGREE + 1):
        raise InputError(f"a spline of degree {degree}; give 1 to {MAX_DEGREE}")
    if min(samples) < 2:
        raise InputError(f"{samples} samples along u and v; give 2 or more along each")
    if not (1 <= cells_per_knot < math.inf and 0 < held < math.inf):
        raise InputError(
            f"knots {cells_per_knot} cells apart, held by {held}; give 1 cell or more, and a positive weight"
        )
    whole = np.ascontiguousarray(cells, np.int64)
    if whole.ndim != 2 or whole.shape[1] != 2 or not 3 <= len(whole) <= MAX_MARKS:
        raise RangeError(
            f"cells of the shape {whole.shape}; a surface has (column, row) of 3 to {MAX_MARKS} marks"
        )
    return _basis(whole.tobytes(), int(degree), tuple(samples), float(cells_per_knot), float(held))


@lru_cache(maxsize=32)
def _basis(
    cells: bytes, degree: int, samples: tuple[int, int], cells_per_knot: float, held: float
) -> SurfaceBasis:
    marks = np.frombuffer(cells, np.int64).reshape(-1, 2)
    first = marks.min(axis=0)
    columns, rows = (int(n) for n in marks.max(axis=0) - first)
    supported = _supported(marks - first, (columns, rows), samples)
    if not supported.any():
        raise RangeError(f"{len(marks)} marks, and nowhere three around one square; give a clearer frame")
    knots = [_knots(length, degree, cells_per_knot) for length in (columns, rows)]
    on_marks = [
        _functions(t, degree, at)[0] for t, at in zip(knots, (marks - first).T.astype(float), strict=True)
    ]
    fitting = _fitting(on_marks[0], on_marks[1], held)
    u, v = (np.linspace(0.0, 1.0, count) for count in samples)
    along_u = _functions(knots[0], degree, u * columns, columns)
    along_v = _functions(knots[1], degree, v * rows, rows)
    return SurfaceBasis(marks, degree, u, v, supported, fitting, along_u, along_v)


def _knots(length: int, degree: int, cells_per_knot: float) -> Float[ndarray, " t"]:
    """Even knots from 0 to a length [cells], and `degree` more on each side."""
    pieces = max(1, math.ceil(length / cells_per_knot - 1e-9))
    return np.arange(-degree, pieces + degree + 1) * (length / pieces)


def _functions(
    knots: Float[ndarray, " t"], degree: int, at: Float[ndarray, " s"], per_unit: float = 1.0
) -> tuple[Rows, Rows]:
    """Basis functions at positions, and their derivatives times `per_unit` ``[s k]``."""
    splines = BSpline(knots, np.eye(len(knots) - degree - 1), degree)
    return splines(at), splines.derivative()(at) * per_unit


def _fitting(on_u: Rows, on_v: Rows, held: float) -> Float[ndarray, "rows columns n"]:
    """Map from positions to the net: (B'B + held D'D)^-1 B'."""
    n, columns, rows = len(on_u), on_u.shape[1], on_v.shape[1]
    B = (on_v[:, :, None] * on_u[:, None, :]).reshape(n, -1)
    one_u, one_v, bend_u, bend_v = (
        np.diff(np.eye(size), n=order, axis=0) for order in (1, 2) for size in (columns, rows)
    )
    eye_u, eye_v = np.eye(columns), np.eye(rows)
    D = np.concatenate([np.kron(eye_v, bend_u), np.kron(bend_v, eye_u), 2**0.5 * np.kron(one_v, one_u)])
    try:
        fitted = cho_solve(cho_factor(B.T @ B + held * (D.T @ D)), B.T)
    except np.linalg.LinAlgError as error:
        raise RangeError(
            f"{n} marks do not determine a surface, as where they lie on one line; give more of the lattice"
        ) from error
    return np.asarray(fitted.reshape(rows, columns, n))


def _supported(
    cells: Int[ndarray, "n 2"], length: tuple[int, int], samples: tuple[int, int]
) -> Bool[ndarray, "nv nu"]:
    """Samples in lattice squares with three or more marks."""
    if min(length) < 1:
        raise RangeError("marks of a single row or column of the lattice are no surface; give more of it")
    there = np.zeros((length[1] + 1, length[0] + 1), int)
    there[cells[:, 1], cells[:, 0]] = 1
    squares = (there[:-1, :-1] + there[1:, :-1] + there[:-1, 1:] + there[1:, 1:]) >= MIN_CORNERS
    column, row = (
        np.minimum((np.linspace(0, 1, count) * size).astype(int), size - 1)
        for count, size in zip(samples, length, strict=True)
    )
    return np.asarray(squares[row[:, None], column])
