"""Memory of a process that serves a device for hours."""

from __future__ import annotations

import ctypes
import gc
import os
import weakref

import numpy as np
import pytest

from palpate.devices.process_memory import give_back_memory, keep_loaded, loaded_kept


class Ring:
    """Object that refers to itself, so that only a search finds it unused."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture
def searched():
    """All objects are searched in a test, and as many left out after it as before."""
    left_out = gc.get_freeze_count()
    gc.unfreeze()
    yield
    gc.unfreeze()
    if left_out:
        keep_loaded()


def test_what_is_loaded_is_searched_no_more(searched) -> None:
    held = [Ring() for _ in range(100_000)]
    before = len(gc.get_objects())
    keep_loaded()
    assert gc.get_freeze_count() > 100_000
    assert len(gc.get_objects()) < before - 100_000
    assert len(held) == 100_000


def test_what_is_unused_already_is_not_kept(searched) -> None:
    ring = Ring()
    there = weakref.ref(ring)
    del ring
    keep_loaded()
    assert there() is None


def test_what_is_made_later_is_searched_as_ever(searched) -> None:
    keep_loaded()
    ring = Ring()
    there = weakref.ref(ring)
    del ring
    gc.collect()
    assert there() is None


@pytest.mark.slow
def test_what_was_kept_for_a_while_is_found_once_that_is_over(searched) -> None:
    ring = Ring()
    there = weakref.ref(ring)
    with loaded_kept():
        del ring
        gc.collect()
        assert there() is not None  # the control
    gc.collect()
    assert there() is None


@pytest.mark.slow
def test_what_another_has_left_out_of_searches_stays_left_out(searched) -> None:
    keep_loaded()
    left_out = gc.get_freeze_count()
    with loaded_kept():
        pass
    assert gc.get_freeze_count() >= left_out - 100


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
