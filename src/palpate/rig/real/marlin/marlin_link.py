"""Serial link to a Marlin controller: one line in flight, one thread that reads.

Its `ok` names no line. After a lost `ok` or line the link sends a word that the controller repeats (M118);
everything before that word belongs to earlier lines.

Reference: Marlin's documentation of M110, M118, M410 and M112.

Lines of a Marlin controller: bytes in, small frozen records out. No port and no time.

Answers are `ok`, `Resend: N`, `echo:`, `Error:` and reports; `start` is said once, on booting. Lines that are
sent carry a number and a checksum, the exclusive or of their bytes, so that one damaged on its way is asked
for again and none is done twice.

Reference: Marlin's public documentation, marlinfw.org/docs/gcode: M110, M114, M115, M118, M211, M503; its
docs/Queue.md; RepRap's G-code page for number and checksum.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import reduce
from operator import xor

from palpate.core import DeviceError
from palpate.rig.real.gcode_stage import KEPT, CutOffError, GcodeLink, SilenceError
from palpate.rig.real.serial_port import SerialPort

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


MAX_LINE = 400  # bytes; what it is in one line is the longest, some 250
MAX_TRIES = 4  # of a line that is damaged on its way
QUICKSTOP, KILL = b"\nM410\n", b"\nM112\n"  # bare: an emergency parser hears them as they come
HALTED = "halted"  # in the last line of a controller that gave up


class MarlinLink(GcodeLink):
    """Sends lines, and tells what was heard.

    Args:
        port: an open serial port; this object closes it.
        reply_s: how long an answer may take [s].

    Attributes:
        starts: how often the controller said that it booted.
        resent: lines that were asked for again, or whose answer was lost.
    """

    def __init__(self, port: SerialPort, reply_s: float) -> None:
        super().__init__(port, reply_s, "marlin")
        self._heard: deque[Line] = deque(maxlen=KEPT)
        self._number, self._words = 0, 0
        self._sent: dict[int, str] = {}
        self._out_of_step = True
        self._rest = b""
        self.starts = self.resent = 0
        self._start()

    def begin(self) -> None:
        """Number lines from here on, after opening or a restart.

        The new number holds when the line is done, so that its `ok` is waited for before any other goes out.
        """
        with self._turn:
            self._number, self._sent = 0, {}
            with self._news:
                self._heard.clear()
            self._write(b"\n" + numbered(0, "M110 N0"))
            self._until_ok(None, self.halts)
            self._out_of_step = True

    def command(
        self, line: str, *, timeout_s: float | None = None, halts: int | None = None, moves: bool = False
    ) -> tuple[Line, ...]:
        """Send one line and wait until it was taken.

        Args:
            line: without number and end.
            timeout_s: for the answer, from the last sign of life; left out, the link's own [s].
            halts: the count of halts when this was asked for; if one came since, the line is not sent.
            moves: it can set something in motion.

        Returns:
            What was said between the line and its answer.
        """
        with self._turn:
            halts = self.halts if halts is None else halts
            if self._out_of_step:
                self._synchronise(halts)
            with self._writing:
                if self.halts != halts:
                    raise CutOffError("the stage was stopped before it was to move; ask again")
                self.restless = self.restless or moves
                self._out_of_step = True
                self._sent.clear()
                self._send(line)
            said, answered = self._until_ok(timeout_s, halts)
            if not answered:
                self.resent += 1
                said += self._synchronise(halts)
            with self._writing:
                self._out_of_step = self.halts != halts
            for one in said:
                if isinstance(one, Trouble):
                    raise DeviceError(
                        f"the stage's controller answered {line!r} with {one.text!r}", code="kinematics"
                    )
            return tuple(said)

    def halt(self) -> None:
        """Stop what moves, and recall lines not sent yet; waits for no answer."""
        with self._writing:
            self.halts += 1
            self._out_of_step = True
            with self._news:
                self._news.notify_all()
            if self.restless:
                self._write(QUICKSTOP)

    def kill(self) -> None:
        """Make the controller give up, its motors without current; only a reset brings it back."""
        self._write(KILL)

    def listen(self, timeout_s: float) -> bool:
        """Wait until the controller says that it booted; whether it did."""
        with self._news:
            return (
                bool(self._news.wait_for(lambda: self.starts > 0 or self.dead, timeout_s)) and not self.dead
            )

    def _send(self, line: str) -> None:
        self._number += 1
        self._sent[self._number] = line
        with self._news:
            self._heard.clear()
        self._write(numbered(self._number, line))

    def _until_ok(self, timeout_s: float | None, halts: int) -> tuple[list[Line], bool]:
        """What is said until an `ok`; and whether that can be believed to be the last line's."""
        said: list[Line] = []
        starts, wait_s = self.starts, self._reply_s if timeout_s is None else timeout_s
        end_s = time.monotonic() + wait_s
        while (line := self._next(end_s, halts, starts)) is not None:
            if isinstance(line, Busy):
                end_s = time.monotonic() + wait_s
            elif isinstance(line, LineTaken):
                return said, True
            elif isinstance(line, Resend):
                self._resend(line.number)
                return said, False
            else:
                said.append(line)
        return said, False

    def _synchronise(self, halts: int) -> list[Line]:
        """Say a word, and hear what comes until it is repeated and answered."""
        for _ in range(MAX_TRIES):
            self._words += 1
            word = f"palpate{self._words}"
            self._send(f"M118 {word}")
            said, repeated = self._until_word(word, halts)
            if repeated:
                return said
            self.resent += 1
        raise SilenceError("the stage's controller does not answer; if it moves, cut its power")

    def _until_word(self, word: str, halts: int) -> tuple[list[Line], bool]:
        said: list[Line] = []
        starts, repeated = self.starts, False
        end_s = time.monotonic() + self._reply_s
        while (line := self._next(end_s, halts, starts)) is not None:
            if isinstance(line, Busy):
                end_s = time.monotonic() + self._reply_s
            elif isinstance(line, Resend):
                self._resend(line.number)
            elif isinstance(line, Said) and line.text == word:
                repeated = True
            elif isinstance(line, LineTaken) and repeated:
                return said, True
            elif not isinstance(line, LineTaken):
                said.append(line)
        return said, False

    def _resend(self, number: int) -> None:
        """Send again the lines of this exchange from a number on, and none of before: those are done."""
        self.resent += 1
        if number < min(self._sent, default=0):
            with self._news:
                self.starts += 1
            return
        for one in range(number, self._number + 1):
            self._write(numbered(one, self._sent[one]))

    def _next(self, end_s: float, halts: int, starts: int) -> Line | None:
        """The next line heard; None where none came in time."""
        with self._news:
            self._news.wait_for(
                lambda: self._heard or self.dead or self.halts != halts or self.starts != starts,
                max(end_s - time.monotonic(), 0.0),
            )
            if self.dead:
                raise DeviceError(self.dead)
            if self.halts != halts or self.starts != starts:
                raise CutOffError("the stage was stopped, or its controller restarted, before it answered")
            return self._heard.popleft() if self._heard else None

    def _split(self, data: bytes) -> Iterator[bytes]:
        *lines, rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        self._rest = rest[:MAX_LINE]  # what is longer is no line of its, and stays cut
        return (raw for raw in lines if raw.strip())

    def _take(self, raw: bytes) -> None:
        line = read_line(raw)
        with self._news:
            if line is None:
                self.garbage += 1
            elif isinstance(line, Started):
                self.starts += 1
                self._out_of_step = True
            elif isinstance(line, Trouble) and HALTED in line.text.lower():
                self.dead = self.dead or (
                    f"the stage's controller gave up ({line.text}): see to the cause, reset it, open it anew"
                )
            else:
                self._heard.append(line)
            self._news.notify_all()
