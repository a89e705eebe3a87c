"""Motion of the stage that the fake GRBL controller drives: a queue of moves, with acceleration and holds."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

Millimetres = tuple[float, float, float]
NOWHERE: Millimetres = (0.0, 0.0, 0.0)
_NEGLIGIBLE = 1e-9  # of a duration [s]
_SMALL_MM = 1e-9  # what is left to brake for; a place in mm is no finer than 1e-14
_SAME = 1e-9  # speeds that differ by this part are one


@dataclass(slots=True)
class PlannedBlock:
    """Move in the planner; it starts and ends at a stand.

    Attributes:
        start_mm, end_mm: [mm].
        speed_mm_s: cruising speed [mm/s].
    """

    start_mm: Millimetres
    end_mm: Millimetres
    speed_mm_s: float

    @property
    def length_mm(self) -> float:
        return math.dist(self.start_mm, self.end_mm)

    def place_mm(self, along_mm: float) -> Millimetres:
        """The place so far along [mm]."""
        part = along_mm / self.length_mm if self.length_mm > 0 else 1.0
        x, y, z = (a + part * (b - a) for a, b in zip(self.start_mm, self.end_mm, strict=True))
        return x, y, z


class Axes:
    """A queue of blocks, run one after the other; a hold slows down to a stand.

    Args:
        acceleration_mm_s2: of every move, up and down [mm/s^2].
        place_mm: where it stands at first [mm].
    """

    def __init__(self, acceleration_mm_s2: float, place_mm: Millimetres) -> None:
        self.acceleration_mm_s2 = acceleration_mm_s2
        self.blocks: deque[PlannedBlock] = deque()
        self.speed_mm_s = 0.0
        self.along_mm = 0.0
        self.holding = False
        self.stuck = False
        self._stood_mm = place_mm

    @property
    def place_mm(self) -> Millimetres:
        """Place now [mm]."""
        return self.blocks[0].place_mm(self.along_mm) if self.blocks else self._stood_mm

    @property
    def end_mm(self) -> Millimetres:
        """Place when all is done [mm]."""
        return self.blocks[-1].end_mm if self.blocks else self._stood_mm

    def add(self, block: PlannedBlock) -> None:
        """Queue a block; one of no length is no block."""
        if block.length_mm > 0:
            self.blocks.append(block)

    def clear(self) -> float:
        """Drop all moves at once, where it is."""
        self._stood_mm, speed = self.place_mm, self.speed_mm_s
        self.blocks.clear()
        self.speed_mm_s = self.along_mm = 0.0
        self.holding = False
        return speed

    def put(self, place_mm: Millimetres) -> None:
        """Count from here on as if it stood there [mm]."""
        self.clear()
        self._stood_mm = place_mm

    def shift(self, by_mm: Millimetres) -> None:
        """Miscount: all places are off by so much from here on [mm]."""
        self._stood_mm = add_mm(self._stood_mm, by_mm)
        for block in self.blocks:
            block.start_mm, block.end_mm = add_mm(block.start_mm, by_mm), add_mm(block.end_mm, by_mm)

    def advance(self, seconds: float) -> None:
        """Let time go by [s]."""
        while seconds > _NEGLIGIBLE and self.blocks and not self.stuck:
            seconds -= self._phase(seconds)
            block = self.blocks[0]
            if block.length_mm - self.along_mm <= _SMALL_MM and self.speed_mm_s < 1e-4:
                self._stood_mm = block.end_mm
                self.blocks.popleft()
                self.speed_mm_s = self.along_mm = 0.0
            if self.holding and self.speed_mm_s == 0.0:
                return

    def _phase(self, seconds: float) -> float:
        a, v, block = self.acceleration_mm_s2, self.speed_mm_s, self.blocks[0]
        left = max(block.length_mm - self.along_mm, 0.0)
        top = min(
            block.speed_mm_s, math.sqrt(a * left + v * v / 2)
        )  # the peak from which it just stops in time
        braking = v * v / (2 * a)
        if self.holding or left - braking <= _SMALL_MM:
            rate, lasts = -a, v / a
        elif v < top * (1 - _SAME):
            rate, lasts = a, (top - v) / a
        else:
            rate, lasts = 0.0, (left - braking) / v
        ends = lasts <= seconds
        t = min(lasts, seconds)
        self.along_mm = min(self.along_mm + v * t + rate * t * t / 2, block.length_mm)
        self.speed_mm_s = v + rate * t
        if ends and rate < 0:
            self.speed_mm_s = 0.0
            if not self.holding:
                self.along_mm = block.length_mm
        elif ends and rate > 0:
            self.speed_mm_s = top
        return max(t, _NEGLIGIBLE)


def add_mm(a: Millimetres, b: Millimetres) -> Millimetres:
    """Their sum, axis by axis [mm]."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def in_words(place_mm: Millimetres) -> str:
    """A place as the controller prints it."""
    return "{:.3f},{:.3f},{:.3f}".format(*place_mm)
