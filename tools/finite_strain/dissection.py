"""Elimination of a symmetric stiffness on a regular layer of columns of bricks, in single precision.

By nested dissection: the layer is halved again and again. What lies inside a half is eliminated before the
cut between two halves is, so that the fronts are as large as a cut and not as the layer.

Reference: A. George, Nested dissection of a regular finite element mesh, SIAM Journal on Numerical Analysis
10 (1973), doi:10.1137/0710032.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.linalg.blas import ssyrk, strsm
from scipy.linalg.lapack import spotrf

Span = tuple[int, int, int, int]  # bricks from, to along x, and along y


@dataclass(frozen=True)
class Part:
    """Some columns of bricks, after what lies inside them has been eliminated.

    Attributes:
        unknowns: of the front, first the `own` that are eliminated here.
        columns: of a single one its bricks' places in the front, -1 where held ``[bricks k]``; else None.
        halves: places in this front of what the two halves leave.
    """

    unknowns: Int[ndarray, " n"]
    own: int
    bricks: Int[ndarray, " b"]
    columns: Int[ndarray, "b k"] | None
    halves: tuple[Int[ndarray, " m"], ...]


@dataclass(frozen=True)
class Factors:
    """A stiffness after elimination: of every part its triangle, and its hold on the rest of its front."""

    parts: list[Part]
    lower: list[ndarray]
    across: list[ndarray]

    def solve(self, load: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        """Displacements under a load."""
        x = load.astype(np.float32)
        for part, lower, across in zip(self.parts, self.lower, self.across, strict=True):
            mine, others = part.unknowns[: part.own], part.unknowns[part.own :]
            x[mine] = strsm(1.0, lower, x[mine, None], lower=1)[:, 0]
            x[others] -= across.T @ x[mine]
        for part, lower, across in zip(
            reversed(self.parts), reversed(self.lower), reversed(self.across), strict=True
        ):
            mine, others = part.unknowns[: part.own], part.unknowns[part.own :]
            known = x[mine] - across @ x[others]
            x[mine] = strsm(1.0, lower, known[:, None], lower=1, trans_a=1)[:, 0]
        return x.astype(np.float64)


@numba.njit(cache=True)
def _add(front, at, part):  # type: ignore[no-untyped-def]
    """Add the lower triangle of a symmetric part where it lies in a front's lower triangle."""
    for j in range(len(at)):
        for i in range(j, len(at)):
            a, b = at[i], at[j]
            if a >= 0 and b >= 0:
                if a >= b:
                    front[a, b] += part[i, j]
                else:
                    front[b, a] += part[i, j]


class Dissection:
    """The order of elimination of one mesh.

    Args:
        unknown: number of every displacement of nodes, -1 where held ``[2 nx + 1, 2 ny + 1, 2 nz + 1, 3]``.
        dofs: those of every brick ``[nx ny nz, k]``, bricks counted along z first, then along y.
    """

    def __init__(self, unknown: Int[ndarray, "x y z 3"], dofs: Int[ndarray, "e k"]) -> None:
        self._unknown, self._dofs = unknown, dofs
        self._counts = tuple((n - 1) // 2 for n in unknown.shape[:3])
        self.parts: list[Part] = []
        self._children: list[tuple[int, ...]] = []
        self._at = np.full(int(unknown.max()) + 2, -1)  # the last is of what is held
        self._divide((0, self._counts[0], 0, self._counts[1]))

    def factors(self, K: Float[ndarray, "e k k"]) -> Factors:
        """Eliminate all unknowns."""
        left: dict[int, ndarray] = {}
        lowers, acrosses = [], []
        for i, (part, children) in enumerate(zip(self.parts, self._children, strict=True)):
            n = len(part.unknowns)
            front = np.zeros((n, n), np.float32, order="F")
            if part.columns is not None:
                for at, brick in zip(part.columns, part.bricks, strict=True):
                    _add(front, at, K[brick].T)
            for at, child in zip(part.halves, children, strict=True):
                _add(front, at, left.pop(child))
            own = part.own
            lower, failed = spotrf(np.asfortranarray(front[:own, :own]), lower=1, clean=0, overwrite_a=1)
            if failed:
                raise np.linalg.LinAlgError("the stiffness is not positive definite")
            across = strsm(1.0, lower, np.asfortranarray(front[own:, :own].T), lower=1)
            if own < n:
                rest = np.asfortranarray(front[own:, own:])
                left[i] = ssyrk(-1.0, across, 1.0, rest, trans=1, lower=1, overwrite_c=1)
            lowers.append(lower)
            acrosses.append(across)
        return Factors(self.parts, lowers, acrosses)

    def _divide(self, span: Span) -> tuple[int, ndarray]:
        """Number of the part of some columns, and the unknowns it leaves."""
        a, b, c, d = span
        outer = self._border(span)
        if (b - a) * (d - c) == 1:
            deep = self._counts[2]
            bricks = (a * self._counts[1] + c) * deep + np.arange(deep)
            every = np.unique(self._dofs[bricks])
            kids, kept = (), [every[every >= 0]]
        else:
            middle = (a + b) // 2 if b - a >= d - c else (c + d) // 2
            spans = ((a, middle, c, d), (middle, b, c, d)) if b - a >= d - c else (
                (a, b, c, middle), (a, b, middle, d)
            )  # fmt: skip
            kids, kept = zip(*(self._divide(half) for half in spans), strict=True)
            bricks = np.zeros(0, int)
        front = np.unique(np.concatenate(kept))
        inside = front[~np.isin(front, outer)]
        unknowns = np.concatenate([inside, front[np.isin(front, outer)]])
        self._at[unknowns] = np.arange(len(unknowns))
        columns = None if len(bricks) == 0 else self._at[self._dofs[bricks]]
        halves = () if len(bricks) else tuple(self._at[one] for one in kept)
        self._at[unknowns] = -1
        self.parts.append(Part(unknowns, len(inside), bricks, columns, halves))
        self._children.append(kids)
        return len(self.parts) - 1, unknowns[len(inside) :]

    def _border(self, span: Span) -> ndarray:
        """Unknowns on the cuts around some columns."""
        a, b, c, d = span
        u, (nx, ny, _) = self._unknown, self._counts
        box = u[2 * a : 2 * b + 1, 2 * c : 2 * d + 1]
        cuts = [
            box[[i]] for i, is_cut in ((0, a > 0), (-1, b < nx)) if is_cut
        ] + [box[:, [j]] for j, is_cut in ((0, c > 0), (-1, d < ny)) if is_cut]  # fmt: skip
        on = np.concatenate([cut.ravel() for cut in cuts]) if cuts else np.zeros(0, int)
        return np.unique(on[on >= 0])
