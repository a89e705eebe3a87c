"""Memory of a process that serves a device for hours: short searches of it, and none kept for nothing.

Sleep of the computer: while it was suspended nobody watched, and its monotonic clock stood still.

Steps of the wall clock do not matter, since nothing here reads it.
"""

from __future__ import annotations

import ctypes
import gc
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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


def keep_loaded() -> None:
    """Leave what is loaded now out of Python's searches for objects that nobody uses any more.

    Modules, tables and calibrations stay for as long as the process does, and yet each search went through
    all of them: 70 ms and more every few minutes, in which no frame is read and no page is told. Call it once
    all of that is loaded; what is made later is searched as ever.
    """
    gc.collect()  # what is unused already would be kept as well
    gc.freeze()


@contextmanager
def loaded_kept() -> Iterator[None]:
    """The same for a while, after which the process goes on to something else and searches all again.

    What refers to itself, as a sensor that was read and closed, would stay as long as the process. Where
    something is left out of searches already, that is whoever's who did it, and nothing is changed.
    """
    mine = gc.get_freeze_count() == 0
    if mine:
        keep_loaded()
    try:
        yield
    finally:
        if mine:
            gc.unfreeze()


def give_back_memory() -> None:
    """Give freed memory back to the system where the C library can, as glibc's.

    Images of a frame are made and freed all day; the holes between them would stay with the process.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:
        trim(0)
