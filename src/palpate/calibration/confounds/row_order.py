"""Labels against the order and the time of their rows: sorted labels, and labels shifted against images.

Units of a recording: what was recorded at one go, and is held out, counted and shuffled whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import lgamma, log
from typing import Literal

import numpy as np
from scipy.stats import rankdata

from palpate.calibration.confounds.target_functions import Kernels, explained_share, interleaved_blocks
from palpate.core import Bool, Float, Indices, Int, Values

MIN_ORDERS = 200  # unit orders for a level of 1 %: 6 units of one session have 720, and 5 have 120
JITTER_SHARE = 2 / 3  # ratio of the smallest row-to-row changes that are jitter within a hold
JUMP = 9.0  # change over mean jitter that begins another hold: six normal standard deviations
MAX_JITTER = 0.2  # jitter over the label's standard deviation, above which holds are not separable
MIN_ALTERNATING = 0.5  # squared change over variance within holds: 2 for jitter, 0 for a slope

Kind = Literal["presses", "stretches of nearly equal labels", "rows"]


@dataclass(frozen=True, slots=True)
class RecordedUnits:
    """Groups of rows acquired without interruption.

    Attributes:
        of, sessions: number of each row's unit and session ``[n]``; no unit spans two sessions.
        kind: source of the units: a column, or the labels.
    """

    of: Int[np.ndarray, " n"]
    sessions: Int[np.ndarray, " n"]
    kind: Kind
    in_recorded_order: bool = True

    @property
    def count(self) -> int:
        return len(np.unique(self.of))

    @property
    def in_sessions(self) -> Int[np.ndarray, " s"]:
        return np.array([len(np.unique(self.of[self.sessions == s])) for s in np.unique(self.sessions)])

    @property
    def can_be_ordered(self) -> bool:
        """True if the units have enough orders, each within its session, that theirs can be a finding."""
        return self.in_recorded_order and have_orders(self.in_sessions)


def have_orders(counts: Int[np.ndarray, " s"]) -> bool:
    """Return whether so many units of each session have enough orders."""
    return sum(lgamma(int(count) + 1) for count in counts) >= log(MIN_ORDERS)


def recorded_units(
    values: Values, groups: np.ndarray | None = None, sessions: np.ndarray | None = None
) -> RecordedUnits:
    """Return units by the groups that a column names, else by the labels.

    Without groups, neighboring rows whose labels differ by at most a hold's jitter are one unit or, without
    holds, those with equal labels.

    Args:
        values: labels ``[n t]``, rows of a session in temporal order.
        groups, sessions: group and session of each row ``[n]``; None where no column states it.
    """
    n = len(values)
    of_session = np.zeros(n, np.int64) if sessions is None else _numbered(sessions)
    if groups is not None and len(np.unique(groups)) < n:
        number = _numbered(groups)
        whole = _numbered(of_session * (number.max() + 1) + number)
        return RecordedUnits(whole, of_session, "presses")
    by_session = np.argsort(of_session, kind="stable")
    begins, kind = _beginnings(values[by_session], of_session[by_session])
    of = np.empty(n, np.int64)
    of[by_session] = np.cumsum(begins) - 1
    return RecordedUnits(of, of_session, kind)


def _numbered(labels: np.ndarray) -> Int[np.ndarray, " n"]:
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


def _beginnings(values: Values, sessions: Int[np.ndarray, " n"]) -> tuple[Bool[np.ndarray, " n"], Kind]:
    """Where units begin, and what they are; rows of a session stand together."""
    another = np.r_[True, sessions[1:] != sessions[:-1]]
    changes = np.abs(np.diff(values, axis=0, prepend=values[:1]))
    equal = another | np.any(changes > 0, axis=1)
    begins = another | np.any(changes > _jitter_limits(values, changes[~another]), axis=1)
    if begins.sum() < equal.sum() and _are_holds(values, begins, another, sessions):
        return begins, "stretches of nearly equal labels"
    return equal, "rows" if equal.all() else "stretches of nearly equal labels"


def _jitter_limits(values: Values, changes: Float[np.ndarray, "m t"]) -> Float[np.ndarray, " t"]:
    """Change of each label up to which a hold goes on; 0 of a label whose changes are no jitter."""
    least = np.sort(changes, axis=0)[: max(1, int(JITTER_SHARE * len(changes)))]
    if not len(changes):
        return np.zeros(values.shape[1])
    jitter = least.mean(axis=0)
    return np.where(jitter <= MAX_JITTER * values.std(axis=0), JUMP * jitter, 0.0)


def _are_holds(
    values: Values, begins: Bool[np.ndarray, " n"], another: Bool[np.ndarray, " n"], sessions: np.ndarray
) -> bool:
    """Whether stretches are holds and not pieces of a slope: changes between them exceed those within."""
    of = np.cumsum(begins) - 1
    starts = np.flatnonzero(begins)
    scaled = values / np.where(np.ptp(values, axis=0) > 0, np.ptp(values, axis=0), 1.0)
    range_of = (np.maximum.reduceat(scaled, starts) - np.minimum.reduceat(scaled, starts)).max(axis=1)
    changes = np.diff(scaled, axis=0, prepend=scaled[:1])
    jumps = np.abs(changes[begins & ~another]).max(axis=1)
    if not len(jumps) or np.median(jumps) <= np.median(range_of[of]):
        return False
    if have_orders(np.array([len(np.unique(of[sessions == s])) for s in np.unique(sessions)])):
        return True
    lengths = np.bincount(of)
    centred = scaled - (np.add.reduceat(scaled, starts) / lengths[:, None])[of]
    return bool(np.sum(changes[~begins] ** 2) >= MIN_ALTERNATING * np.sum(centred**2))


MAX_WAVES = 8  # cosines over the recording: a sorted label and slow changes, no single press
SHUFFLES = 499
LEVEL = 0.01
MIN_SHARE = 0.25  # R² of order below which it is irrelevant, however significant
MAX_LAG = 3
SHIFT_GAIN = 0.6  # squared error at another row over that of a row's own, below which rows are shifted
MIN_SHIFTED_SHARE = 0.2


@dataclass(frozen=True, slots=True)
class OrderCheck:
    """Prediction of one label by the temporal order of the rows.

    Attributes:
        rank_correlation: Spearman's, of label and row number within sessions, -1 to 1.
        share: adjusted R² within sessions of a smooth function of order or time.
        level: ratio of shufflings of whole units within their session that do as well.
        by_time: time predicts more than the row number.
        asked: there are enough units for their order to be a finding.
    """

    rank_correlation: float
    share: float
    level: float
    by_time: bool
    units: Kind = "presses"
    asked: bool = True
    sessions: int = 1

    @property
    def follows(self) -> bool:
        """True if order tells the label, beyond chance and by enough to matter."""
        return self.asked and self.level <= LEVEL and self.share >= MIN_SHARE


def order_checks(
    values: Values, units: RecordedUnits, times_s: Float[np.ndarray, " n"], seed: int = 0
) -> list[OrderCheck]:
    """Test each label against row order, and against time where its scale differs.

    Labels are taken less their session's mean and fitted by one shared curve or one per session. The level is
    that of shuffling whole units within their session.

    Args:
        values: labels ``[n t]``.
        times_s: time of each row, not decreasing within a session [s].
    """
    by_session = np.argsort(units.sessions, kind="stable")
    values, of, times_s = values[by_session], units.of[by_session], times_s[by_session]
    sessions = units.sessions[by_session]
    parts = [np.flatnonzero(sessions == s) for s in range(int(sessions[-1]) + 1)]
    rank, time = np.empty(len(values)), np.empty(len(values))
    for part in parts:
        rank[part] = (np.arange(len(part)) + 0.5) / len(part)
        span = float(np.ptp(times_s[part]))
        time[part] = (times_s[part] - times_s[part].min()) / span if span > 0 else rank[part]
    other_scale = np.ptp(times_s) > 0 and abs(np.corrcoef(rank, time)[0, 1]) < 0.999
    places = [rank, time] if other_scale else [rank]
    bases = [basis for place in places for basis in _bases(place, parts, units.in_sessions)]
    of_time = len(bases) // len(places)
    orders = _shuffled(of, sessions, np.random.default_rng(seed))
    check = partial(OrderCheck, units=units.kind, asked=units.can_be_ordered, sessions=len(parts))
    checks = []
    for column in values.T:
        centred, ranks = _within(column, parts), _within(column, parts, ranked=True)
        if not np.ptp(centred) > 0:
            checks.append(check(0.0, 0.0, 1.0, False))
            continue
        forms = np.column_stack([_standard(centred), _standard(ranks)])
        shares = [_share(basis, forms, len(parts)).max() for basis in bases]
        chance = np.max(
            [_share(basis, form[orders].T, len(parts)) for basis in bases for form in forms.T], axis=0
        )
        level = (1 + np.sum(chance >= max(shares) - 1e-12)) / (1 + len(chance))
        correlation = float(np.corrcoef(rank, ranks)[0, 1])
        by_time = bool(np.argmax(shares) >= of_time)
        checks.append(check(correlation, float(max(shares)), float(level), by_time))
    return checks


def _bases(
    place: Float[np.ndarray, " n"], parts: Sequence[Indices], units: Int[np.ndarray, " s"]
) -> list[Float[np.ndarray, "n k"]]:
    shared = _waves(place, _wave_count(int(units.sum())), parts)
    if len(parts) == 1:
        return [shared]
    own = []
    for part, count in zip(parts, units, strict=True):
        if count > 1:
            waves = np.zeros((len(place), _wave_count(int(count))))
            waves[part] = _waves(place[part], waves.shape[1], [np.arange(len(part))])
            own.append(waves)
    return [shared, np.concatenate(own, axis=1)] if own else [shared]


def _wave_count(units: int) -> int:
    return min(MAX_WAVES, max(1, units // 5))


def _waves(place: Float[np.ndarray, " n"], count: int, parts: Sequence[Indices]) -> Float[np.ndarray, "n k"]:
    waves = np.cos(np.pi * np.arange(1, count + 1) * place[:, None])
    for part in parts:
        waves[part] -= waves[part].mean(axis=0)
    return np.linalg.qr(waves)[0]


def _within(
    column: Float[np.ndarray, " n"], parts: Sequence[Indices], ranked: bool = False
) -> Float[np.ndarray, " n"]:
    within = np.empty(len(column))
    for part in parts:
        own = rankdata(column[part]) / len(part) if ranked else column[part]
        within[part] = own - own.mean()
    return within


def _share(
    basis: Float[np.ndarray, "n k"], columns: Float[np.ndarray, "n m"], sessions: int
) -> Float[np.ndarray, " m"]:
    n, k = basis.shape
    told = np.sum((basis.T @ columns) ** 2, axis=0) / n
    return 1 - (1 - told) * (n - sessions) / max(n - k - sessions, 1)


def _standard(column: np.ndarray) -> Float[np.ndarray, " n"]:
    return (column - column.mean()) / column.std()


def _shuffled(
    units: Int[np.ndarray, " n"], sessions: Int[np.ndarray, " n"], rng: np.random.Generator
) -> Int[np.ndarray, "s n"]:
    count = int(units.max()) + 1
    keys = rng.random((SHUFFLES, count)).argsort(axis=1).argsort(axis=1)
    return np.argsort(keys[:, units] + count * sessions, axis=1, kind="stable")


@dataclass(frozen=True, slots=True)
class ShiftCheck:
    """Whether images fit the labels of other rows better than their own.

    Attributes:
        lag: rows by which labels come later than their images; 0 where their own fit best.
        own, best: mean R² of their own rows' labels, and of those at `lag`.
    """

    lag: int
    own: float
    best: float


def shift_check(kernels: Kernels, values: Values, rows: Indices) -> ShiftCheck:
    """Compare images with the labels of their own and of neighboring rows.

    Args:
        kernels: of the images of `rows`.
        values: labels of all rows in their order ``[n t]``.
        rows: ascending rows that have their images here.
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
    """Return at most so many rows, evenly spaced in their order."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(np.int64))


def folds_among(folds: Sequence[Indices], rows: Indices) -> list[Indices]:
    """Return the positions in `rows` of each fold's rows, without empty folds."""
    return [found for fold in folds if (found := np.flatnonzero(np.isin(rows, fold))).size]


def told_by_neighbors(values: Float[np.ndarray, " n"], folds: Sequence[Indices]) -> float:
    """Return R² of a label interpolated between the trained rows nearest in order."""
    every, told = np.arange(len(values)), np.empty(len(values))
    for fold in folds:
        others = np.setdiff1d(every, fold)
        told[fold] = np.interp(fold, others, values[others])
    variance = float(np.var(values))
    return 1 - float(np.mean((told - values) ** 2)) / variance if variance > 0 else 0.0
