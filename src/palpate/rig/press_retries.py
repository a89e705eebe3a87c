"""Retries of a press that a transient fault ended: which faults are transient, and how many are allowed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palpate.core import RangeError
from palpate.devices import Reason

REJECTED = "rejected"
"""Event of an attempt that a transient fault ended; none of its frames counts."""

TRANSIENT = frozenset(
    {
        Reason.FORCE_STALE,
        Reason.FORCE_LATE,
        Reason.FORCE_SLOW,  # a gap leaves fewer samples than are due
        Reason.FORCE_SENSOR,
        Reason.CAMERA,
        Reason.CLIENT_SILENT,
    }
)
"""Reasons that a short silence or delay of a device, a link, or the recorder may have.

Everything else ends the run: a force beyond its limit, saturation, an implausible force, a zero that does not
return, a stage that lost its position, a stop by hand."""


@dataclass(frozen=True, slots=True)
class RetryLimits:
    """Number of times that presses are repeated after a transient fault.

    Attributes:
        per_press: repetitions of one press; 0 for none.
        per_session: repetitions of all presses until the recording ends or is resumed.
        wait_s: wait at the clearance before a repetition; n times as long before the n-th of a press [s].

    Raises:
        RangeError: a negative number, or a wait that is not finite.
    """

    per_press: int = 3
    per_session: int = 20
    wait_s: float = 1.0

    def __post_init__(self) -> None:
        if not (self.per_press >= 0 and self.per_session >= 0 and 0 <= self.wait_s < math.inf):
            raise RangeError(
                f"retries of {self.per_press} per press, {self.per_session} per session, and a wait of "
                f"{self.wait_s:g} s; all must be 0 or more"
            )

    def allow(self, reason: Reason, attempt: int, retries: int) -> bool:
        """Return whether a press is repeated.

        Args:
            reason: code of the fault that ended the attempt.
            attempt: number of the attempt at this press, from 1.
            retries: repetitions of all presses so far in this session.
        """
        return reason in TRANSIENT and attempt <= self.per_press and retries < self.per_session
