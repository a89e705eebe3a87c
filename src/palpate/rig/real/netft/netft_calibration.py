"""Calibration page of a Net F/T box, `/netftapi2.xml`: counts per unit, the units, range and rate.

The page is read as untrusted: no document type, no entities, at most 64 KiB, every field at most once and at
most 128 characters, every number plain, finite and positive. Nothing is assumed where the page is silent.
"""

from __future__ import annotations

import math
import re
import socket
from contextlib import closing, suppress
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from threading import Event, Timer
from xml.parsers import expat

from palpate.core import DeviceError, ProtocolError

PATH = "/netftapi2.xml"
MAX_PAGE_BYTES = 65536
MAX_CHARACTERS = 128

POUND_N = 0.45359237 * 9.80665  # exact, by definition of the pound and of standard gravity
KILOGRAM_N = 9.80665
INCH_M = 0.0254
FORCE_N = {
    "lbf": POUND_N,
    "N": 1.0,
    "klbf": 1e3 * POUND_N,
    "kN": 1e3,
    "kgf": KILOGRAM_N,
    "gf": 1e-3 * KILOGRAM_N,
}
"""Force units of the box [N]."""
TORQUE_NM = {
    "lbf-in": POUND_N * INCH_M,
    "lbf-ft": POUND_N * 12 * INCH_M,
    "N-m": 1.0,
    "Nm": 1.0,
    "N-mm": 1e-3,
    "Nmm": 1e-3,
    "kgf-cm": KILOGRAM_N * 1e-2,
    "kg-cm": KILOGRAM_N * 1e-2,
    "kN-m": 1e3,
    "kNm": 1e3,
}
"""Torque units of the box, in both spellings that boxes use [Nm]."""

_REQUIRED = ("prodname", "cfgcpf", "cfgcpt", "scfgfu", "scfgtu")
_OPTIONAL = ("cfgcalsn", "comrdtrate", "cfgmr", "setbias")
_NUMBER = re.compile(r"-?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?", re.ASCII)

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class NetFTCalibration:
    """Calibration that gives a box's counts their meaning. Two that differ are two instruments.

    Attributes:
        product: the box's name.
        serial: of the transducer's calibration; empty where the page does not say.
        counts_per_n, counts_per_nm: counts a newton and a newton metre.
        rate_hz: records a second that the box is set to send; None where the page does not say.
        range_n: greatest force along x, y, z [N]; None where the page does not say or says 0.
        device_bias: what the box itself subtracts, in gauge counts, as the page writes it. All zero unless
            someone set it; nothing here ever sets it.
    """

    product: str
    serial: str
    counts_per_n: float
    counts_per_nm: float
    rate_hz: float | None
    range_n: Triple | None
    device_bias: str

    def force_n(self, counts: tuple[int, ...]) -> Triple:
        """Force along the device's axes [N] of the first three counts."""
        k = self.counts_per_n
        return counts[0] / k, counts[1] / k, counts[2] / k

    def torque_nm(self, counts: tuple[int, ...]) -> Triple:
        """Torque about the device's axes [Nm] of the last three counts."""
        k = self.counts_per_nm
        return counts[3] / k, counts[4] / k, counts[5] / k


def calibration(page: bytes) -> NetFTCalibration:
    """Read a box's page.

    Raises:
        ProtocolError: it is not such a page, or a field is missing, double, not a number or of no known unit.
    """
    fields = _fields(page)
    for name in _REQUIRED:
        if not fields.get(name):
            raise ProtocolError(
                f"the box's page has no {name}; is there a Net F/T box at this address?", code="field-missing"
            )
    force_n, torque_nm = _unit(fields, "scfgfu", FORCE_N), _unit(fields, "scfgtu", TORQUE_NM)
    rate, ranges = fields.get("comrdtrate"), fields.get("cfgmr")
    return NetFTCalibration(
        product=fields["prodname"],
        serial=fields.get("cfgcalsn", ""),
        counts_per_n=_per_si("cfgcpf", fields, force_n),
        counts_per_nm=_per_si("cfgcpt", fields, torque_nm),
        rate_hz=None if rate is None else _positive("comrdtrate", rate),
        range_n=None if ranges is None else _range(ranges, force_n),
        device_bias=fields.get("setbias", ""),
    )


