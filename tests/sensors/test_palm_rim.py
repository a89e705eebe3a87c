from dataclasses import replace

import numpy as np
import pytest

from palpate.sensors import palm
from palpate.sensors.palm import fringe_view

SPEC = palm.debug()


def outermost(spec):
    wide = replace(
        spec.fringes, box_px=(0, 0, 8001, 8), pitch_m=spec.diameter_m / 8001, middle_px=(4000.5, 1)
    )
    return fringe_view.columns(spec, wide)


def test_no_ray_runs_further_from_the_axis_than_the_radius_over_the_index():
    assert abs(outermost(SPEC).impact_m).max() == pytest.approx(28.5e-3 / 1.41, rel=1e-3)  # 20.2 mm
    straight = replace(SPEC, rim_refracts=False)
    assert abs(outermost(straight).impact_m).max() == pytest.approx(28.5e-3, rel=1e-3)


PLACES = [(x, y) for x in range(-28, 29, 4) for y in range(-28, 29, 4) if x**2 + y**2 < 28**2]


def test_what_is_seen_is_what_some_column_looks_at():
    rays = outermost(SPEC)
    for x, y in PLACES:
        offset, _, _ = rays.about(x * 1e-3, y * 1e-3)
        crosses = offset.min() < 0 < offset.max()
        assert fringe_view.sees(SPEC, x * 1e-3, y * 1e-3) == crosses, (x, y)


def test_a_place_not_seen_is_so_within_its_distance_from_the_grazing_ray():
    # the ray through (R, 0), turned by acos(1/n): (18, -14) mm lies 2.42 mm beyond it
    beyond = (18 + 14 * np.sqrt(1.41**2 - 1) - 28.5) / 1.41 * 1e-3
    assert not fringe_view.sees(SPEC, 18e-3, -14e-3, 0.98 * beyond)
    assert fringe_view.sees(SPEC, 18e-3, -14e-3, 1.02 * beyond)
