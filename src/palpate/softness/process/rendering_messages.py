"""Messages between a rendering process and its client; an object is sent in pieces of one line each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from typing import Any

import numpy as np

from palpate.core import Float, ProtocolError, ndarray
from palpate.softness.characteristics import Characteristic, SoftObject
from palpate.softness.cone_display import ConeDisplay
from palpate.softness.control.rendering_loop import LoopSample
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
