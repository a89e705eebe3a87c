"""Units of a recording: what was recorded at one go, and is held out, counted and shuffled whole."""

from __future__ import annotations

from dataclasses import dataclass
from math import lgamma, log
from typing import Literal

import numpy as np

from palpate.core import Bool, Float, Int, Values

MIN_ORDERS = 200
"""Orders of the units from which the one that lies there can be told from chance, at a level of 1 % and with
each order as good as its mirror image: 6 units of one session have 720, and 5 have 120."""
JITTER_SHARE = 2 / 3
"""Share of the changes from row to row, the least ones, that are taken for jitter within a hold."""
JUMP = 9.0
"""A change over the mean of these that begins another hold: six standard deviations of normal jitter."""
MAX_JITTER = 0.2
"""Jitter over the label's standard deviation, above which no hold can be told from others."""
MIN_ALTERNATING = 0.5
"""Mean square change over the variance within holds: 2 where jitter is independent, nearly 0 of a slope."""

Kind = Literal["presses", "stretches of nearly equal labels", "rows"]


@dataclass(frozen=True, slots=True)
class RecordedUnits:
    """Groups of rows acquired without interruption.

    Attributes:
        of, sessions: ``[n]`` number of each row's unit and session; no unit is of two sessions.
        kind: source of the units: a column, or the labels.
        in_recorded_order: whether rows lie in the order in which they were recorded.
    """

    of: Int[np.ndarray, " n"]
    sessions: Int[np.ndarray, " n"]
    kind: Kind
    in_recorded_order: bool = True

    @property
    def count(self) -> int:
        """How many units there are."""
        return len(np.unique(self.of))

    @property
    def in_sessions(self) -> Int[np.ndarray, " s"]:
        """How many there are of each session."""
        return np.array([len(np.unique(self.of[self.sessions == s])) for s in np.unique(self.sessions)])

    @property
    def can_be_ordered(self) -> bool:
        """True if the units have enough orders, each within its session, that theirs can be a finding."""
        return self.in_recorded_order and have_orders(self.in_sessions)


def have_orders(counts: Int[np.ndarray, " s"]) -> bool:
    """True if so many units of each session can be put in enough orders."""
    return sum(lgamma(int(count) + 1) for count in counts) >= log(MIN_ORDERS)


def recorded_units(
    values: Values, groups: np.ndarray | None = None, sessions: np.ndarray | None = None
) -> RecordedUnits:
    """Units by the groups that a column names, else by the labels.

    Without groups, neighboring rows whose labels differ by no more than a hold's jitter are one unit, or,
    where there are no holds, those with equal labels.

    Args:
        values: ``[n t]`` labels, rows of a session in the order they were taken.
        groups: ``[n]`` label of each row's group; None, or each row its own, where no column says.
        sessions: ``[n]`` label of each row's session; None where there is one.
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
    """True if stretches are holds and not pieces of a slope: changes between them exceed those within.

    With too few to test their order, a hold that creeps and a piece of a sorted table look the same, and rows
    are tested by themselves.
    """
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
