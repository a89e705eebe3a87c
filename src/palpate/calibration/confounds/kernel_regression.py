"""Kernel ridge regression on held-out rows, as a test of what some numbers predict of the labels.

Penalty and kernel are chosen inside each fold by the leave-one-out residual in closed form (R. M. Rifkin and
R. A. Lippert, Notes on regularized least squares, MIT-CSAIL-TR-2007-025).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from palpate.core import Float, Indices, Values

PENALTIES = np.logspace(-7, 1, 9)  # relative to the kernel's mean diagonal times the number of rows


@dataclass(frozen=True)
class Kernels:
    """Kernel matrices ``[n n]`` with a mean diagonal of 1: linear, and radial at one and a third of the
    median distance.
    """

    matrices: tuple[Float[np.ndarray, "n n"], ...]

    @classmethod
    def of(cls, features: Float[np.ndarray, "n p"]) -> Kernels:
        """The kernels of features as they are, so that what changes much counts more than noise does."""
        centred = np.asarray(features - features.mean(axis=0), np.float64)
        products = centred @ centred.T
        squares = np.diag(products)
        apart = np.maximum(squares[:, None] + squares - 2 * products, 0.0)
        typical = float(np.median(apart[~np.eye(len(apart), dtype=bool)])) or float(apart.mean())
        if not typical > 0:  # all rows are alike and tell nothing
            return cls((np.zeros_like(products),))
        radial = tuple(np.exp(-apart / (2 * scale * typical)) for scale in (1.0, 1 / 9))
        return cls((products / squares.mean(), *radial))

    def held_out(self, values: Values, folds: Sequence[Indices]) -> Values:
        """Return estimates ``[n t]`` of each row by regressions on the other folds; NaN for rows in none."""
        estimates = np.full(values.shape, np.nan)
        inside = np.sort(np.concatenate(list(folds)))
        for fold in folds:
            estimates[fold] = self.regressed(values, np.setdiff1d(inside, fold), fold)
        return estimates

    def regressed(self, values: Values, learnt: Indices, asked: Indices) -> Float[np.ndarray, "a t"]:
        """Return estimates of the rows asked ``[a t]``, by the least leave-one-out error."""
        mean = values[learnt].mean(axis=0)
        least = np.full(values.shape[1], np.inf)
        best = np.broadcast_to(mean, (len(asked), len(mean))).copy()
        for matrix in self.matrices:
            # By divide and conquer, which is the quickest where all vectors are wanted.
            squares, vectors = eigh(matrix[np.ix_(learnt, learnt)], driver="evd", check_finite=False)
            turned, across = vectors.T @ (values[learnt] - mean), matrix[np.ix_(asked, learnt)] @ vectors
            own = vectors**2
            for penalty in PENALTIES * len(learnt):
                shrunk = 1 / (np.maximum(squares, 0) + penalty)
                weights = vectors @ (shrunk[:, None] * turned)
                left = weights / (own @ shrunk)[:, None]
                error = np.mean(left**2, axis=0)
                better = error < least
                least[better] = error[better]
                best[:, better] = (mean + across @ (shrunk[:, None] * turned))[:, better]
        return best


def explained_share(values: Values, estimates: Values) -> Float[np.ndarray, " t"]:
    """Return R² of estimates over the rows that have any."""
    rows = np.isfinite(estimates).all(axis=1)
    truth, guess = values[rows], estimates[rows]
    spread = np.mean((truth - truth.mean(axis=0)) ** 2, axis=0)
    error = np.mean((truth - guess) ** 2, axis=0)
    return np.where(spread > 0, 1 - error / np.where(spread > 0, spread, 1.0), 0.0)


def interleaved_blocks(units: np.ndarray, folds: int = 5, rounds: int = 8) -> list[Indices]:
    """Return each fold's rows in short stretches of neighboring rows, dealt in turn, without empty folds.

    Args:
        units: unit of each row ``[n]``; stretches end where a unit does, or anywhere in a single unit.
        rounds: stretches per fold.
    """
    starts = np.flatnonzero(np.r_[True, units[1:] != units[:-1]])
    starts = starts if len(starts) > 1 else np.arange(len(units))
    number = np.searchsorted(starts, np.arange(len(units)), side="right") - 1
    stretches = min(folds * rounds, len(starts))
    fold = (number * stretches // len(starts)) % folds
    return [rows for k in range(folds) if (rows := np.flatnonzero(fold == k)).size]
