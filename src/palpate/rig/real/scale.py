"""Load cell or balance on a serial port as a slow force sensor along one axis.

It measures along the device's z; x and y read 0 N. A sample is stamped with its arrival minus the stated
delay; `Limits.check_sensor` refuses sensors that are too slow to guard motion. Garbled lines are counted.
Silence, a lost port, unreadable lines, and counts that stand still raise `DeviceError`.

Reference: HX711 data sheet (Avia Semiconductor): 24 bits in two's complement, saturated at 0x7FFFFF and
0x800000; 10 or 80 samples per second, which settle within 400 or 50 ms.

Lines that load cells and balances print: bytes in, a number with its unit and marks out.

A microcontroller behind an HX711 prints a bare number; a balance adds a unit, a mark of stability, and words
instead of a number where it is overloaded. Layouts differ by maker, and this reads what is common to them: at
most one number, one unit and known marks. Anything else is refused, since a garbled line must not weigh.

Reference: public interface descriptions. A&D "Standard Format": header ST, US, OL or QT before a comma, a
second header such as GS or NT (GX, GH and GC series, AD-4329A). Mettler-Toledo MT-SICS: answers "S S", "S D",
"S +", "S -", "S I" (AT and New Classic series). Sartorius SBI: 16 or 22 characters, the sign apart from the
number, the unit left out while unstable, "H" or "L" beyond the range, "Err" (LE, GC and Practum series).
Radwag: "?", "^" and "v" (PS and R series). Ohaus: "?" after the unit while unstable (Explorer, Navigator).
Kern: "ST,GS 1.000KG" (KFB).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from palpate.core import (
    NS_PER_S,
    Clock,
    DeviceError,
    InputError,
    ProtocolError,
    RangeError,
    Wrench,
)
from palpate.rig.real.serial_force_sensor import SerialForceSensor
from palpate.rig.real.serial_port import SerialPort, open_port

MAX_LINE = 64  # bytes; the longest layout above has below 40
G0 = 9.80665  # m/s^2, standard gravity: ISO 80000-3
POUND_KG = 0.45359237  # international avoirdupois pound

NEWTONS: dict[str, float] = {
    "N": 1.0,
    "mN": 1e-3,
    "kN": 1e3,
    "mg": 1e-6 * G0,
    "g": 1e-3 * G0,
    "kg": G0,
    "oz": POUND_KG / 16 * G0,
    "lb": POUND_KG * G0,
    "ozt": 31.1034768e-3 * G0,
    "ct": 0.2e-3 * G0,
}
"""Force of one of each unit that a balance may print, at standard gravity [N]."""

_UNITS = {name.lower(): name for name in NEWTONS} | {"lbs": "lb"}
_HEADERS = {"ST": True, "QT": True, "US": False}  # stability; others, such as GS and NT, tell nothing of it
_MARKS = {"?": "", "^": "overload", "v": "underload"}
_BEYOND = {
    "OL": "overload", "H": "overload", "HH": "overload", "HIGH": "overload", "OVER": "overload",
    "^": "overload", "L": "underload", "LL": "underload", "LOW": "underload", "UNDER": "underload",
    "V": "underload",
}  # fmt: skip
_REPORT = re.compile(r"(?:E|Err|ERR|Error)[ :]*\d{1,4}")  # "error:20" is GRBL's
_COMMA = re.compile(r"\d,\d")  # a decimal to some, a thousand to others
_LINE = re.compile(
    r"(?P<headers>(?:[A-Z~+ -]{1,6},)*) *"
    r"(?:(?P<mark>[?^v]) +)?"
    r"(?:(?:N|G|GS|NT|Qnt) +)?"  # Sartorius' name of the value
    r"(?P<sign>[-+]?) *(?P<number>\d+\.?\d*|\.\d+) *"
    r"(?P<unit>[A-Za-z]{0,3}) *(?P<unstable>\??)"
)


@dataclass(frozen=True, slots=True)
class Weight:
    """What one line says.

    Attributes:
        value: in `unit`; not-a-number where the line says that there is none.
        unit: as in `NEWTONS`; empty where the line has none.
        stable: whether the balance says so; None where the line does not tell.
        fault: what is wrong by the balance's own word, such as "overload"; empty where nothing is.
    """

    value: float
    unit: str = ""
    stable: bool | None = None
    fault: str = ""


def read_weight(raw: bytes) -> Weight:
    """Read one line without its end.

    Raises:
        ProtocolError: it is too long, not plain text, or holds what no layout known here has.

    Example:
        >>> read_weight(b"ST,+0018.372  g")
        Weight(value=18.372, unit='g', stable=True, fault='')
        >>> read_weight(b"S D     -4.51 g").stable
        False
    """
    if len(raw) > MAX_LINE or not all(0x20 <= byte < 0x7F or byte == 0x09 for byte in raw):
        raise ProtocolError(f"{raw[:20]!r}... is no line of a scale")
    text = raw.decode("ascii").replace("\t", " ").strip()
    return _sics(text) or _refusal(text) or _weight(text)


def _sics(text: str) -> Weight | None:
    """MT-SICS: S or SI, then S, D, +, - or I."""
    name, status, *rest = [*text.split(), "", ""]
    rest = [word for word in rest if word]
    if name not in ("S", "SI") or status not in ("S", "D", "+", "-", "I"):
        return None
    if status in "+-I" and not rest:
        faults = {"+": "overload", "-": "underload", "I": "the balance is busy or did not settle"}
        return _none(faults[status])
    if status in "SD" and len(rest) == 2:
        found = _LINE.fullmatch(" ".join(rest))
        if found and found["unit"] and not found["headers"] and not found["mark"]:
            return Weight(_value(found), _unit(found["unit"], text), status == "S")
    raise ProtocolError(f"{text!r} is cut short or garbled")


def _refusal(text: str) -> Weight | None:
    """A line that says that there is no weight, and why."""
    word = text.partition(",")[0].strip().upper()
    if word == "OL" or text.upper() in _BEYOND:
        return _none(_BEYOND[word])
    return _none(f"the balance reports {text}") if _REPORT.fullmatch(text) else None


def _weight(text: str) -> Weight:
    """A number, with headers, marks and a unit around it."""
    found = _LINE.fullmatch(text)
    if not found and _COMMA.search(text):
        raise ProtocolError(
            f"{text!r} has a comma between digits, and a point alone is read: set it so", code="decimal-comma"
        )
    if not found:
        raise ProtocolError(f"{text!r} holds no weight")
    headers = [part.strip() for part in found["headers"].split(",") if part.strip()]
    stable = _HEADERS.get(headers[0]) if headers else None
    if found["mark"] == "?" or found["unstable"]:
        stable = False
    if fault := _MARKS.get(found["mark"] or "", ""):
        return _none(fault)
    return Weight(_value(found), _unit(found["unit"], text), stable)


def _value(found: re.Match[str]) -> float:
    return float(found["sign"] + found["number"])


def _unit(word: str, text: str) -> str:
    if word and word.lower() not in _UNITS:
        raise ProtocolError(
            f"{text!r} has a unit that is not known: {word!r}; known are {', '.join(NEWTONS)}"
        )
    return _UNITS[word.lower()] if word else ""


def _none(fault: str) -> Weight:
    return Weight(math.nan, fault=fault)


COUNTS = "counts"
HX711_RAILS = (-(2**23), 2**23 - 1)
MAX_GARBLED = 10  # lines in a row
SILENT_PERIODS = 5.0  # without a line, after which it has failed
MIN_SILENCE_S = 1.0
STUCK_LINES = 50  # of counts that are the same to the last; noise moves a live amplifier's within a few


@dataclass(frozen=True, slots=True)
class ScaleSpec:
    """Specification of how a scale is reached, and what its lines mean.

    Attributes:
        port: a path such as /dev/ttyUSB0, or the USB serial number of its adapter.
        rate_hz: lines a second; where it is asked, how often [Hz].
        range_n: greatest force, to either side; a sample beyond it is faulty [N].
        delay_s: from a change of force until it is printed in full [s]. An HX711 settles within 0.4 s at 10
            samples a second and 0.05 s at 80; a balance's filter takes longer: measure it with a weight.
        unit: of lines that carry none: "counts", or one of `NEWTONS`; or "" where none is known, and lines
            without a unit are faulty until one has come with it. A unit in a line holds for that line, and a
            later line in another is a faulty sample.
        count_n: force of one count, negative where it is mounted the other way round [N]; for counts alone.
        ask: what to send for each line, such as "SI" (MT-SICS) or "Q" (A&D); empty where it sends by itself.
        baud, frame: of the port; data bits, parity and stop bits, such as "7E1".
        dtr: raise the port's DTR line, which resets many boards.
        settled_only: a line that says that it is not stable is a faulty sample.
        silence_s: without a readable line for longer, it has failed; left out, five periods, and
            1 s at least [s].
        stuck_lines: so many equal counts in a row are a fault; None for never. A balance's lines may repeat
            as long as its load does, and are never judged.
        line_bytes: length of every line without its end, of a balance that prints a fixed width; others are
            garbled. Without it a line that lost its first digits is a wrong weight that nothing tells.
        keep: samples kept between two calls of `drain`.
    """

    port: str
    rate_hz: float = 10.0
    range_n: float = 50.0
    delay_s: float = 0.4
    unit: str = "g"
    count_n: float | None = None
    ask: str = ""
    baud: int = 9600
    frame: str = "8N1"
    dtr: bool = False
    settled_only: bool = False
    silence_s: float | None = None
    stuck_lines: int | None = STUCK_LINES
    line_bytes: int | None = None
    keep: int = 4096

    def __post_init__(self) -> None:
        positive = ("rate_hz", "range_n", "baud", "keep", "silence_s", "stuck_lines", "line_bytes")
        for name in positive:
            value = getattr(self, name)
            if value is not None and not (value > 0 and math.isfinite(value)):
                raise RangeError(f"{name} is {value}; it must be positive and finite")
        if not (self.delay_s >= 0 and math.isfinite(self.delay_s)):
            raise RangeError(f"delay_s is {self.delay_s} s; it must be 0 s or more")
        if self.unit not in ("", COUNTS, *NEWTONS):
            raise InputError(f"unit is {self.unit!r}; give {COUNTS!r} or one of {', '.join(NEWTONS)}")
        if (self.unit == COUNTS) != (self.count_n is not None):
            raise InputError("give count_n, the force of one count [N], with unit = 'counts' and only then")
        if self.count_n is not None and not (math.isfinite(self.count_n) and self.count_n != 0):
            raise RangeError(f"count_n is {self.count_n} N; it must be finite and not 0")
        most_n = math.inf if self.count_n is None else abs(self.count_n) * HX711_RAILS[1]
        if self.range_n > most_n:
            raise RangeError(
                f"range_n is {self.range_n:g} N, and at {abs(self.count_n or 0.0):g} N a count its 24 bits "
                f"end at {most_n:.4g} N; give that or less"
            )
        if not re.fullmatch(r"[78][NEO][12]", self.frame):
            raise InputError(f"frame is {self.frame!r}; give data bits, parity and stop bits, such as '7E1'")

    @property
    def silent_s(self) -> float:
        """Longest time without a line [s]."""
        return max(MIN_SILENCE_S, SILENT_PERIODS / self.rate_hz) if self.silence_s is None else self.silence_s

    def force_n(self, weight: Weight) -> float:
        """Force of a line [N]."""
        if self.count_n is not None:
            return weight.value * self.count_n
        return weight.value * NEWTONS[weight.unit or self.unit]


@dataclass(slots=True)
class ScaleCounts:
    """Counts of what has come in.

    Attributes:
        received: lines that were read.
        garbled: lines that were not, which weigh nothing.
        unstable: received ones that the balance calls not stable.
        faulty: received ones with a fault.
    """

    received: int = 0
    garbled: int = 0
    unstable: int = 0
    faulty: int = 0


class WeightStream:
    """Bytes in, samples out; tells by `failure` when the stream is worth nothing any more."""

    def __init__(self, spec: ScaleSpec) -> None:
        self._spec = spec
        self._rest = bytearray()
        self._partial = not spec.ask  # it was printing already: the first line may be the end of one
        self._overlong = False
        self.counts = ScaleCounts()
        self.failure: DeviceError | None = None
        self._garbled = self._same = 0
        self.unread = ""  # why the last garbled line was none
        self._last: float | None = None
        self._unit = ""
        self._bare = 0

    def take(self, data: bytes, time_ns: int) -> list[Wrench]:
        """The samples that end in these bytes, which arrived at `time_ns` [ns]."""
        samples = []
        for byte in data:
            if byte not in b"\r\n":
                self._rest.append(byte)
                if len(self._rest) > MAX_LINE:
                    self._rest.clear()
                    self._overlong = True
                continue
            sample = self._end_line(bytes(self._rest), time_ns)
            self._rest.clear()
            self._partial = self._overlong = False
            samples += [sample] if sample else []
        return samples

    def _end_line(self, line: bytes, time_ns: int) -> Wrench | None:
        if self._overlong:
            self._garble(f"it has more than {MAX_LINE} bytes")
        elif line.strip() and not self._partial:
            return self._sample(line, time_ns)
        return None

    def _sample(self, line: bytes, time_ns: int) -> Wrench | None:
        try:
            weight = self._read(line)
        except ProtocolError as error:
            self._garble(str(error))
            return None
        self._garbled = 0
        self.counts.received += 1
        self.counts.unstable += weight.stable is False
        if not weight.unit and not self._spec.unit:
            weight = replace(weight, unit=self._unit)  # some leave it out while they are not stable
        fault = weight.fault or self._no_unit(weight, line) or self._other_unit(weight) or self._fault(weight)
        self.counts.faulty += bool(fault)
        measured_ns = time_ns - round(self._spec.delay_s * NS_PER_S)
        force = math.nan if fault else self._spec.force_n(weight)
        across = math.nan if fault else 0.0
        return Wrench(measured_ns, (across, across, force), (across, across, across), fault)

    def _read(self, line: bytes) -> Weight:
        weight = read_weight(line)
        if self._spec.line_bytes not in (None, len(line)):
            raise ProtocolError(f"{line!r} has {len(line)} bytes, of {self._spec.line_bytes}")
        if weight.unit and self._spec.unit == COUNTS:
            raise ProtocolError(f"{line!r} has a unit where counts were to come")
        return weight

    def _no_unit(self, weight: Weight, line: bytes) -> str:
        """Fault of a line without a unit where none was stated: 100 may be grams, ounces or newtons."""
        if weight.unit or self._spec.unit:
            self._bare = 0
            return ""
        self._bare += 1
        why = f"the line {line.decode('ascii', 'replace')!r} carries no unit"
        if self._bare >= MAX_GARBLED:
            self.failure = DeviceError(f"{why}; say which it means: --unit g, kg, N, oz or lb")
        return why

    def _other_unit(self, weight: Weight) -> str:
        """Fault of a line in another unit than the first that had one: somebody has set the
        scale otherwise.
        """
        self._unit = self._unit or weight.unit
        if weight.unit in ("", self._unit):
            return ""
        return f"its unit changed from {self._unit} to {weight.unit}: set it back, or open it anew"

    def _fault(self, weight: Weight) -> str:
        """Fault of a line; empty where its number holds."""
        if self._spec.unit == COUNTS:
            self._same = self._same + 1 if weight.value == self._last else 0
            self._last = weight.value
            if self._spec.stuck_lines is not None and self._same + 1 >= self._spec.stuck_lines:
                self.failure = DeviceError(
                    f"it printed {weight.value:g} counts {self._same + 1} times running: the amplifier "
                    "stands still; check its wires and supply, then open it anew"
                )
                return "counts stand still"
            if weight.value >= HX711_RAILS[1] or weight.value <= HX711_RAILS[0]:
                return "counts at their rail: overloaded, or a wire of the cell is off"
        if abs(self._spec.force_n(weight)) > self._spec.range_n:
            return "force-range"
        return "not stable" if self._spec.settled_only and weight.stable is False else ""

    def _garble(self, why: str) -> None:
        self.counts.garbled += 1
        self._garbled += 1
        self.unread = why
        if self._garbled >= MAX_GARBLED:
            self.failure = ProtocolError(
                f"{MAX_GARBLED} lines in a row could not be read, the last since {why}; check baud "
                f"({self._spec.baud}), frame ({self._spec.frame}), and that this port is the scale's"
            )


class SerialScale(SerialForceSensor):
    """A `palpate.core.ForceSensor` along z. Opening it waits for the first line that can be read.

    Args:
        spec: how it is reached, and what its lines mean.
        port: an open serial port, which this object closes.
        clock: stamps the samples.

    Raises:
        DeviceError: no line came, or none that could be read.
    """

    def __init__(self, spec: ScaleSpec, port: SerialPort, clock: Clock | None = None) -> None:
        self._spec, self._lines = spec, WeightStream(spec)
        self._asked_ns = 0
        super().__init__(self._lines, port, f"the scale at {spec.port}", spec.silent_s, spec.keep, clock)

    @classmethod
    def open(cls, spec: ScaleSpec, clock: Clock | None = None) -> SerialScale:
        """Open the spec's port."""
        return cls(spec, open_port(spec.port, spec.baud, dtr=spec.dtr, frame=spec.frame), clock)

    @property
    def rate_hz(self) -> float:
        return self._spec.rate_hz

    @property
    def delay_s(self) -> float:
        """Age of a sample when it arrives, as stated [s]."""
        return self._spec.delay_s

    @property
    def range_n(self) -> tuple[float, float, float]:
        """Greatest force [N]; across z nothing is measured."""
        return (self._spec.range_n,) * 3

    @property
    def counts(self) -> ScaleCounts:
        """Counts since it was opened."""
        with self._lock:
            return replace(self._lines.counts)

    def in_silence(self) -> str:
        """Say that no line comes, and what to check."""
        garbled = f"{self._lines.counts.garbled} were garbled"
        garbled += f", the last since {self._lines.unread}" if self._lines.unread else ""
        return (
            f"no line that can be read came for {self._spec.silent_s:g} s"
            f"{'' if self._spec.ask else ', and none was asked for'} ({garbled}), {self._tail.in_words()}; "
            f"check its cable, power, baud ({self._spec.baud}) and printing mode, and that this port is the "
            "scale's"
        )

    def speak(self, now_ns: int, *, first: bool = False) -> bytes:
        """Question for the next line, where it is due."""
        if not self._spec.ask or not (first or now_ns - self._asked_ns >= NS_PER_S / self._spec.rate_hz):
            return b""
        self._asked_ns = now_ns
        return self._spec.ask.encode("latin-1") + b"\r\n"
