"""Serial link to a Marlin controller: one line in flight, one thread that reads.

Its `ok` names no line. After a lost `ok` or line the link sends a word that the controller repeats (M118);
everything before that word belongs to earlier lines.

Reference: Marlin's documentation of M110, M118, M410 and M112.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator

from palpate.core import DeviceError
from palpate.rig.real.gcode_link import KEPT, CutOffError, GcodeLink, SilenceError
from palpate.rig.real.marlin.marlin_lines import (
    Busy,
    Line,
    LineTaken,
    Resend,
    Said,
    Started,
    Trouble,
    numbered,
    read_line,
)
from palpate.rig.real.serial_port import SerialPort

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
