"""Lines that load cells and balances print: bytes in, a number with its unit and marks out.

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
from dataclasses import dataclass

from palpate.core import ProtocolError

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
