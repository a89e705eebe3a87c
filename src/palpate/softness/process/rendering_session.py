"""Client of a rendering process.

Messages between a rendering process and its client; an object is sent in pieces of one line each.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields, replace
from typing import Any

import numpy as np

from palpate.core import Closing, Float, PalpateError, ProtocolError, ndarray
from palpate.devices.operator_control import OperatorCommand
from palpate.devices.supervisor.process_link import GoneWords, ProcessLink
from palpate.softness.characteristics import Characteristic, SoftObject
from palpate.softness.control.rendering_loop import LoopSample
from palpate.softness.display_parts import ConeDisplay
from palpate.softness.process.bench_file import BenchFile
from palpate.softness.rendering_law import DisplayBounds, Mode, RenderingLaw

PIECE = 100  # numbers of a curve in a line
MAX_POINTS = 100_000  # of a curve
TEXT = 500  # characters of a name or a source
LOOP = tuple(one.name for one in fields(LoopSample))
COLUMNS = ("area_x", "area_force", "displacement_x", "displacement_force")

Values = Float[ndarray, " n"]
Message = dict[str, Any]


@dataclass(frozen=True, slots=True)
class RenderingStatus:
    """State of a rendering; `wished` if it ended on request."""

    state: str
    why: str
    object: str
    mode: Mode
    periods: int = 0
    late_share: float = 0.0
    longest_s: float = 0.0
    simulated: bool = True
    wished: bool = False


def status_row(status: RenderingStatus) -> Message:
    """A status as plain values."""
    return asdict(status) | {"mode": status.mode.value}


def status_of(row: Mapping[str, Any]) -> RenderingStatus:
    """A status from its plain values."""
    return RenderingStatus(**{**row, "mode": Mode(str(row["mode"]))})


def loop_row(sample: LoopSample) -> list[Any]:
    """A period as plain values."""
    return list(astuple(sample))


def loop_sample(row: Sequence[Any]) -> LoopSample:
    """A period from its plain values."""
    return LoopSample(**dict(zip(LOOP, row, strict=True)))


def law_row(law: RenderingLaw) -> Message:
    """What a law says of the bench, as plain values."""
    return {"mode": law.mode.value, "cone": astuple(law.display), "bounds": astuple(law.bounds)}


def law_of_row(row: Mapping[str, Any], soft: SoftObject) -> RenderingLaw:
    """The law of an object on a bench."""
    height, radius, rings, sleeve = row["cone"]
    pressure, force, (low, high) = row["bounds"]
    cone = ConeDisplay(float(height), float(radius), int(rings), float(sleeve))
    bounds = DisplayBounds(float(pressure), float(force), (float(low), float(high)))
    return RenderingLaw(soft, cone, bounds, Mode(str(row["mode"])))


def object_messages(soft: SoftObject) -> Iterator[Message]:
    """An object in pieces; the last of them ends it."""
    curves = (soft.area.x, soft.area.force_n, soft.displacement.x, soft.displacement.force_n)
    for name, values in zip(COLUMNS, curves, strict=True):
        for begin in range(0, len(values), PIECE):
            yield {"do": "piece", "column": name, "values": values[begin : begin + PIECE].tolist()}
    yield {"do": "object", "name": soft.name[:TEXT], "source": soft.source[:TEXT]}


class ObjectPieces:
    """Puts an object together again from its pieces."""

    def __init__(self) -> None:
        self._columns: dict[str, list[float]] = {}

    def take(self, message: Mapping[str, Any]) -> None:
        """One more piece."""
        name = str(message.get("column"))
        if name not in COLUMNS:
            raise ProtocolError(f"a piece of {name!r}; an object has {', '.join(COLUMNS)}")
        column = self._columns.setdefault(name, [])
        column += map(float, message["values"])
        if len(column) > MAX_POINTS:
            raise ProtocolError(f"a curve of more than {MAX_POINTS} points")

    def whole(self, message: Mapping[str, Any]) -> SoftObject:
        """The object, by its last piece; what comes then is another's."""
        columns, self._columns = self._columns, {}
        area_x, area_force, x, force = (np.array(columns.get(name, []), float) for name in COLUMNS)
        return SoftObject(
            str(message["name"]),
            Characteristic("area", area_x, area_force),
            Characteristic("displacement", x, force),
            str(message["source"]),
        )


