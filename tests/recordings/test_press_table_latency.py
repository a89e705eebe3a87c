"""A press's table made earlier by the camera's latency."""

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import RangeError
from palpate.recordings.exchange.press_table import PressTable

T = np.arange(0.0, 2.0, 0.005)
FRAMES = np.arange(0, 400, 10)


def table(area=None) -> PressTable:
    force, position = np.clip(T - 0.5, 0, None), 2e-3 * T
    return PressTable(T, force, position, area, FRAMES, "force_N", "actual_mm", None, False)


def test_late_frames_get_force_and_position_of_that_time_before() -> None:
    late = table().earlier(0.0425)  # between two samples
    assert late.force_n[200] == pytest.approx(T[200] - 0.0425 - 0.5)
    assert late.position_m[200] == pytest.approx(2e-3 * (T[200] - 0.0425))
    assert late.force_n[0] == 0  # rests before the first sample
    assert len(late.frame_sample) == len(FRAMES)
    back = table().earlier(-0.0425)
    assert back.force_n[200] == pytest.approx(T[200] + 0.0425 - 0.5)
    assert back.frame_sample[-1] == 390  # 1.95 s + 42.5 ms is inside the 1.995 s
    assert len(table().earlier(-0.05).frame_sample) == len(FRAMES) - 1
    assert table().earlier(0.0).force_n is not None
    with refused("latency", RangeError, match=r"3\.0 s"):
        table().earlier(3.0)


def test_a_simulators_area_goes_with_its_samples_and_a_frames_own_with_its_frame() -> None:
    assert table(T**2).earlier(0.05).area_m2[200] == pytest.approx((T[200] - 0.05) ** 2, abs=1e-4)
    single = np.full(len(T), np.nan)
    single[200] = 3.0
    assert table(single).earlier(0.05).area_m2[200] == 3.0
