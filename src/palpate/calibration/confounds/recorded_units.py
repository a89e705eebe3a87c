"""Units of a recording: what was recorded at one go, and is held out, counted and shuffled whole."""

from __future__ import annotations

from dataclasses import dataclass
from math import lgamma, log
from typing import Literal

import numpy as np

from palpate.core import Bool, Float, Int, Values

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
