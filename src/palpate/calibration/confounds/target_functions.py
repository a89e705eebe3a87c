"""Targets that are functions of another target: certificates that are not independent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
