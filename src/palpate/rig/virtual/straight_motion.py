"""A straight move with finite acceleration: where it is at any time, and how it ends when it is told to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, Position, ndarray

Times = Float[ndarray, " n"]
Places = Float[ndarray, "n 3"]


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion up to speed, along, and down again; a stand where start and target are one.

    Attributes:
        start_m, target_m: from and to [m].
        speed_m_s, acceleration_m_s2: at most.
        begun_s: when [s].
        stopped_s: when it began to slow down on request; never, as a rule.
    """

    start_m: Position
    target_m: Position
    speed_m_s: float
    acceleration_m_s2: float
    begun_s: float
    stopped_s: float = math.inf

    @property
    def length_m(self) -> float:
        """Length from start to target [m]."""
        return math.dist(self.start_m, self.target_m)

    @property
    def top_m_s(self) -> float:
        """The speed it reaches."""
        return min(self.speed_m_s, math.sqrt(self.length_m * self.acceleration_m_s2))

    @property
    def ends_s(self) -> float:
        """Time when it stands [s]."""
        if self.length_m == 0:
            return self.begun_s
        v, a = self.top_m_s, self.acceleration_m_s2
        ends = self.begun_s + self.length_m / v + v / a
        if self.stopped_s >= ends:
            return ends
        return self.stopped_s + self._speed(self.stopped_s) / a

    def at(self, time_s: Times) -> Places:
        """Places at times [m]."""
        return np.array([self.place_m(one) for one in time_s.tolist()]).reshape(-1, 3)

    def place_m(self, time_s: float) -> Position:
        """Place at a time [m]: in plain numbers, since a stage is asked for it at every look of its guard."""
        if self.length_m == 0:
            return self.start_m
        share = self._gone(time_s) / self.length_m
        x, y, z = (a + share * (b - a) for a, b in zip(self.start_m, self.target_m, strict=True))
        return x, y, z

    def _gone(self, time_s: float) -> float:
        gone = self._unstopped(min(time_s, self.stopped_s))
        if time_s <= self.stopped_s:
            return gone
        v, a = self._speed(self.stopped_s), self.acceleration_m_s2
        braked = min(time_s - self.stopped_s, v / a)
        return min(gone + v * braked - a * braked**2 / 2, self.length_m)

    def _unstopped(self, time_s: float) -> float:
        v, a = self.top_m_s, self.acceleration_m_s2
        whole = self.length_m / v + v / a
        t = min(max(time_s - self.begun_s, 0.0), whole)
        up, down = min(t, v / a), max(t - (whole - v / a), 0.0)
        steady = min(max(t - v / a, 0.0), whole - 2 * v / a)
        return a * up**2 / 2 + v * steady + v * down - a * down**2 / 2

    def _speed(self, time_s: float) -> float:
        v, a = self.top_m_s, self.acceleration_m_s2
        whole = self.length_m / v + v / a
        t = min(max(time_s - self.begun_s, 0.0), whole)
        return min(a * t, v, a * (whole - t))


def standing(at_m: Position, time_s: float) -> Motion:
    """No move at all."""
    return Motion(at_m, at_m, 1.0, 1.0, time_s)
