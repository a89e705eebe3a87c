import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from palpate.core import Pose, Probe
from palpate.sensors import palm
from palpate.sensors.palm import mirror_view

SPEC, FULL = palm.small(), palm.palm()
BALL = Probe("sphere", SPEC.indenter_radius_m)


def seen(depth_m, x_m=0.0, y_m=0.0, spec=SPEC):
    return mirror_view.trace_mirror(spec, depth_m, x_m, y_m)


def layered(words, depth_m=0.8e-3):
    return mirror_view.trace_contact(SPEC, palm.press(SPEC, Pose(0.0, 0.0, depth_m), palm.parse_probe(words)))


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


@pytest.mark.parametrize("index", [1.0, 1.41, 1.55])
@pytest.mark.parametrize("place", [(0.0, 0.0), (7e-3, -5e-3)])
def test_the_place_given_for_a_contact_is_snell_s(place, index):
    spec = replace(FULL, refractive_index=index)
    found = mirror_view.contact_px(spec, *place, depth_m=2e-3)
    np.testing.assert_allclose(found, by_snell(spec, 2e-3, *place), atol=1e-9)


def test_looking_straight_up_a_contact_is_where_it_is():
    upright = replace(FULL, mirror_elevation_rad=math.pi / 2)
    cx, cy = FULL.mirror.middle_px
    assert mirror_view.contact_px(upright, 2e-3, -1e-3) == pytest.approx((cx + 20, cy - 10))


@pytest.mark.parametrize("place", [(0.0, 0.0), (5e-3, -4e-3), (-9e-3, 3e-3)])
@pytest.mark.parametrize("depth_m", [0.5e-3, 3e-3])
def test_the_moved_patch_shows_what_tracing_every_pixel_does(depth_m, place):
    moved, traced = mirror_view.shift_mirror(SPEC, depth_m, *place), seen(depth_m, *place)
    assert np.sqrt(np.mean((moved - traced) ** 2)) < 5e-3  # the contact's sharp edge, moved by part pixels


@pytest.mark.parametrize("way", [mirror_view.trace_mirror, mirror_view.shift_mirror])
def test_the_dimple_moves_with_the_contact(way):
    at_rest = way(SPEC, 0.0, 0.0, 0.0)

    def middle(x_m, y_m):
        change = abs(way(SPEC, 2e-3, x_m, y_m) - at_rest)
        down, x = np.mgrid[: change.shape[0], : change.shape[1]]
        return np.array([(x * change).sum(), (down * change).sum()]) / change.sum()

    here = middle(0.0, 0.0)  # to a fifth of a pixel: the contact's edge is sharper than the pixels
    pitch = SPEC.mirror.pitch_m
    # to the right goes right; towards the camera goes down, foreshortened by the slant
    np.testing.assert_allclose(middle(4e-3, 0.0) - here, [4e-3 / pitch, 0], atol=0.2)
    slant = math.sin(SPEC.mirror_elevation_rad)
    np.testing.assert_allclose(middle(0.0, 3e-3) - here, [0, 3e-3 * slant / pitch], atol=0.2)


def test_a_contact_to_the_right_is_that_to_the_left_mirrored():
    np.testing.assert_allclose(seen(3e-3, 5e-3, 2e-3), seen(3e-3, -5e-3, 2e-3)[:, ::-1], atol=1e-6)


def test_a_membrane_at_rest_is_even_and_nothing_is_seen_beyond_it():
    grey = seen(0.0, 6e-3, 1e-3)
    down = SPEC.mirror.down_m / math.sin(SPEC.mirror_elevation_rad)
    inside = SPEC.mirror.x_m**2 + down[:, None] ** 2 <= SPEC.radius_m**2
    assert np.ptp(grey[inside]) < 1e-6
    assert grey[inside].min() > 0
    assert (grey[~inside] == 0).all()
    assert not inside.all()


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


@pytest.mark.parametrize("way", [mirror_view.trace_mirror, mirror_view.shift_mirror])
def test_out_of_sight_a_probe_in_the_air_is_not_there(way):
    np.testing.assert_array_equal(way(UNSEEN, -1e-3, 4e-3, -2e-3), way(UNSEEN, 0.0, 0.0, 0.0))
    assert abs(way(SPEC, -1e-3, 4e-3, -2e-3) - way(SPEC, 0.0, 0.0, 0.0)).max() > 0.1


