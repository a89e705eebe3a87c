"""Parser of a GRBL controller's lines: bytes in, small frozen records out. No port and no time.

One line sent gives one `ok` or `error:N`; status `<...>`, messages `[...]`, alarms and banners come in
between at any time. Whatever bytes come, the memory used is bounded and the only error is `ProtocolError`.

Reference: behaviour of Grbl 1.1h and grblHAL 1.1f as observed; names of states, errors and alarms after the
public Grbl 1.1 interface description.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from palpate.core import ProtocolError

ALARMS = {
    1: "a limit switch was hit; the position is lost",
    2: "a move would have left the machine's own travel",
    3: "reset while moving; the position is lost",
    4: "the probe was triggered already, or is not connected, before the probing move",
    5: "the probe was not triggered within the probing move",
    6: "homing was interrupted by a reset",
    7: "homing was interrupted by the door",
    8: "homing could not leave the switch; is the pull-off ($27) large enough?",
    9: "homing found no switch within its search; check the switches and their wiring",
    10: "emergency stop, or homing of two motors on one axis failed",
    11: "homing is needed first",
    14: "a motor or probe fault",
}

ERRORS = {
    1: "a letter was expected",
    2: "a number could not be read",
    3: "a $ command is not known",
    4: "a number is negative where it may not be",
    5: "homing is switched off; set $22=1 on the machine if it has switches",
    7: "its memory of settings was damaged and is back at the defaults; check every $ setting",
    8: "a $ command came while it was not idle",
    9: "it is locked by an alarm or by a jog",
    10: "soft limits need homing ($22=1)",
    11: "the line was too long",
    15: "the target lies outside the machine's own travel ($130 to $132)",
    16: "a jog held a word that it may not",
    20: "a word is not known",
    22: "no speed was given",
    79: "a limit switch still needs a reset",
}


def alarm_name(code: int) -> str:
    """`ALARM:N` in words.

    Example:
        >>> alarm_name(5)
        'ALARM:5 (the probe was not triggered within the probing move)'
    """
    return f"ALARM:{code} ({ALARMS.get(code, 'see the firmware’s list of alarms')})"


def error_name(code: int) -> str:
    """`error:N` in words."""
    return f"error:{code} ({ERRORS.get(code, 'see the firmware’s list of errors')})"


MAX_LINE = 512  # bytes; the longest that firmware prints, a full status or a message, is below 200
MAX_AXES = 8


class GrblState(StrEnum):
    """State that the controller reports. One not known here is UNKNOWN, and unsafe."""

    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    JOG = "Jog"
    ALARM = "Alarm"
    DOOR = "Door"
    CHECK = "Check"
    HOME = "Home"
    SLEEP = "Sleep"
    UNKNOWN = "?"


@dataclass(frozen=True, slots=True)
class Ok:
    """A line was read and queued, which is not that it is done."""


@dataclass(frozen=True, slots=True)
class Failed:
    """A line was refused: `error:N`."""

    code: int


@dataclass(frozen=True, slots=True)
class Alarm:
    """The controller locked itself: `ALARM:N`."""

    code: int


@dataclass(frozen=True, slots=True)
class Banner:
    """The controller has started, or was reset: every modal word is back at its default."""

    firmware: str
    version: str


@dataclass(frozen=True, slots=True)
class GrblStatus:
    """A report on `?`; what the controller left out is None.

    Attributes:
        state: what it does.
        substate: Hold 0 stands, Hold 1 is still slowing down.
        machine_mm, work_mm: position in machine or work coordinates [mm].
        offset_mm: machine minus work [mm]; sent only now and then.
        feed_mm_min: current speed, rounded to 1 mm/min: 0 does not mean that it stands.
        free_blocks: room in the planner.
        pins: letters of the inputs that are active.
        homed: whether its axes were homed; grblHAL alone says so.
    """

    state: GrblState
    substate: int | None = None
    machine_mm: tuple[float, ...] | None = None
    work_mm: tuple[float, ...] | None = None
    offset_mm: tuple[float, ...] | None = None
    feed_mm_min: float | None = None
    free_blocks: int | None = None
    pins: str = ""
    homed: bool | None = None

    @property
    def in_words(self) -> str:
        """State and active inputs, as it reports them, such as "Door:1, Pn:D"."""
        state = self.state.value if self.substate is None else f"{self.state.value}:{self.substate}"
        return f"{state}, Pn:{self.pins}" if self.pins else state


@dataclass(frozen=True, slots=True)
class Setting:
    """Line of the `$$` list."""

    number: int
    text: str


@dataclass(frozen=True, slots=True)
class GrblMessage:
    """Any other push message, `[tag:text]`."""

    tag: str
    text: str


Line = Ok | Failed | Alarm | Banner | GrblStatus | Setting | GrblMessage

_STATES = {state.value: state for state in GrblState}
_CODE = re.compile(r"(error|ALARM):(\d{1,3})")
_BANNER = re.compile(r"(grbl(?:HAL)?) (\d[\w.\-]{0,30})(?: .*)?", re.IGNORECASE)
_SETTING = re.compile(r"\$(\d{1,4})=(.*)")
_STATE = re.compile(r"([A-Za-z]{1,16})(?::(\d{1,3}))?")
_NUMBER = re.compile(r"[-+]?\d{1,9}(?:\.\d{1,9})?")  # fixed point: neither nan, inf nor exponents
_REPLY_BEGUN = re.compile(rb"o|e|er|err|erro|error|error:\d{0,3}")


def parse_line(line: bytes) -> Line:
    """Read one line.

    Args:
        line: without its end; blanks around it do not matter.

    Raises:
        ProtocolError: it is not a line of GRBL's, or longer than `MAX_LINE`.

    Example:
        >>> parse_line(b"error:9")
        Failed(code=9)
    """
    if len(line) > MAX_LINE:
        raise ProtocolError(f"a line of more than {MAX_LINE} bytes is not GRBL's; check the port")
    try:
        text = line.decode("ascii").strip()
    except UnicodeDecodeError as error:
        raise ProtocolError(f"{line[:40]!r} is not plain text; check the port's baud rate") from error
    if text == "ok":
        return Ok()
    if code := _CODE.fullmatch(text):
        return (Failed if code[1] == "error" else Alarm)(int(code[2]))
    if text.startswith("<"):
        return _status(text)
    if text.startswith("["):
        return _bracketed(text)
    if setting := _SETTING.fullmatch(text):
        return Setting(int(setting[1]), setting[2].strip())
    if banner := _BANNER.fullmatch(text):
        return Banner(banner[1], banner[2])
    if re.match(r">|\$N\d=", text):  # start-up blocks, run and listed
        return GrblMessage("startup", text.lstrip(">"))
    raise ProtocolError(f"{text[:40]!r} is not a line of GRBL's; is this the stage's port?")


def _status(text: str) -> GrblStatus:
    if not text.endswith(">"):
        raise ProtocolError(f"{text[:40]!r} is a status report cut short")
    head, *fields = text[1:-1].split("|")
    state = _STATE.fullmatch(head)
    if not state:
        raise ProtocolError(f"{text[:40]!r} is not a status report: it names no state")
    named = dict(field.partition(":")[::2] for field in fields)
    feed = _numbers(named, "FS") or _numbers(named, "F")
    free = _numbers(named, "Bf")
    homed = _numbers(named, "H")
    return GrblStatus(
        state=_STATES.get(state[1], GrblState.UNKNOWN),
        substate=int(state[2]) if state[2] else None,
        machine_mm=_numbers(named, "MPos"),
        work_mm=_numbers(named, "WPos"),
        offset_mm=_numbers(named, "WCO"),
        feed_mm_min=feed[0] if feed else None,
        free_blocks=int(free[0]) if free else None,
        pins=named.get("Pn", ""),
        homed=homed[0] == 1 if homed else None,
    )


def _bracketed(text: str) -> GrblMessage:
    if not text.endswith("]"):
        raise ProtocolError(f"{text[:40]!r} is a message cut short")
    inside = text[1:-1]
    tag, colon, rest = inside.partition(":")
    return GrblMessage(tag, rest.strip()) if colon else GrblMessage("", inside)


def _numbers(fields: dict[str, str], name: str) -> tuple[float, ...] | None:
    return _read_numbers(fields[name]) if name in fields else None


def _read_numbers(text: str) -> tuple[float, ...]:
    words = text.split(",")
    if len(words) > MAX_AXES or not all(_NUMBER.fullmatch(word) for word in words):
        raise ProtocolError(f"{text[:40]!r} is not a list of up to {MAX_AXES} numbers")
    return tuple(float(word) for word in words)


class Splitter:
    """Cuts a stream into lines, however it was broken up on its way, and keeps no more than one line.

    A status report that comes in the midst of a reply, `o<Idle|...>` and then `k`, is taken out whole.
    """

    def __init__(self) -> None:
        self._line = bytearray()
        self._around = b""  # the reply that a report interrupted
        self._after_report = False

    def feed(self, data: bytes) -> Iterator[bytes]:
        """The lines that `data` completes, without their ends; one too long comes cut, to be refused."""
        for byte in data:
            if self._after_report and byte in b"\r\n":
                continue
            self._after_report = False
            if byte in b"\r\n":
                yield from self._end()
            elif byte == ord("<") and self._line:
                yield from self._interrupt()
            elif len(self._line) <= MAX_LINE:
                self._line.append(byte)
            if byte == ord(">") and self._around and self._line[:1] == b"<":
                yield bytes(self._line)
                self._line[:], self._around, self._after_report = self._around, b"", True

    def _end(self) -> Iterator[bytes]:
        line, self._around = bytes(self._line).strip(b"\0 \t"), b""
        self._line.clear()
        if line:
            yield line

    def _interrupt(self) -> Iterator[bytes]:
        begun = bytes(self._line)
        if _REPLY_BEGUN.fullmatch(begun):
            self._around = begun
        elif begun == b"ok":
            yield begun
        elif begun.startswith(b"["):  # an angle within a message
            if len(self._line) <= MAX_LINE:
                self._line.append(ord("<"))
            return
        else:  # noise before a report costs the noise, not the report
            yield begun
        self._line[:] = b"<"
