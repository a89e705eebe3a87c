"""Model of the stage that the fake GRBL controller drives, and its faults."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

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
        """Drop all moves at once, where it is.

        Returns:
            The speed that was cut off [mm/s].
        """
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
        """Run on to the end of this phase of constant acceleration, or for `seconds`; how long that was."""
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


MAX_LINE = 80
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))?")
_CODES = {"G0", "G1", "G4", "G17", "G20", "G21", "G53", "G54", "G90", "G91", "G94"}
_LETTERS = "GXYZFPM"
MM_PER_INCH = 25.4


class RefusalError(Exception):
    """`error:N`."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(slots=True)
class Modes:
    """Modes that a line leaves behind for the next, until a reset."""

    motion: str = "G0"
    inches: bool = False
    steps: bool = False
    feed_mm_min: float = 0.0


@dataclass(frozen=True, slots=True)
class Words:
    """Line of G-code: its codes, its numbers in the line's own unit, and its lengths in mm."""

    codes: tuple[str, ...]
    numbers: dict[str, float]

    def modes_after(self, before: Modes) -> Modes:
        """Modes from this line on."""
        after = Modes(before.motion, before.inches, before.steps, before.feed_mm_min)
        for code in self.codes:
            if code in ("G20", "G21"):
                after.inches = code == "G20"
            elif code in ("G90", "G91"):
                after.steps = code == "G91"
            elif code in ("G0", "G1"):
                after.motion = code
        if "F" in self.numbers:
            after.feed_mm_min = self.numbers["F"] * (MM_PER_INCH if after.inches else 1.0)
        return after

    def axes_mm(self, inches: bool) -> dict[str, float]:
        """The axis words [mm]."""
        scale = MM_PER_INCH if inches else 1.0
        return {axis: self.numbers[axis] * scale for axis in "XYZ" if axis in self.numbers}


def read_words(line: str) -> Words:
    """Read one line without its end.

    Raises:
        RefusalError: 1 a letter is missing, 2 a number cannot be read, 4 it is negative, 20 not known.
    """
    codes: list[str] = []
    numbers: dict[str, float] = {}
    text, at = line.upper().replace(" ", ""), 0
    while at < len(text):
        word = _WORD.match(text, at)
        if not word:
            raise RefusalError(1)
        letter, number = word[1], word[2]
        if letter not in _LETTERS:
            raise RefusalError(20)
        if number is None:
            raise RefusalError(2)
        if letter == "G":
            code = f"G{float(number):g}"
            if code not in _CODES:
                raise RefusalError(20)
            codes.append(code)
        elif letter != "M":
            if letter in "FP" and float(number) < 0:
                raise RefusalError(4)
            numbers[letter] = float(number)
        at = word.end()
    return Words(tuple(codes), numbers)


SETTINGS: dict[int, float] = {10: 3, 13: 0, 20: 1, 21: 0, 22: 1, 23: 0, 27: 1} | {
    first + axis: value
    for first, value in ((100, 250.0), (110, 1200.0), (120, 50.0), (130, 100.0))
    for axis in range(3)
}
"""Steps/mm, mm/min, mm/s^2 and mm of each axis, and the switches that matter here."""


@dataclass(frozen=True, slots=True)
class GrblModel:
    """The machine that is faked.

    Attributes:
        firmware: "1.1h" or "grblHAL".
        settings: that differ from `SETTINGS`.
        start_mm: where it stands when switched on, in the counts of a homed machine [mm].
        boot_s: from switching on to its banner; it hears nothing before [s].
        homed: as if homed before; else it is locked where $22 asks for homing.
        homing_s: how long homing takes [s].
        switches: whether homing finds them.
        hold_cancels_jog: a hold ends a jog at Idle, and not at Hold:0.
        latency_s: from a byte to its effect, for hold and jog cancel [s].
        offset_mm: of work coordinates [mm].
    """

    firmware: str = "1.1h"
    settings: Mapping[int, float] = field(default_factory=dict)
    start_mm: Millimetres = (-50.0, -50.0, -50.0)
    boot_s: float = 0.0
    homed: bool = False
    homing_s: float = 0.5
    switches: bool = True
    hold_cancels_jog: bool = True
    latency_s: float = 0.0
    offset_mm: Millimetres = NOWHERE


@dataclass(frozen=True, slots=True)
class GrblFaults:
    """Faults; none by default.

    Attributes:
        no_banner: it starts without one.
        boot_dump: `error:7` and the settings before the banner.
        mute: it hears, and says nothing.
        status_in_reply: a status report in the midst of every reply.
        lose_ok_of: a line that begins so is not answered.
        double_ok: every reply comes twice.
        idle_s: for so long after a move began it says Idle [s].
        restart_after_mm, stuck_after_mm, jump_after_mm: so far into its moves it restarts, stands still while
            it says that it runs, or finds its count off by `jump_mm` [mm].
        noise: bytes before every line.
    """

    no_banner: bool = False
    boot_dump: bool = False
    mute: bool = False
    status_in_reply: bool = False
    lose_ok_of: str = ""
    double_ok: bool = False
    idle_s: float = 0.0
    restart_after_mm: float = math.inf
    stuck_after_mm: float = math.inf
    jump_after_mm: float = math.inf
    jump_mm: Millimetres = NOWHERE
    noise: bytes = b""