def test_beyond_the_contact_and_the_ball_s_side_the_probe_s_body_changes_nothing():
    with_it, without = seen(3e-3), seen(3e-3, spec=UNSEEN)
    probe = with_it != without
    x, y = mirror_view.contact_px(SPEC, 0.0, 0.0, 3e-3)
    down, right = np.mgrid[: probe.shape[0], : probe.shape[1]] + 0.5
    away = np.hypot(right - x, down - y) * SPEC.mirror.pitch_m
    assert probe.any()
    assert away[probe].max() < 2 * SPEC.indenter_radius_m


def test_other_probes_can_be_out_of_sight_as_well():
    contact = palm.press(SPEC, Pose(0.0, 0.0, 0.8e-3), palm.parse_probe("punch:6"))
    dimple = mirror_view.trace_contact(UNSEEN, contact)
    np.testing.assert_array_equal(
        dimple, mirror_view.trace_contact(replace(UNSEEN, ball_albedo=0.0), contact)
    )
    # under the flat punch the surface is flat, and shows what it shows at rest
    x, y = mirror_view.contact_px(SPEC, 0.0, 0.0, 0.8e-3)
    assert dimple[int(y), int(x)] == pytest.approx(seen(0.0)[int(y), int(x)], abs=1e-3)


@pytest.mark.parametrize("place", [(0.0, 0.0), (5e-3, -4e-3), (-9e-3, 3e-3)])
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


def test_without_membrane_and_probe_the_mirror_shows_the_empty_housing():
    empty = replace(SPEC, membrane=False, probe_in_mirror=False)
    np.testing.assert_array_equal(seen(4e-3, 3e-3, spec=empty), seen(0.0, spec=empty))


def test_more_light_inside_shows_the_same_brighter():
    np.testing.assert_allclose(
        seen(2e-3, spec=replace(SPEC, inside_light=0.5)), seen(2e-3) / 2, rtol=1e-5, atol=1e-7
    )


def test_the_mirror_s_view_is_grey_and_knows_no_polariser():
    contact = palm.press(SPEC, Pose(2e-3, 1e-3, 2e-3))
    one, other = (palm.render_clean(contact, replace(SPEC, polariser_rad=a))[1] for a in (0.0, 0.6))
    np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(one[..., 0], one[..., 2])


def dimples(grey):
    """How many places touch the probe, and their middles [px]: the probe is brighter than all else."""
    count, _, _, middles = cv2.connectedComponentsWithStats((grey > 0.45).astype(np.uint8))
    return count - 1, middles[1:] + 0.5


@pytest.mark.parametrize(("words", "count"), [("two-points:4:8", 2), ("punch:6", 1), ("sphere:8", 1)])
def test_as_many_dimples_as_points_are_seen(words, count):
    assert dimples(layered(words))[0] == count


def test_two_points_are_as_far_apart_as_they_are():
    _, middles = dimples(layered("two-points:4:8"))
    assert abs(middles[1, 0] - middles[0, 0]) * SPEC.mirror.pitch_m == pytest.approx(8e-3, rel=0.02)
    _, turned = dimples(layered("two-points:4:8:90"))
    slant = math.sin(SPEC.mirror_elevation_rad)
    apart = abs(turned[1, 1] - turned[0, 1]) * SPEC.mirror.pitch_m / slant
    assert apart == pytest.approx(8e-3, rel=0.03)  # half a row of 0.46 mm either way, averaged over a dimple


def test_a_contact_s_own_grid_shows_the_ball_where_the_table_does():
    pose = Pose(3e-3, 2e-3, 0.3e-3)
    layers = mirror_view.trace_contact(SPEC, palm.press(SPEC, pose, BALL, (1e-6, 0.0)))
    table = seen(0.3e-3, 3e-3, 2e-3)
    x, y = mirror_view.contact_px(SPEC, 3e-3, 2e-3, 0.3e-3)
    down, right = np.mgrid[: table.shape[0], : table.shape[1]] + 0.5
    under = np.hypot(right - x, down - y) * SPEC.mirror.pitch_m < 0.8e-3  # the contact's radius is 1.3 mm
    assert under.any()
    np.testing.assert_allclose(layers[under], table[under], atol=5e-3)