PROCESS = ("-m", "palpate.softness.process.rendering_process")
TOLD = GoneWords(
    "the process that renders is gone: the devices' own watchdogs vent the chamber and drop the arm's force. "
    "Take the finger away",
    "the process that renders does not answer: it hangs, and the devices' own watchdogs vent the chamber and "
    "drop the arm's force. Take the finger away, and use the switch",
    "take the finger away: the process that renders has not let go of the devices",
)
ENDS_S = 2.0  # in which it says that it has ended
QUIET_S = 5.0  # in which the process tells something
KEPT = 6000  # samples, of a minute


class RenderingSession(Closing):
    """Renders an object on a bench until closed; `peak_n` and `frequency_hz` are of the virtual finger."""

    def __init__(
        self, bench: BenchFile, soft: SoftObject, mode: Mode, peak_n: float = 1.0, frequency_hz: float = 1.0
    ) -> None:
        self.told_s = time.monotonic()
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._samples: deque[LoopSample] = deque(maxlen=KEPT)
        self._status = RenderingStatus("opens", "", soft.name, mode, simulated=bench.simulated)
        first = {
            "name": bench.name, "bench": bench.model_dump(mode="json"), "mode": mode.value,
            "peak_N": peak_n, "frequency_Hz": frequency_hz, "object": list(object_messages(soft)),
        }  # fmt: skip
        self._link = ProcessLink(PROCESS, first, TOLD)
        self.law: RenderingLaw = law_of_row(self._link.facts, soft)
        self._hearing = threading.Thread(target=self._hear, name="palpate-rendering-hears", daemon=True)
        self._hearing.start()

    @property
    def pid(self) -> int:
        """Id of the process that renders."""
        return self._link.pid

    def status(self) -> RenderingStatus:
        """The newest that it told."""
        with self._lock:
            return self._status

    def taken(self) -> list[LoopSample]:
        """Periods since the last call, one of ten; of the last minute at most."""
        with self._lock:
            samples, self._samples = list(self._samples), deque(maxlen=KEPT)
        return samples

    def show(self, soft: SoftObject) -> None:
        """Turn into another object, in the same mode."""
        law = law_of_row(self._link.facts, soft)  # what cannot be is refused before anything is sent
        *pieces, last = object_messages(soft)
        for piece in pieces:
            self._link.tell(**piece)
        self._link.ask(**last)
        self.law = law

    def stop(self) -> RenderingStatus:
        """End the rendering, and say how it stood; the session tells that until it is closed."""
        self._link.tell("command", command=OperatorCommand.STOP)
        self._ended.wait(ENDS_S)
        return self.status()

    def estop(self) -> None:
        """Emergency stop: the chamber is vented and the arm brakes, past whatever goes on."""
        self._link.tell("command", command=OperatorCommand.ESTOP)

    def close(self) -> None:
        """End, and wait until the devices were let go."""
        self._link.close()
        self._hearing.join()

    def _hear(self) -> None:
        try:
            while True:
                event = self._link.next_event(QUIET_S)
                if "status" in event:
                    self._link.tell("heard")
                    self._take(status_of(event["status"]), list(map(loop_sample, event["samples"])))
        except PalpateError as e:
            now = self.status()
            if now.state != "ended":
                self._take(replace(now, state="ended", why=str(e)), [])

    def _take(self, status: RenderingStatus, samples: list[LoopSample]) -> None:
        self.told_s = time.monotonic()
        with self._lock:
            self._status = status
            self._samples.extend(samples)
        if status.state == "ended":
            self._ended.set()
