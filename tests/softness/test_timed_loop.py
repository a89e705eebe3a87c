"""A loop on the machine's clock begins at equal times, and makes up for none that it missed."""

import gc
import time

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import RangeError
from palpate.softness.control.timed_loop import LATE_S, LoopTiming, Pace, run_paced, run_timed


@pytest.fixture(autouse=True)
def no_search(monkeypatch) -> None:
    """A search of all that pytest holds takes seconds."""
    monkeypatch.setattr(gc, "collect", lambda: 0)


def test_a_loop_begins_once_in_a_period() -> None:
    timing = run_timed(lambda: None, 0.3)
    assert 20 < len(timing.work_s) <= 301  # a busy machine misses some, and none is too many
    assert float(timing.periods_s.sum()) == pytest.approx(0.3, abs=0.05)


def test_a_beginning_that_was_missed_is_not_made_up_for() -> None:
    calls = []

    def tick() -> None:
        calls.append(0)
        if len(calls) == 10:
            time.sleep(20.3e-3)

    timing = run_timed(tick, 0.1)
    assert timing.longest_s > 20e-3
    assert len(calls) <= 81
    assert (timing.periods_s > 0.3e-3).all()  # none follows at once


def test_a_loop_ends_when_it_is_told_to_and_passes_on_what_a_period_raises() -> None:
    left = [3]

    def goes_on() -> bool:
        left[0] -= 1
        return left[0] >= 0

    pace = Pace()
    run_paced(lambda: None, 10.0, pace.heard, goes_on)
    assert pace.periods == 2  # from one of three beginnings to the next

    def fails() -> None:
        raise ValueError("a period")

    with pytest.raises(ValueError, match="a period"):
        run_timed(fails, 1.0)
    assert gc.isenabled()


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf")])
def test_a_loop_of_no_time_is_refused(seconds: float) -> None:
    with refused("duration", RangeError, match="0 s"):
        run_timed(lambda: None, seconds)


def test_a_pace_counts_what_the_whole_list_of_times_would_say() -> None:
    begun = np.cumsum([0.0, 1e-3, 1.49e-3, 1.51e-3, 4e-3])
    pace = Pace()
    for at in begun:
        pace.heard(float(at), 0.0)
    whole = LoopTiming(np.diff(begun), np.zeros(5))
    assert pace.periods == 4
    assert pace.late_share == whole.late_share == 0.5
    assert pace.longest_s == pytest.approx(whole.longest_s)
    assert LATE_S == 1.5e-3
