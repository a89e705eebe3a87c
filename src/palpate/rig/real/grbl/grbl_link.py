"""Serial link to a GRBL controller: one line in flight, one thread that reads and one that requests status.

Answers carry no name, so nothing received before a line was sent is its answer, and after an unanswered line
nothing counts until a reset and its banner. Status is requested periodically, so a lost report costs one
period. Grbl 1.1h was observed to lose requests while it prints and to answer seconds late on a busy host.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

from palpate.core import NS_PER_S, Clock, DeviceError, ProtocolError
from palpate.rig.real.gcode_stage import KEPT, CutOffError, GcodeLink, SilenceError
from palpate.rig.real.grbl.grbl_parser import (
    Alarm,
    Banner,
    Failed,
    GrblState,
    GrblStatus,
    Line,
    Ok,
    Splitter,
    error_name,
    parse_line,
)
from palpate.rig.real.serial_port import SerialPort

HOLD, CANCEL, STOP, RESET, ASK = b"!", b"\x85", b"\x19", b"\x18", b"?"  # Grbl 1.1 ignores STOP
STOP_PINS = {"D": "its door input", "H": "its hold input"}  # letters in Pn: (Grbl 1.1 interface description)
_RESET_ALARMS = {3, 6}  # alarms that a reset in motion or in homing raises before its banner
MAX_SENT = 80  # bytes; the controller refuses longer lines


class RefusedError(DeviceError):
    """The controller answered a line with `error:N`: it did nothing."""

    def __init__(self, code: int, line: str) -> None:
        message = f"the stage's controller refused {line!r} with {error_name(code)}"
        super().__init__(message, code=f"grbl-error-{code}")


@dataclass(frozen=True, slots=True)
class HeardStatus:
    """A status report with its number among all of the link's, and when it came on the stage's clock [ns]."""

    status: GrblStatus
    number: int
    time_ns: int


class GrblLink(GcodeLink):
    """Sends lines and single bytes, and tells what was heard.

    Args:
        port: an open serial port; this object closes it.
        reply_s: how long an answer to a line may take [s].
        status_s: period of the questions for the status, and how long one may go unanswered before the next
            [s].
        clock: stamps the reports.
    """

    def __init__(self, port: SerialPort, reply_s: float, status_s: float, clock: Clock) -> None:
        super().__init__(port, reply_s, "grbl")
        self._status_s, self._clock = status_s, clock
        self._replies: deque[Ok | Failed] = deque(maxlen=KEPT)
        self._pushed: deque[Line] = deque(maxlen=KEPT)
        self._newest: HeardStatus | None = None
        self.heard = 0  # status reports
        self.asked = 0  # questions for one
        self._asked_s = 0.0  # when the last question went out, in real time
        self._open = False  # the last question is not answered yet
        self._due = 0  # reports that may still come; all others that did not were lost
        self._asked_since = 0  # questions since the last report
        self._heard_s = 0.0  # when that came, in real time
        self._settled = (0, 0)  # when so many are heard, only questions after so many asked are still due
        self._unheard_s: float | None = None  # when the first question since the last report went out
        self._wanting = 0  # callers that wait for a report
        self._asking = False  # from the first that did
        self.halted_ns = 0  # when the last one was
        self.banners = 0
        self._banner_due = False  # an alarm announced a banner that has not come yet
        self.firmware = ""  # and version, as the last banner named them
        self.alarm: int | None = None  # the last one, until it is dealt with; a reset does not undo it
        self.out_of_step = False  # an answer may still come for a line given up
        self._splitter = Splitter()
        self._start(asker=self._keep_asking)

    def command(
        self, line: str, *, timeout_s: float | None = None, halts: int | None = None, moves: bool = False
    ) -> tuple[Line, ...]:
        """Send one line and wait for its `ok`.

        Args:
            line: without its end.
            timeout_s: for the answer; left out, the link's own [s].
            halts: the count of halts when this was asked for; if one came since, the line is not sent.
            moves: it can set something in motion.

        Returns:
            What was pushed between the line and its answer.
        """
        if len(line) > MAX_SENT or not line.isascii():
            raise DeviceError(f"{line[:40]!r} has more than {MAX_SENT} characters and would not be read")
        with self._turn:
            halts = self.halts if halts is None else halts
            with self._writing:
                if self.halts != halts:
                    raise CutOffError("the stage was stopped before it was to move; ask again")
                with self._news:
                    self._replies.clear()
                    self._pushed.clear()
                    banners = self.banners
                self.restless = self.restless or moves
                self.out_of_step = True
                self._write(line.encode() + b"\n")
            answered = self._wait(
                lambda: self._replies or self.banners != banners or self.halts != halts, timeout_s
            )
            with self._news:
                if self._replies:
                    reply, pushed = self._replies.popleft(), tuple(self._pushed)
                    self.out_of_step = False
                    if isinstance(reply, Failed):
                        raise RefusedError(reply.code, line)
                    return pushed
                self.out_of_step = self.banners == banners
            if answered:
                raise CutOffError(f"{line!r} was not answered: the stage was stopped or its controller reset")
            raise SilenceError(f"the stage's controller did not answer {line!r} in time")

    def report(self, timeout_s: float) -> HeardStatus | None:
        """Wait for a report that was asked for after this call.

        Reports that come meanwhile can be late answers to the questions before; those do not count.

        Returns:
            None where none comes in time.
        """
        return self._newest if self._wait_wanting(self.next_number, timeout_s) else None

    def newest(self, max_age_s: float, wait_s: float) -> HeardStatus | None:
        """The newest report; where it is older than `max_age_s`, a newer one is waited for, not for long.

        Returns:
            None where there was none at all yet.
        """
        with self._news:
            newest = self._newest
            needed = self.heard + 1
        young = newest and self._clock.now_ns() - newest.time_ns <= max_age_s * NS_PER_S
        if not young:
            self._wait_wanting(needed, wait_s)
        if self.dead:
            raise DeviceError(self.dead)
        return self._newest

    @property
    def latest(self) -> HeardStatus | None:
        """The newest report, however old; None where there was none."""
        return self._newest

    def age_s(self, heard: HeardStatus) -> float:
        """Age of the newest report in real time [s]; without end for any other."""
        with self._news:
            return time.monotonic() - self._heard_s if heard.number == self.heard else math.inf

    @property
    def silent_s(self) -> float:
        """For how long questions have gone unanswered [s]; 0 where none is due."""
        with self._news:
            return 0.0 if self._unheard_s is None else time.monotonic() - self._unheard_s

    @property
    def unanswered(self) -> int:
        """Questions for the status that no report came for, but for the last one."""
        with self._news:
            return max(self.asked - self.heard - self._open, 0)

    @property
    def next_number(self) -> int:
        """Number of the first report that is sure to have been asked for after now."""
        with self._news:
            self._settled = self.heard + self._due, self.asked
            return self.heard + self._due + 1

    def _wait_wanting(self, number: int, timeout_s: float) -> bool:
        with self._news:
            self._wanting += 1
            self._asking = True
            self._news.notify_all()
        try:
            return self._wait(lambda: self.heard >= number, timeout_s)
        finally:
            with self._news:
                self._wanting -= 1

    def _keep_asking(self) -> None:
        """Ask on the period; at once where somebody waits and the last question was answered."""
        while not (self._closing or self.dead):
            with self._news:
                if (wait_s := self._due_in_s()) > 0:
                    self._news.wait(wait_s)
                    continue
                now_s = time.monotonic()
                if now_s - self._heard_s >= self._status_s:
                    # What was asked before the last report would have followed it at once.
                    self._due = min(self._due, self._asked_since)
                self.asked, self._asked_s, self._open = self.asked + 1, now_s, True
                self._due, self._asked_since = self._due + 1, self._asked_since + 1
                if self._unheard_s is None:
                    self._unheard_s = now_s
            with suppress(DeviceError):  # the link is buried then, which whoever waits is told
                self._write(ASK)

    def _due_in_s(self) -> float:
        if not self._asking:
            return self._status_s
        if self._wanting and not self._open:
            return 0.0
        return self._asked_s + self._status_s - time.monotonic()

    def halt(self) -> bool:
        """Cancel the jog that a line may have begun, and recall lines not sent yet; waits for no answer.

        Returns:
            Whether anything was sent: not where nothing that moves was sent since it stood.
        """
        with self._writing:
            self.halts += 1
            self.halted_ns = self._clock.now_ns()
            with self._news:
                self._news.notify_all()
            if self.restless:
                self._write(CANCEL)
            return self.restless

    def slow_down(self, byte: bytes) -> None:
        """Send `HOLD`, `CANCEL`, or `STOP`."""
        self._write(byte)

    def reset(self) -> bool:
        """Reset the controller, and wait for its banner; answers still due are forgotten.

        The banner of a reset that an alarm has announced is not counted as the answer to this one.

        Returns:
            Whether the banner came.
        """
        if self._banner_due:
            self._wait(lambda: not self._banner_due, None)
        with self._news:
            banners = self.banners
        self._write(RESET)
        came = self._wait(lambda: self.banners != banners, None)
        if came:
            self.out_of_step = False
        return came

    def listen(self, timeout_s: float) -> bool:
        """Wait for a banner.

        Returns:
            Whether one came, also before this call.
        """
        return self._wait(lambda: self.banners > 0, timeout_s)

    def _wait(self, until: Callable[[], object], timeout_s: float | None) -> bool:
        with self._news:
            came = self._news.wait_for(
                lambda: self.dead or until(), self._reply_s if timeout_s is None else timeout_s
            )
            if self.dead:
                raise DeviceError(self.dead, code="port-failed")
            return bool(came)

    def _split(self, data: bytes) -> Iterator[bytes]:
        return self._splitter.feed(data)

    def _take(self, raw: bytes) -> None:
        try:
            line = parse_line(raw)
        except ProtocolError:  # noise on a wire; a report lost in it is asked for again at once
            with self._news:
                self.garbage += 1
                self._open = False
                self._due = max(self._due - raw.startswith(b"<"), 0)
                self._news.notify_all()
            return
        with self._news:
            if isinstance(line, GrblStatus):
                self.heard, self._open, self._unheard_s = self.heard + 1, False, None
                self._due, self._asked_since = max(self._due - 1, 0), 0
                self._heard_s = time.monotonic()
                if self.heard >= self._settled[0]:
                    self._due = min(self._due, self.asked - self._settled[1])
                self._newest = HeardStatus(line, self.heard, self._clock.now_ns())
            elif isinstance(line, Ok | Failed):
                self._replies.append(line)
            else:
                self._pushed.append(line)
            if isinstance(line, Banner):
                self.banners += 1
                self.firmware = f"{line.firmware} {line.version}"
                self._banner_due = False
                self._replies.clear()
            elif isinstance(line, Alarm):
                self.alarm, self._banner_due = line.code, line.code in _RESET_ALARMS
            self._news.notify_all()
        if isinstance(line, GrblStatus):
            self._obey_inputs(line)

    def _obey_inputs(self, status: GrblStatus) -> None:
        """Cancel a jog while an input asks for a stop: no firmware was seen to stop a jog reliably by one."""
        if status.state is GrblState.JOG and set(status.pins) & set(STOP_PINS):
            with suppress(DeviceError):  # the link is buried then, which whoever waits is told
                self._write(CANCEL)
