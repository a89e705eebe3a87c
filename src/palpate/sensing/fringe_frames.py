"""Fringe orders frame by frame, as frames come from an image, a folder, a run, a video or a TIFF."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from palpate.core import Frame, Image, InputError
from palpate.estimators.fringe_map import OrderMap


@runtime_checkable
class OrderReader(Protocol):
    """What makes a map of one frame; `ColourReader` and `CameraReader` do."""

    def read(self, image: Image, before: OrderMap | None = None) -> OrderMap:
        """Map of a frame, which goes on from the one before where that is given."""


@dataclass(frozen=True, slots=True, eq=False)
class MappedFrame:
    """Fringe orders of one frame.

    Attributes:
        reason: Reason why there is no map; empty otherwise.
        latency_s: Time from the decoded image to the map [s].
    """

    index: int
    frame: Frame
    found: OrderMap | None
    reason: str = ""
    latency_s: float = 0.0

    @property
    def name(self) -> str:
        """Name of the frame; its index where it has none."""
        return self.frame.name or str(self.index)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        head: dict[str, Any] = {
            "frame": self.name,
            "time_s": self.frame.time_s,
            "read": self.found is not None,
        }
        if self.found is None:
            return {**head, "why": self.reason}
        return {**head, "why": "", "latency_ms": round(1e3 * self.latency_s, 2), **self.found.summary()}


def read_orders(
    frames: Iterable[Frame], reader: OrderReader, *, follow: bool = True
) -> Iterator[MappedFrame]:
    """Fringe orders of each frame, in order; one that cannot be read says why and does not end the sequence.

    Args:
        follow: each frame goes on from the one before, as far as light allows.
    """
    before: OrderMap | None = None
    for i, frame in enumerate(frames):
        if frame.fault:
            yield MappedFrame(i, frame, None, frame.fault)
            continue
        started = time.perf_counter()
        try:
            found = reader.read(frame.image, before if follow else None)
        except InputError as refusal:
            if i == 0:
                raise
            yield MappedFrame(i, frame, None, str(refusal))
            continue
        before = found
        yield MappedFrame(i, frame, found, latency_s=time.perf_counter() - started)
