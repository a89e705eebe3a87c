"""Memory of a process that serves a device for hours."""

import ctypes
import os
import subprocess
import sys

import numpy as np
import pytest

from palpate.devices.long_running import give_back_memory

LAWS = """
import gc, weakref
from palpate.devices.long_running import keep_loaded, loaded_kept


class Ring:
    def __init__(self):
        self.itself = self  # so that only a search finds it unused


def found_unused(after=lambda: None):
    ring = Ring()
    there = weakref.ref(ring)
    del ring
    after()
    return there() is None


held = [Ring() for _ in range(1000)]
before = len(gc.get_objects())
assert found_unused(keep_loaded), "what is unused already is not kept"
assert gc.get_freeze_count() > 1000
assert len(gc.get_objects()) < before - 1000, "what is loaded is searched no more"
assert found_unused(gc.collect), "what is made later is searched as ever"
left_out = gc.get_freeze_count()
with loaded_kept():
    pass
assert gc.get_freeze_count() >= left_out - 100, "what another left out of searches stays left out"
gc.unfreeze()
ring = Ring()
there = weakref.ref(ring)
with loaded_kept():
    del ring
    gc.collect()
    assert there() is not None, "what was kept is not found"
gc.collect()
assert there() is None, "what was kept for a while is found once that is over"
"""


def test_what_is_loaded_is_searched_no_more_and_all_else_is() -> None:
    # In a process of its own: a search of all that pytest holds takes seconds.
    done = subprocess.run([sys.executable, "-c", LAWS], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="memory in use is read from /proc")
@pytest.mark.skipif(
    os.name != "posix" or not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="not the GNU C library"
)
def test_memory_that_was_freed_goes_back_to_the_system_though_something_behind_it_is_kept() -> None:
    def resident_bytes() -> int:
        with open("/proc/self/statm") as told:
            return int(told.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    held = [np.ones(60_000, np.uint8) for _ in range(2_000)]
    last = held[-1]
    full = resident_bytes()
    del held
    freed = resident_bytes()
    give_back_memory()
    assert last.sum() == 60_000
    assert resident_bytes() < full - 80e6
    assert resident_bytes() < freed - 80e6  # which freeing alone had not done
