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
        start, target = np.array(self.start_m), np.array(self.target_m)
        if self.length_m == 0:
            return np.broadcast_to(start, (len(time_s), 3))
        share = self._gone(np.asarray(time_s, dtype=float)) / self.length_m
        return np.asarray(start + share[:, None] * (target - start))

    def _gone(self, time_s: Times) -> Times:
        braked = np.clip(time_s - self.stopped_s, 0, None) if self.stopped_s < math.inf else 0.0 * time_s
        gone = self._unstopped(np.minimum(time_s, self.stopped_s))
        if not braked.any():
            return gone
        v, a = self._speed(self.stopped_s), self.acceleration_m_s2
        braked = np.minimum(braked, v / a)
        return np.asarray(np.minimum(gone + v * braked - a * braked**2 / 2, self.length_m))

    def _unstopped(self, time_s: Times) -> Times:
        v, a, length = self.top_m_s, self.acceleration_m_s2, self.length_m
        whole = length / v + v / a
        t = np.clip(time_s - self.begun_s, 0, whole)
        up, down = np.minimum(t, v / a), np.clip(t - (whole - v / a), 0, None)
        steady = np.clip(t - v / a, 0, whole - 2 * v / a)
        return np.asarray(a * up**2 / 2 + v * steady + v * down - a * down**2 / 2)

    def _speed(self, time_s: float) -> float:
        v, a = self.top_m_s, self.acceleration_m_s2
        whole = self.length_m / v + v / a
        t = min(max(time_s - self.begun_s, 0.0), whole)
        return min(a * t, v, a * (whole - t))


def standing(at_m: Position, time_s: float) -> Motion:
    """No move at all."""
    return Motion(at_m, at_m, 1.0, 1.0, time_s)
