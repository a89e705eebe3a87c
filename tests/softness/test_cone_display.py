"""The contact-area display: the work of its pressure, and its rings."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import RangeError
from palpate.softness import ConeDisplay

WAY = np.linspace(0.0, 10e-3, 3601)


def test_the_prototype_has_the_printed_areas_and_volume() -> None:
    cone = ConeDisplay()
    assert_allclose(1e6 * cone.area_m2(np.array([2e-3, 5e-3, 10e-3])), [5.3093, 33.1831, 132.7323], atol=1e-4)
    assert_allclose(1e9 * cone.volume_m3(0.0), 442.4, atol=0.05)


@pytest.mark.parametrize("rings", [0, 1, 2, 5, 9])
def test_pressure_times_area_is_the_work_of_the_volume(rings: int) -> None:
    display = ConeDisplay(rings=rings)
    middle = (WAY[1:] + WAY[:-1]) / 2
    fall = -np.diff(display.volume_m3(WAY)) / np.diff(WAY)
    assert_allclose(fall, display.area_m2(middle), atol=1e-3 * display.greatest_m2 / max(rings, 1))
    assert_allclose(display.volume_m3(display.height_m), 0.0, atol=1e-15)


def test_rings_step_around_their_cone_and_meet_it_as_they_grow_finer() -> None:
    inside = WAY[1:-1]
    for rings in (4, 400):
        gap = np.sqrt(ConeDisplay(rings=rings).area_m2(inside) / math.pi) - 0.65 * inside
        assert gap.min() >= -1e-12
        assert_allclose(gap.max(), 6.5e-3 / rings, rtol=2e-2)
    steps = np.unique(ConeDisplay(rings=4).area_m2(inside))
    assert_allclose(steps, math.pi * (6.5e-3 * np.arange(1, 5) / 4) ** 2)


@pytest.mark.parametrize("way_m", [-1e-6, 10.1e-3, math.nan])
def test_ways_that_the_tip_cannot_go_are_refused(way_m: float) -> None:
    with refused("way", RangeError, match="10 mm"):
        ConeDisplay().area_m2(way_m)
    with pytest.raises(RangeError, match="mm²"):
        ConeDisplay().pushed_m(way_m)
