"""Elimination of a symmetric stiffness group by group of its elements, by dense fronts in single precision.

Every element belongs to a group; groups are taken in order. An unknown enters the front with the first group
that has it and is eliminated with the last, so that a long body, or two that touch along their length, whose
groups follow that length, needs fronts as large as its cross-section only.

Reference: B. M. Irons, A frontal solution program for finite element analysis, International Journal for
Numerical Methods in Engineering 2 (1970), doi:10.1002/nme.1620020104.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.linalg.blas import ssyrk, strsm
from scipy.linalg.lapack import spotrf
from scipy.sparse import coo_array


@dataclass(frozen=True)
class Elements:
    """Some of one kind.

    Attributes:
        unknowns: of each, -1 of those that are held.
        group: of each, from 0.
    """

    unknowns: Int[ndarray, "e k"]
    stiffness: Float[ndarray, "e k k"]
    group: Int[ndarray, " e"]

    def of(self, group: int) -> tuple[Int[ndarray, "m k"], Float[ndarray, "m k k"]]:
        here = self.group == group
        return self.unknowns[here], self.stiffness[here]


@dataclass(frozen=True)
class Factors:
    """A stiffness after elimination: of every front its unknowns, how many of them it eliminated, their
    triangle and their hold on the others.
    """

    fronts: list[tuple[ndarray, int, ndarray, ndarray]]

    def solve(self, load: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        """Displacements under a load."""
        x = np.asarray(load, np.float32).copy()
        for unknowns, own, lower, across in self.fronts:
            mine, others = unknowns[:own], unknowns[own:]
            x[mine] = strsm(1.0, lower, x[mine, None], lower=1)[:, 0]
            x[others] -= across.T @ x[mine]
        for unknowns, own, lower, across in reversed(self.fronts):
            mine, others = unknowns[:own], unknowns[own:]
            known = x[mine] - across @ x[others]
            x[mine] = strsm(1.0, lower, known[:, None], lower=1, trans_a=1)[:, 0]
        return x.astype(np.float64)


def eliminated(kinds: list[Elements], size: int) -> Factors:
    """Eliminate `size` unknowns of all elements together."""
    groups = 1 + max(int(kind.group.max(initial=0)) for kind in kinds)
    first, last = _lives(kinds, size, groups)
    order = np.argsort(last, kind="stable")
    starts = np.searchsorted(last[order], np.arange(groups + 1))
    at = np.full(size + 1, -1)  # the last is of what is held
    left, carried, fronts = np.zeros(0, int), np.zeros((0, 0), np.float32), []
    for group in range(groups):
        later = order[starts[group] :]
        unknowns, own = later[first[later] <= group], int(starts[group + 1] - starts[group])
        at[unknowns], at[-1] = np.arange(len(unknowns)), len(unknowns)
        K = _assembled(kinds, group, at, len(unknowns))
        K.T[np.ix_(at[left], at[left])] += carried.T  # in the order in which both lie in memory
        at[unknowns] = -1
        if not own:
            left, carried = unknowns, K
            continue
        lower, failed = spotrf(np.asfortranarray(K[:own, :own]), lower=1, clean=0, overwrite_a=1)
        if failed:
            raise np.linalg.LinAlgError("the stiffness is not positive definite")
        left, across = unknowns[own:], K[own:, :own].T
        if len(left):  # of the last front nothing is
            across = strsm(1.0, lower, across, lower=1)
            carried = ssyrk(-1.0, across, 1.0, K[own:, own:], trans=1, lower=1)
        fronts.append((unknowns, own, lower, across))
    return Factors(fronts)


def _lives(kinds: list[Elements], size: int, groups: int) -> tuple[Int[ndarray, " n"], Int[ndarray, " n"]]:
    """First and last group of every unknown."""
    first, last = np.full(size, groups), np.full(size, -1)
    for kind in kinds:
        free = kind.unknowns >= 0
        group = np.broadcast_to(kind.group[:, None], free.shape)[free]
        np.minimum.at(first, kind.unknowns[free], group)
        np.maximum.at(last, kind.unknowns[free], group)
    return first, last


def _assembled(kinds: list[Elements], group: int, at: Int[ndarray, " u"], n: int) -> Float[ndarray, "n n"]:
    """A group's stiffness over the front."""
    rows, columns, values = [], [], []
    for kind in kinds:
        unknowns, stiffness = kind.of(group)
        i = at[unknowns].astype(np.int32)
        k = i.shape[1]
        rows.append(np.repeat(i, k, axis=1).ravel())
        columns.append(np.tile(i, (1, k)).ravel())
        values.append(stiffness.astype(np.float32).ravel())
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    # the last row and column are of what is held
    return coo_array(entries, (n + 1, n + 1)).toarray(order="F")[:n, :n]
