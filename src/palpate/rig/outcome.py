"""What became of a recording, and what stops one: every stop has a name."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from palpate.core.errors import SafetyError
from palpate.recordings.align import Offset


class State(StrEnum):
    """Where the engine is."""

    READY = "ready"
    RUNNING = "running"
    PAUSED = "paused"
    DONE = "done"  # every shot of the plan is recorded
    STOPPED = "stopped"  # the operator ended it after a press; to be resumed
    ABORTED = "aborted"  # the operator ended it at once; to be resumed
    ESTOPPED = "e-stopped"  # the operator's emergency stop: nothing moves, also not away
    FAILED = "failed"  # a guard or a device ended it; the reason says which


class Reason(StrEnum):
    """What ends a recording that should have gone on."""

    FORCE_LIMIT = "force-limit"
    FORCE_RATE = "force-rate"
    FORCE_STALE = "force-stale"
    FORCE_FAULT = "force-fault"
    FORCE_NOISE = "force-noise"
    TOUCHED_EARLY = "touched-early"
    NO_CONTACT = "no-contact"
    SOFT_LIMIT = "soft-limit"
    TOO_FAST = "too-fast"
    STAGE = "stage"
    STAGE_LATE = "stage-late"
    CAMERA = "camera"
    FORCE_SENSOR = "force-sensor"
    CLOCKS = "clocks"
    STORAGE = "storage"
    PLAN = "plan"


class Tripped(SafetyError):  # noqa: N818 - a guard trips
    """A guard stopped a motion, or refused it.

    Attributes:
        reason: which guard.
    """

    def __init__(self, reason: Reason, message: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a recording ended.

    Attributes:
        state: done, stopped, aborted, e-stopped or failed.
        reason: of a failure.
        message: what happened, with numbers and units.
        shots: recorded so far, over all segments; planned: all of the plan's.
        clocks: how far the frames run behind the force, from taps; None where there were none.
    """

    state: State
    shots: int
    planned: int
    reason: Reason | None = None
    message: str = ""
    clocks: Offset | None = None
