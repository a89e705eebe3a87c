"""Memory of a process that serves a device for hours: short searches of it, and none kept for nothing."""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager


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
