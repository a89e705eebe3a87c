"""Lines of a Marlin controller: bytes in, small frozen records out. No port and no time.

Answers are `ok`, `Resend: N`, `echo:`, `Error:` and reports; `start` is said once, on booting. Lines that are
sent carry a number and a checksum, the exclusive or of their bytes, so that one damaged on its way is asked
for again and none is done twice.

Reference: Marlin's public documentation, marlinfw.org/docs/gcode: M110, M114, M115, M118, M211, M503; its
docs/Queue.md; RepRap's G-code page for number and checksum.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from operator import xor

Triple = tuple[float, float, float]
_NUMBER = r"[-+]?\d+(?:\.\d+)?"
_OK = re.compile(r"ok(?:$|[ :])")
_RESEND = re.compile(r"(?:Resend|rs):? *N?:?(\d{1,10})$")
_POSITION = re.compile(rf"X: ?({_NUMBER}) Y: ?({_NUMBER}) Z: ?({_NUMBER}) (?:E: ?({_NUMBER}) )?Count (.*)")
_COUNTS = re.compile(r"X: ?(-?\d+) Y: ?(-?\d+) Z: ?(-?\d+)$")
_CAPABILITY = re.compile(r"Cap:(\w+):([01])$")
_SETTING = re.compile(r"(?:echo:)? *(M\d{1,3}) ([A-Z].*)")
_WORD = re.compile(rf"([A-Z])({_NUMBER})")
_ENDSTOPS = re.compile(
    rf"Min: +X({_NUMBER}) +Y({_NUMBER}) +Z({_NUMBER}) +Max: +X({_NUMBER}) +Y({_NUMBER}) +Z({_NUMBER})"
)
_MAX_SENT = 90  # bytes; the controller's stock line buffer has 96


@dataclass(frozen=True, slots=True)
class LineTaken:
    """A line was taken; not that what it asks for is done."""


@dataclass(frozen=True, slots=True)
class Resend:
    """The line of this number is to be sent again."""

    number: int


@dataclass(frozen=True, slots=True)
class Started:
    """The controller booted."""


@dataclass(frozen=True, slots=True)
class Busy:
    """It is at work on a line, and its answer is still to come."""


@dataclass(frozen=True, slots=True)
class StepReport:
    """Answer to M114.

    Attributes:
        planned_mm: where the last line sends it, not where it is [mm].
        counts: steps of X, Y and Z that were made, now.
        extruder_mm: logical position of the extruder; None for a build without one [mm].
    """

    planned_mm: Triple
    counts: tuple[int, int, int]
    extruder_mm: float | None = None


@dataclass(frozen=True, slots=True)
class Trouble:
    """An `Error:` line other than those that come with a resend."""

    text: str


@dataclass(frozen=True, slots=True)
class Said:
    """Any other line."""

    text: str


Line = LineTaken | Resend | Started | Busy | StepReport | Trouble | Said


def read_line(raw: bytes) -> Line | None:
    """Read one line without its end; None for one that is damaged.

    Example:
        >>> read_line(b"X:0.00 Y:127.00 Z:145.00 E:0.00 Count X: 0 Y:10160 Z:116000")
        StepReport(planned_mm=(0.0, 127.0, 145.0), counts=(0, 10160, 116000), extruder_mm=0.0)
        >>> read_line(b"Resend: 31")
        Resend(number=31)
    """
    try:
        text = raw.decode("ascii").strip()
    except UnicodeDecodeError:
        return None
    if _OK.match(text):
        return LineTaken()
    if found := _RESEND.match(text):
        return Resend(int(found[1]))
    if text == "start":
        return Started()
    if text.startswith(("echo:busy", "busy:")):
        return Busy()
    if found := _POSITION.match(text):
        return _place(found)
    if text.startswith("X:"):
        return None  # a place that lost a byte is none
    if text.startswith(("Error:", "!!")):
        return None if _asks_again(text) else Trouble(text)
    return Said(text)


def _place(found: re.Match[str]) -> StepReport | Trouble | None:
    counts = _COUNTS.match(found[5])
    if counts is None:
        if found[5].startswith("A:"):
            return Trouble(
                "it counts motors and not axes (CoreXY or the like), which this driver cannot drive"
            )
        return None
    x, y, z = (float(found[i]) for i in (1, 2, 3))
    a, b, c = (int(counts[i]) for i in (1, 2, 3))
    return StepReport((x, y, z), (a, b, c), None if found[4] is None else float(found[4]))


def _asks_again(text: str) -> bool:
    return any(why in text.lower() for why in ("checksum", "line number"))


def numbered(number: int, line: str) -> bytes:
    r"""A line as it is sent, with number, checksum and end.

    Raises:
        ValueError: it is not ASCII or too long.

    Example:
        >>> numbered(3, "M115")
        b'N3 M115*37\n'
    """
    body = f"N{number} {line}".encode("ascii")
    if len(body) > _MAX_SENT:
        raise ValueError(f"{line[:40]!r} is longer than {_MAX_SENT} bytes")
    return body + f"*{reduce(xor, body)}\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class MarlinMachine:
    """The settings that bear on motion.

    Attributes:
        steps_per_mm: M92.
        top_mm_s: M203.
        acceleration_mm_s2: M201, or M204's for travel where that is less.
        jerk_mm_s: M205's speeds that may change at once; None where the build has junction deviation instead.
        box_mm: M211's least and greatest place, which hold once it is homed; None where it has none.
        emergency_parser: M410 is heeded as it arrives.
    """

    steps_per_mm: Triple
    top_mm_s: Triple
    acceleration_mm_s2: Triple
    jerk_mm_s: Triple | None
    box_mm: tuple[Triple, Triple] | None
    emergency_parser: bool

    @classmethod
    def read(cls, settings: Iterable[str], endstops: Iterable[str], about: Iterable[str]) -> MarlinMachine:
        """Read the answers to M503, M211 and M115."""
        words: dict[str, dict[str, float]] = {}
        for text in settings:
            if found := _SETTING.match(text):
                words.setdefault(found[1], {}).update({k: float(v) for k, v in _WORD.findall(found[2])})
        limit = words.get("M204", {})
        travel = limit.get("T", limit.get("S", float("inf")))
        x, y, z = (min(value, travel) for value in _triple(words, "M201"))
        box = next((found for text in endstops if (found := _ENDSTOPS.search(text))), None)
        caps = {found[1]: found[2] for text in about if (found := _CAPABILITY.match(text))}
        return cls(
            _triple(words, "M92"),
            _triple(words, "M203"),
            (x, y, z),
            _triple(words, "M205") if {"X", "Y", "Z"} <= words.get("M205", {}).keys() else None,
            None if box is None else (_three(box, 1), _three(box, 4)),
            caps.get("EMERGENCY_PARSER") == "1",
        )

    def place_mm(self, counts: tuple[int, int, int]) -> Triple:
        """Where so many steps are [mm]."""
        x, y, z = (count / steps for count, steps in zip(counts, self.steps_per_mm, strict=True))
        return x, y, z

    @property
    def step_mm(self) -> float:
        """Longest step of any axis [mm]."""
        return 1.0 / min(self.steps_per_mm)

    @property
    def tolerance_mm(self) -> float:
        """Tolerance of a place: two of the longest steps, 0.01 mm at least [mm]."""
        return max(2.0 * self.step_mm, 0.01)


def _triple(words: dict[str, dict[str, float]], code: str) -> Triple:
    values = words.get(code, {})
    if not {"X", "Y", "Z"} <= values.keys() or min(values[axis] for axis in "XYZ") <= 0:
        raise ValueError(f"its settings (M503) have no {code} with X, Y and Z above 0")
    return values["X"], values["Y"], values["Z"]


def _three(found: re.Match[str], first: int) -> Triple:
    x, y, z = (float(found[first + i]) for i in range(3))
    return x, y, z