def _fields(page: bytes) -> dict[str, str]:
    if len(page) > MAX_PAGE_BYTES:
        raise ProtocolError(f"the box's page is longer than {MAX_PAGE_BYTES} bytes; it is not a Net F/T page")
    fields: dict[str, str] = {}
    inside: list[str] = []

    def start(name: str, _: dict[str, str]) -> None:
        if inside and inside[-1] in fields:
            raise ProtocolError(
                f"the field {inside[-1]} of the box's page holds more than text", code="field-nested"
            )
        if name in fields:
            raise ProtocolError(
                f"the box's page has {name} twice; which one holds is not known", code="field-repeated"
            )
        if name in _REQUIRED or name in _OPTIONAL:
            fields[name] = ""
        inside.append(name)

    def text(data: str) -> None:
        if inside and inside[-1] in fields:
            name = inside[-1]
            fields[name] += data
            if len(fields[name]) > MAX_CHARACTERS:
                raise ProtocolError(f"{name} on the box's page is longer than {MAX_CHARACTERS} characters")

    def refuse(*_: object) -> None:
        raise ProtocolError(
            "the box's page declares a document type or an entity; a Net F/T page does not", code="xml-entity"
        )

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: inside.pop()
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(page, True)
    except (expat.ExpatError, LookupError, ValueError) as error:  # the last two: encodings Python has not
        raise ProtocolError(f"the box's page is not XML ({error}); is there a Net F/T box there?") from error
    return {name: value.strip(" \t\r\n") for name, value in fields.items()}


def _number(name: str, text: str) -> float:
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise ProtocolError(f"{name} on the box's page is {text!r}, which is not a finite number")
    return value


def _positive(name: str, text: str) -> float:
    value = _number(name, text)
    if not value > 0:
        raise ProtocolError(f"{name} on the box's page is {text!r}; it has to be greater than 0")
    return value


def _unit(fields: dict[str, str], name: str, known: dict[str, float]) -> float:
    if fields[name] not in known:
        raise ProtocolError(
            f"{name} on the box's page is {fields[name]!r}, which is no known unit; "
            f"set the box to one of {', '.join(known)}",
            code="unit-unknown",
        )
    return known[fields[name]]


def _per_si(name: str, fields: dict[str, str], unit: float) -> float:
    """Counts a newton or newton metre, from counts a unit; refused where the counts' rails overflow."""
    value = _positive(name, fields[name]) / unit
    if not (value > 0 and math.isfinite(value) and math.isfinite(2.0**31 / value)):
        raise ProtocolError(f"{name} on the box's page is {fields[name]!r}, which no transducer has")
    return value


def _range(text: str, force_n: float) -> Triple | None:
    """The greatest forces [N] from `Fx;Fy;Fz;Tx;Ty;Tz` in the box's units; 0 is how a box says "not set"."""
    limits = [_number("cfgmr", part.strip(" ")) * force_n for part in text.split(";")]
    if len(limits) != 6 or min(limits) < 0 or not all(map(math.isfinite, limits)):
        raise ProtocolError(f"cfgmr on the box's page is {text!r}; it has to be six numbers, 0 or more")
    x, y, z, *_ = limits
    return (x, y, z) if min(x, y, z) > 0 else None


def fetch(host: str, port: int = 80, timeout_s: float = 2.0) -> NetFTCalibration:
    """Fetch and read the page of the box at an address.

    Args:
        host: its name or address.
        port: of its web server.
        timeout_s: for connecting, and again for the whole answer [s].

    Raises:
        DeviceError: nothing answers in time, or with an error.
        ProtocolError: what answers is not a Net F/T box.
    """
    page = f"http://{host}:{port}{PATH}"
    late = Event()
    try:
        with closing(HTTPConnection(host, port, timeout=timeout_s)) as connection:
            connection.connect()
            # A time-out of the socket begins anew with every byte; this one ends an answer that drips.
            timer = Timer(timeout_s, _cut, (connection.sock, late))
            timer.start()
            try:
                return calibration(_body(connection, page))
            finally:
                timer.cancel()
                timer.join()
    except (OSError, HTTPException, DeviceError) as error:
        if late.is_set():
            raise DeviceError(
                f"{page} did not answer whole within {timeout_s:g} s; is the network slow or the box busy?",
                code="page-timeout",
            ) from error
        if isinstance(error, DeviceError):
            raise
        raise DeviceError(
            f"{page} cannot be read ({error}); check the box's address, its power and the cable",
            code="page-unreachable",
        ) from error


def _cut(connected: socket.socket, late: Event) -> None:
    late.set()
    with suppress(OSError):
        connected.shutdown(socket.SHUT_RDWR)


def _body(connection: HTTPConnection, page: str) -> bytes:
    connection.request("GET", PATH, headers={"Connection": "close"})
    with connection.getresponse() as answer:
        if answer.status != 200:
            raise DeviceError(f"{page} answers {answer.status} {answer.reason}; it has to be 200")
        body = answer.read(MAX_PAGE_BYTES + 1)
        if len(body) <= MAX_PAGE_BYTES and answer.length:  # a bounded read does not complain of an early end
            raise DeviceError(
                f"{page} ended {answer.length} bytes early; read it again", code="page-truncated"
            )
        return body
