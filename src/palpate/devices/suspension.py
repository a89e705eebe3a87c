"""Sleep of the computer: while it was suspended nobody watched, and its monotonic clock stood still.

Steps of the wall clock do not matter, since nothing here reads it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from palpate.devices.motion_limits import Reason, Tripped

ALLOWED_S = 0.1  # by which the two clocks may come apart: reading one after the other


def asleep_s() -> float | None:
    """How long the computer has slept since it started [s]; None where the system does not say.

    Linux: CLOCK_BOOTTIME runs on in suspension and CLOCK_MONOTONIC does not (clock_gettime(2)).
    """
    boot = getattr(time, "CLOCK_BOOTTIME", None)
    return None if boot is None else time.clock_gettime(boot) - time.monotonic()


class SleepWatch:
    """Trips at the first look after the computer slept."""

    def __init__(self, slept: Callable[[], float | None] = asleep_s) -> None:
        self._slept = slept
        self._before = slept()

    def look(self) -> None:
        """Compare the clocks."""
        now, before = self._slept(), self._before
        self._before = now
        if now is not None and before is not None and now - before > ALLOWED_S:
            raise Tripped(
                Reason.CLOCKS,
                f"the computer was suspended for {now - before:.1f} s, and nobody watched the force: keep it "
                "from sleeping while it records",
            )
