"""Labels against the order and the time of their rows: sorted labels, and labels shifted against images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from palpate.calibration.confounds.kernel_regression import Kernels, explained_share, interleaved_blocks
from palpate.core import Float, Indices, Int, Values

MAX_WAVES = 8
"""Cosines over the recording: they follow a sorted label and a slow change, and no press by itself."""
SHUFFLES = 499
LEVEL = 0.01
MIN_SHARE = 0.25
"""Share of a label's variance by its order below which it is of no account, however sure."""
MAX_LAG = 3
SHIFT_GAIN = 0.6
"""Squared error of labels taken from another row, over that of a row's own, below which rows are shifted."""
MIN_SHIFTED_SHARE = 0.2


@dataclass(frozen=True, slots=True)
class OrderCheck:
    """What the order of the rows tells of one label.

    Attributes:
        rank_correlation: Spearman's, of the label with the row's number [-1, 1].
        share: of the label's variance that a smooth function of order or time tells, adjusted for its
            freedom.
        level: share of shufflings of whole presses that tell as much.
        by_time: whether time tells more than the row's number.
    """

    rank_correlation: float
    share: float
    level: float
    by_time: bool

    @property
    def follows(self) -> bool:
        """True if order tells the label, beyond chance and by enough to matter."""
        return self.level <= LEVEL and self.share >= MIN_SHARE


def units_of(values: Values, groups: np.ndarray | None) -> Int[np.ndarray, " n"]:
    """Number of the unit that each row belongs to: what was recorded at one go, and is shuffled whole.

    Args:
        values: ``[n t]`` labels; without groups, neighbouring rows with equal labels are one unit.
        groups: ``[n]`` label of each row's group; None where each row is its own.
    """
    if groups is not None and len(np.unique(groups)) < len(groups):
        return np.unique(groups, return_inverse=True)[1].astype(np.int64)
    return np.r_[0, np.cumsum(np.any(values[1:] != values[:-1], axis=1))].astype(np.int64)


def order_checks(
    values: Values, units: Int[np.ndarray, " n"], times_s: Float[np.ndarray, " n"], seed: int = 0
) -> list[OrderCheck]:
    """Each label against the order of rows, and against time where it is another scale than order.

    The level is that of shuffling whole units: twenty rows, or five presses of a hundred frames, that happen
    to lie in order are no finding.

    Args:
        values: ``[n t]``.
        units: of each row, see `units_of`.
        times_s: of each row, not decreasing [s].
        seed: of the shufflings.
    """
    n = len(values)
    rank = (np.arange(n) + 0.5) / n
    places = [rank]
    span = float(np.ptp(times_s))
    if span > 0 and abs(np.corrcoef(rank, times_s)[0, 1]) < 0.999:
        places.append((times_s - times_s.min()) / span)
    bases = [_waves(place, min(MAX_WAVES, max(1, len(np.unique(units)) // 5))) for place in places]
    orders = _shuffled(units, np.random.default_rng(seed))
    checks = []
    for column in values.T:
        if not np.ptp(column) > 0:
            checks.append(OrderCheck(0.0, 0.0, 1.0, False))
            continue
        forms = np.column_stack([_standard(column), _standard(rankdata(column))])
        shares = [_share(basis, forms).max() for basis in bases]
        chance = np.max([_share(basis, form[orders].T) for basis in bases for form in forms.T], axis=0)
        level = (1 + np.sum(chance >= max(shares) - 1e-12)) / (1 + len(chance))
        correlation = float(np.corrcoef(rank, rankdata(column))[0, 1])
        checks.append(OrderCheck(correlation, float(max(shares)), float(level), bool(np.argmax(shares))))
    return checks


def _waves(place: Float[np.ndarray, " n"], count: int) -> Float[np.ndarray, "n k"]:
    """Orthonormal cosines over the recording, less their means."""
    waves = np.cos(np.pi * np.arange(1, count + 1) * place[:, None])
    return np.linalg.qr(waves - waves.mean(axis=0))[0]


def _share(basis: Float[np.ndarray, "n k"], columns: Float[np.ndarray, "n m"]) -> Float[np.ndarray, " m"]:
    """Adjusted R² of standardised columns on the basis."""
    n, k = basis.shape
    told = np.sum((basis.T @ columns) ** 2, axis=0) / n
    return 1 - (1 - told) * (n - 1) / max(n - k - 1, 1)


def _standard(column: np.ndarray) -> Float[np.ndarray, " n"]:
    return (column - column.mean()) / column.std()


def _shuffled(units: Int[np.ndarray, " n"], rng: np.random.Generator) -> Int[np.ndarray, "s n"]:
    """Rows in shuffled orders of their units, each unit's rows staying together in their order."""
    count = int(units.max()) + 1
    keys = rng.random((SHUFFLES, count)).argsort(axis=1).argsort(axis=1)
    return np.argsort(keys[:, units], axis=1, kind="stable")


@dataclass(frozen=True, slots=True)
class ShiftCheck:
    """Whether images fit the labels of other rows better than their own.

    Attributes:
        lag: rows by which the labels come later than their images; 0 where their own fit best.
        own, best: share of the labels' variance that images tell, of their own rows and at `lag`, averaged
            over the targets.
    """

    lag: int
    own: float
    best: float


def shift_check(kernels: Kernels, values: Values, rows: Indices) -> ShiftCheck:
    """Images against the labels of their own and of neighbouring rows.

    Args:
        kernels: of the images of `rows`.
        values: ``[n t]`` labels of all rows in their order.
        rows: which of them have their images here, ascending.
    """
    inside = (rows >= MAX_LAG) & (rows < len(values) - MAX_LAG)
    lags = np.arange(-MAX_LAG, MAX_LAG + 1)
    kept = np.flatnonzero(inside)
    t = values.shape[1]
    if len(kept) < 20:
        return ShiftCheck(0, float("nan"), float("nan"))
    shifted = np.full((len(rows), len(lags) * t), np.nan)
    shifted[kept] = np.concatenate([values[rows[kept] + lag] for lag in lags], axis=1)
    folds = [kept[fold] for fold in interleaved_blocks(np.arange(len(kept)), rounds=4)]
    shifted[~inside] = 0.0  # in no fold, and so in no regression
    estimates = kernels.held_out(shifted, folds)
    shares = explained_share(shifted, estimates).reshape(len(lags), t)
    own, best = shares[MAX_LAG], shares.mean(axis=1).argmax()
    found = shares[best]
    left = float(np.mean(1 - found) / np.mean(1 - np.minimum(own, 1.0)))
    sure = best != MAX_LAG and found.mean() >= MIN_SHIFTED_SHARE and left <= SHIFT_GAIN
    lag = int(lags[best]) if sure else 0
    return ShiftCheck(lag, float(own.mean()), float(found.mean()))


def sampled(count: int, most: int) -> Indices:
    """At most so many rows, evenly spaced in their order."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(np.int64))


def folds_among(folds: Sequence[Indices], rows: Indices) -> list[Indices]:
    """Places in `rows` of each fold's rows; folds without any are left out."""
    return [found for fold in folds if (found := np.flatnonzero(np.isin(rows, fold))).size]
