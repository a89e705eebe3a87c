"""Fringe orders frame by frame, as frames come from an image, a folder, a run, a video or a TIFF."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from palpate.core import Frame, Image, InputError
from palpate.estimators.fringe_map import OrderMap
from palpate.sensing.frame_sources import Unreadable


@runtime_checkable
class OrderReader(Protocol):
    """What makes a map of one frame; `ColourReader` and `CameraReader` do."""

    def read(self, image: Image, before: OrderMap | None = None) -> OrderMap:
        """Map of a frame, which goes on from the one before where that is given."""


@dataclass(frozen=True, slots=True, eq=False)
class MappedFrame:
    """Fringe orders of one frame.

    Attributes:
        time_s: Capture time, or the index without a clock [s].
        reason: Reason why there is no map; empty otherwise.
        latency_s: Time from the decoded image to the map [s].
    """

    index: int
    name: str
    time_s: float
    frame: Frame | None
    found: OrderMap | None
    reason: str = ""
    latency_s: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        head: dict[str, Any] = {"frame": self.name, "time_s": self.time_s, "read": self.found is not None}
        if self.found is None:
            return {**head, "why": self.reason}
        return {**head, "why": "", "latency_ms": round(1e3 * self.latency_s, 2), **self.found.summary()}


def read_orders(
    frames: Iterable[Frame | Unreadable], reader: OrderReader, *, follow: bool = True
) -> Iterator[MappedFrame]:
    """Fringe orders of each frame, in order; one that cannot be read says why and does not end the sequence.

    Args:
        follow: each frame goes on from the one before, as far as light allows.
    """
    before: OrderMap | None = None
    for i, frame in enumerate(frames):
        if isinstance(frame, Unreadable):
            yield MappedFrame(i, frame.name, frame.time_s, None, None, frame.why)
            continue
        name = frame.name or str(i)
        started = time.perf_counter()
        try:
            found = reader.read(frame.image, before if follow else None)
        except InputError as refusal:
            if i == 0:
                raise
            yield MappedFrame(i, name, frame.time_s, frame, None, str(refusal))
            continue
        before = found
        yield MappedFrame(i, name, frame.time_s, frame, found, latency_s=time.perf_counter() - started)
