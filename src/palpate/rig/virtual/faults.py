"""What can go wrong on a virtual rig, by configuration: one kind, from one instant on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from palpate.core.clock import NS_PER_S
from palpate.core.errors import InputError

Kind = Literal[
    "force-stalls",  # no sample comes any more
    "force-saturates",  # the sensor says so, and its numbers mean nothing
    "force-gone",  # the device does not answer
    "force-spike",  # one sample of 1000 N
    "force-noisy",  # a hundred times the noise
    "force-reversed",  # the sign along z is the other one
    "stage-gone",  # the device does not answer; what was begun goes on
    "stage-stuck",  # it stands, and says that it moves
    "stage-slips",  # it loses 0.1 mm of every move
    "stage-deaf",  # it does not stop when told to
    "camera-gone",
    "camera-frozen",  # the same frame again and again
    "camera-resized",  # frames of another size
    "camera-stalls",  # no frame comes any more
    "camera-drops",  # every other frame is lost
    "layer-gone",  # there is nothing to touch
]


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes:
        kind: which.
        after_s: on the rig's clock, from its start [s].
    """

    kind: Kind
    after_s: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise InputError(f"no fault is called {self.kind!r}; there are {', '.join(get_args(Kind))}")


class Faults:
    """Those of a rig, asked for by their kind."""

    def __init__(self, faults: Sequence[Fault], begun_ns: int) -> None:
        self._from_ns: dict[str, int] = {}
        for fault in faults:
            at_ns = begun_ns + round(fault.after_s * NS_PER_S)
            self._from_ns[fault.kind] = min(at_ns, self._from_ns.get(fault.kind, at_ns))

    def on(self, kind: Kind, now_ns: int) -> bool:
        """Whether it has set in."""
        return kind in self._from_ns and now_ns >= self._from_ns[kind]

    def since(self, kind: Kind) -> int | None:
        """When it sets in [ns]; None where it never does."""
        return self._from_ns.get(kind)
