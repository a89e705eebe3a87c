import math
from dataclasses import replace

import numpy as np
import pytest

from palpate.core import Pose, Probe
from palpate.sensors import palm
from palpate.sensors.palm import mirror_view

SPEC, FULL = palm.small(), palm.palm()
BALL = Probe("sphere", SPEC.indenter_radius_m)


def seen(depth_m, x_m=0.0, y_m=0.0, spec=SPEC):
    return mirror_view.trace_mirror(spec, depth_m, x_m, y_m)


def by_snell(spec, depth_m, x_m, y_m):
    """Where a line of sight to (x, y) at that depth crosses the underside, on the image [px]."""
    outside = math.pi / 2 - spec.mirror_elevation_rad  # from the underside's normal
    inside = math.asin(math.sin(outside) / spec.refractive_index)
    enters = y_m + (spec.thickness_m - depth_m) * math.tan(inside)
    across = math.cos(outside) * enters  # the underside is seen at a slant
    return np.array(spec.mirror.middle_px) + np.array([x_m, across]) / spec.mirror.pitch_m


def brightest(grey, near_px):
    """Middle of the brightest pixels near a place: of what faces the line of sight most squarely [px]."""
    down, x = np.mgrid[: grey.shape[0], : grey.shape[1]] + 0.5
    near = np.hypot(x - near_px[0], down - near_px[1]) < 60
    among = near & (grey > 0.995 * grey[near].max())
    return np.array([x[among].mean(), down[among].mean()])


@pytest.mark.parametrize(("depth_m", "place"), [(1e-3, (-8e-3, 5e-3)), (5e-3, (4e-3, -3e-3))])
def test_the_ball_s_lowest_point_is_where_snell_s_law_puts_it(depth_m, place):
    wanted = by_snell(FULL, depth_m, *place)
    found = brightest(seen(depth_m, *place, spec=FULL), wanted)
    assert np.hypot(*(found - wanted)) < 1.0  # 0.25 is measured: the brightest 106 pixels' middle


@pytest.mark.parametrize(("index", "place"), [(1.0, (0.0, 0.0)), (1.55, (7e-3, -5e-3))])
def test_the_place_given_for_a_contact_is_snell_s(place, index):
    spec = replace(FULL, refractive_index=index)
    found = mirror_view.contact_px(spec, *place, depth_m=2e-3)
    np.testing.assert_allclose(found, by_snell(spec, 2e-3, *place), atol=1e-9)


@pytest.mark.parametrize(("depth_m", "place"), [(0.5e-3, (5e-3, -4e-3)), (3e-3, (-9e-3, 3e-3))])
def test_the_moved_patch_shows_what_tracing_every_pixel_does(depth_m, place):
    moved, traced = mirror_view.shift_mirror(SPEC, depth_m, *place), seen(depth_m, *place)
    assert np.sqrt(np.mean((moved - traced) ** 2)) < 5e-3  # the contact's sharp edge, moved by part pixels


@pytest.mark.parametrize("way", [mirror_view.trace_mirror, mirror_view.shift_mirror])
def test_an_opaque_underside_hides_the_contact(way):
    covered = replace(SPEC, opaque_underside=True)
    at_rest = way(covered, 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(way(covered, 3e-3, 4e-3, -2e-3), at_rest)
    assert abs(way(SPEC, 3e-3, 4e-3, -2e-3) - at_rest).max() > 0.1
    punch = palm.press(covered, Pose(0.0, 0.0, 1e-3), palm.parse_probe("punch:6"))
    np.testing.assert_array_equal(mirror_view.trace_contact(covered, punch), at_rest)


UNSEEN = replace(SPEC, probe_in_mirror=False)


@pytest.mark.parametrize("way", [mirror_view.trace_mirror, mirror_view.shift_mirror])
def test_out_of_sight_a_probe_s_own_look_changes_nothing_and_its_dimple_is_left(way):
    dimple, black = (way(replace(UNSEEN, ball_albedo=a), 3e-3, 4e-3, -2e-3) for a in (0.5, 0.0))
    np.testing.assert_array_equal(dimple, black)
    assert abs(dimple - way(SPEC, 3e-3, 4e-3, -2e-3)).max() > 0.1
    assert abs(dimple - way(SPEC, 0.0, 0.0, 0.0)).max() > 0.1


@pytest.mark.parametrize("place", [(5e-3, -4e-3)])
@pytest.mark.parametrize("changed", [{"probe_in_mirror": False}, {"membrane": False}])
def test_without_probe_or_membrane_the_moved_patch_shows_what_tracing_does(changed, place):
    spec = replace(SPEC, **changed)
    moved, traced = mirror_view.shift_mirror(spec, 3e-3, *place), mirror_view.trace_mirror(spec, 3e-3, *place)
    assert np.sqrt(np.mean((moved - traced) ** 2)) < 5e-3  # as with both


@pytest.mark.parametrize("depth_m", [-2e-3, 3e-3])
def test_without_a_membrane_the_ball_is_a_round_disc_where_a_straight_line_of_sight_puts_it(depth_m):
    air, place = replace(FULL, membrane=False), (6e-3, -3e-3)
    grey = mirror_view.trace_mirror(air, depth_m, *place)
    empty = mirror_view.trace_mirror(air, 0.0, *place)
    inside = mirror_view.inside_rim(FULL)
    assert np.ptp(empty[inside]) == 0
    down, x = np.nonzero(grey != empty)
    pitch, R = FULL.mirror.pitch_m, FULL.indenter_radius_m
    assert np.ptp(x) * pitch == pytest.approx(2 * R, abs=2 * pitch)
    assert np.ptp(down) * pitch == pytest.approx(2 * R, abs=2 * pitch)
    up = FULL.mirror_elevation_rad
    enters = place[1] + (FULL.thickness_m - depth_m + R) / math.tan(up)  # the line through its middle
    cx, cy = FULL.mirror.middle_px
    assert x.mean() + 0.5 == pytest.approx(cx + place[0] / pitch, abs=0.5)
    assert down.mean() + 0.5 == pytest.approx(cy + enters * math.sin(up) / pitch, abs=0.5)


def test_a_contact_s_own_grid_shows_the_ball_where_the_table_does():
    pose = Pose(3e-3, 2e-3, 0.3e-3)
    layers = mirror_view.trace_contact(SPEC, palm.press(SPEC, pose, BALL, (1e-6, 0.0)))
    table = seen(0.3e-3, 3e-3, 2e-3)
    x, y = mirror_view.contact_px(SPEC, 3e-3, 2e-3, 0.3e-3)
    down, right = np.mgrid[: table.shape[0], : table.shape[1]] + 0.5
    under = np.hypot(right - x, down - y) * SPEC.mirror.pitch_m < 0.8e-3  # the contact's radius is 1.3 mm
    assert under.any()
    np.testing.assert_allclose(layers[under], table[under], atol=5e-3)
