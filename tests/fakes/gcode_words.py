"""Lines of G-code as the fake GRBL controller reads them: words, modes, and what it refuses."""

from __future__ import annotations

import re
from dataclasses import dataclass

MAX_LINE = 80
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))?")
_CODES = {"G0", "G1", "G4", "G17", "G20", "G21", "G53", "G54", "G90", "G91", "G94"}
_LETTERS = "GXYZFPMS"
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
    spindle: float = 0.0


@dataclass(frozen=True, slots=True)
class Words:
    """Line of G-code: its codes, its numbers in the line's own unit, and its lengths in mm."""

    codes: tuple[str, ...]
    numbers: dict[str, float]

    def modes_after(self, before: Modes) -> Modes:
        """Modes from this line on."""
        after = Modes(before.motion, before.inches, before.steps, before.feed_mm_min, before.spindle)
        for code in self.codes:
            if code in ("G20", "G21"):
                after.inches = code == "G20"
            elif code in ("G90", "G91"):
                after.steps = code == "G91"
            elif code in ("G0", "G1"):
                after.motion = code
        if "F" in self.numbers:
            after.feed_mm_min = self.numbers["F"] * (MM_PER_INCH if after.inches else 1.0)
        after.spindle = self.numbers.get("S", after.spindle)
        return after

    def axes_mm(self, inches: bool) -> dict[str, float]:
        """The axis words [mm]."""
        scale = MM_PER_INCH if inches else 1.0
        return {axis: self.numbers[axis] * scale for axis in "XYZ" if axis in self.numbers}


def read_words(line: str) -> Words:
    """Read one line without its end."""
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
            if letter in "FPS" and float(number) < 0:
                raise RefusalError(4)
            numbers[letter] = float(number)
        at = word.end()
    return Words(tuple(codes), numbers)
