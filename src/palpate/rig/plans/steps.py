"""What a plan asks of the engine, one step after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple


class Shot(NamedTuple):
    """One keyed group of frames: what a resumed recording is told by.

    Attributes:
        place: its name.
        cycle: which press at this place, from 1.
        phase: such as "reference", "down", "up", "hold", "lateral" or "sweep".
        depth_um: below the local zero, as commanded [um]: whole, so that keys compare.
        turn: which step of the phase at this depth, from 0.
    """

    place: str
    cycle: int
    phase: str
    depth_um: int
    turn: int = 0

    @property
    def key(self) -> str:
        """As text, unique in its plan."""
        return f"{self.place}/{self.cycle}/{self.phase}/{self.depth_um}/{self.turn}"


@dataclass(frozen=True, slots=True)
class Over:
    """Lift to the clearance, and go over a place."""

    x_m: float
    y_m: float


@dataclass(frozen=True, slots=True)
class Tare:
    """Measure the force sensor's zero, in the air."""


@dataclass(frozen=True, slots=True)
class Seek:
    """Step down until the normal force passes the threshold: the local zero."""


@dataclass(frozen=True, slots=True)
class Depth:
    """Go to a depth below the local zero, guarded where it leads into the skin."""

    depth_m: float
    speed_m_s: float


@dataclass(frozen=True, slots=True)
class Aside:
    """Shift by so much from the place's own x and y, at the depth there is."""

    x_m: float
    y_m: float
    speed_m_s: float


@dataclass(frozen=True, slots=True)
class Pause:
    """Let time pass."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Burst:
    """Record frames of one shot; those in `missing` alone.

    Attributes:
        missing: which of its frames, counted from 0.
        every_s: between frames; 0 for as fast as the camera gives them.
    """

    shot: Shot
    missing: tuple[int, ...]
    every_s: float = 0.0
    labels: dict[str, float | str | bool] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Sweep:
    """Move down at one speed to a force or a depth, recording all the while; then back up alike.

    Attributes:
        until_n: force at which it turns round; None for at the depth alone.
        depth_m: at which it turns round at the latest, below where it started.
    """

    shot: Shot
    speed_m_s: float
    depth_m: float
    until_n: float | None = None
    labels: dict[str, float | str | bool] = field(default_factory=dict)


Step = Over | Tare | Seek | Depth | Aside | Pause | Burst | Sweep
Steps = Iterator[Step]
Done = dict[str, frozenset[int]]
"""Shot's key -> which of its frames are recorded."""
