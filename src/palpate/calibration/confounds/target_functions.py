"""Targets that are functions of another target: certificates that are not independent.

Kernel ridge regression on held-out rows, as a test of what some numbers predict of the labels.

Penalty and kernel are chosen inside each fold by the leave-one-out residual in closed form (R. M. Rifkin and
R. A. Lippert, Notes on regularized least squares, MIT-CSAIL-TR-2007-025).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from palpate.core import Bool, Float, Indices, Int, Values

EXACT = 0.02  # error relative to the target's range, within which a row is predicted
MIN_TOLD = 0.95  # ratio of predicted rows of a function
MISSED = 3  # presses that may be missed: a sign jumps between two of them
MAX_LEFT = 0.2  # ratio of unpredicted rows over that by the median alone
MIN_ROWS = 12
MAX_ROWS = 600


@dataclass(frozen=True, slots=True)
class TargetFunction:
    """Target that another one predicts.

    Attributes:
        target, of: its column, and that of the other.
        told: ratio of rows predicted within 2 % of its range.
        both_ways: the other is predicted by it, too.
    """

    target: str
    of: str
    told: float
    both_ways: bool


def target_functions(
    values: Values, names: Sequence[str], units: Int[np.ndarray, " n"], columns: Sequence[str] | None = None
) -> list[TargetFunction]:
    """Return targets that follow from one other.

    Args:
        values: labels ``[n t]``.
        units: press of each row ``[n]``; a row is predicted from other presses only.
        columns: label column of each target, where several are of one, as a direction's cosine and sine.
    """
    columns = tuple(columns or names)
    values, first = np.unique(values, axis=0, return_index=True)  # a row told by its copy is no function
    shuffled = np.random.default_rng(0).permutation(len(first))  # so that no order decides between equals
    values, units = values[shuffled], units[first][shuffled]
    if len(np.unique(units)) < MIN_ROWS or values.shape[1] < 2:
        return []
    rows = np.unique(np.linspace(0, len(values) - 1, min(MAX_ROWS, len(values))).astype(np.int64))
    values, units = values[rows], units[rows]
    count = values.shape[1]
    told = np.zeros((count, count))
    for of in range(count):
        for target in range(count):
            if columns[of] != columns[target]:
                guess = _along(values[:, of], values[:, target], units)
                told[of, target] = _told(values[:, target], guess, len(np.unique(units)))
    found: list[TargetFunction] = []
    for target in range(count):
        of = int(told[:, target].argmax())
        if told[of, target] > 0 and not any(f.both_ways and f.of == names[target] for f in found):
            both = bool(told[target, of] > 0)
            found.append(TargetFunction(names[target], names[of], float(told[of, target]), both))
    return found


def _along(
    of: Float[np.ndarray, " n"], target: Float[np.ndarray, " n"], units: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Each row's target between those of its neighbours along another, of other presses; NaN at the ends."""
    order = np.argsort(of, kind="stable")
    before = _last_of_another(units[order])
    after = len(of) - 1 - _last_of_another(units[order[::-1]])[::-1]
    inner = np.flatnonzero((before >= 0) & (after < len(of)))
    x, y, low, high = of[order], target[order], before[inner], after[inner]
    span = x[high] - x[low]
    share = np.where(span > 0, (x[inner] - x[low]) / np.where(span > 0, span, 1.0), 0.5)
    guess = np.full(len(of), np.nan)
    guess[order[inner]] = y[low] + share * (y[high] - y[low])
    return guess


def _last_of_another(units: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Place of the last element before each that is of another unit; −1 where there is none."""
    begins = np.r_[True, units[1:] != units[:-1]]
    return np.maximum.accumulate(np.where(begins, np.arange(len(units)), 0)) - 1


def _told(target: Float[np.ndarray, " n"], guess: Float[np.ndarray, " n"], units: int) -> float:
    """Share of rows told, 0 where that makes no function of it."""
    rows = np.flatnonzero(np.isfinite(guess))
    share = float(_misses(target, guess, rows).mean())
    return 1 - share if share <= _most_missed(target, units, rows) else 0.0


def _misses(
    target: Float[np.ndarray, " n"], guess: Float[np.ndarray, " n"], rows: Indices
) -> Bool[np.ndarray, " m"]:
    missed: Bool[np.ndarray, " m"] = np.abs(guess[rows] - target[rows]) > EXACT * np.ptp(target)
    return missed


def _most_missed(target: Float[np.ndarray, " n"], units: int, rows: Indices) -> float:
    asked = target[rows]
    by_median = float(np.mean(np.abs(asked - np.median(asked)) > EXACT * np.ptp(target)))
    return min(max(1 - MIN_TOLD, MISSED / units), MAX_LEFT * by_median)


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
