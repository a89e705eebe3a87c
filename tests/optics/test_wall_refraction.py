import numpy as np
import pytest

from palpate.core import InputError, RangeError
from palpate.optics import round_rim
from palpate.optics.polariscope import fresnel

R, INDEX = 28.5e-3, 1.41


def refracted(direction, normal, ratio):
    """Snell's law as vectors; `normal` points against the ray, `ratio` is index left over index entered."""
    cos_in = -direction @ normal
    cos_out = np.sqrt(1 - ratio**2 * (1 - cos_in**2))
    return ratio * direction + (ratio * cos_in - cos_out) * normal


def traced(x, index=INDEX):
    """From the camera backwards: the two points at the walls, the inside direction and the one behind."""
    front = np.array([x, np.sqrt(R**2 - x**2)])
    inside = refracted(np.array([0.0, -1.0]), front / R, 1 / index)
    back = front - 2 * (front @ inside) * inside
    behind = refracted(inside, -back / R, index)
    return front, back, inside, behind


@pytest.mark.parametrize("x", [-27e-3, -10e-3, 0.0, 1e-3, 20e-3, 28.4e-3])
def test_each_column_is_the_ray_that_snell_s_law_traces(x):
    rays = round_rim(np.array([x]), R, INDEX)
    front, back, inside, behind = traced(x)
    phi, b = rays.turn_rad[0], rays.impact_m[0]
    np.testing.assert_allclose([np.sin(phi), np.cos(phi)], -inside, atol=1e-12)
    across = np.array([np.cos(phi), -np.sin(phi)])
    assert across @ front == pytest.approx(b, abs=1e-15) == across @ back
    assert 2 * rays.half_chord_m[0] == pytest.approx(np.linalg.norm(front - back))
    # behind the far wall the ray has turned twice
    np.testing.assert_allclose([np.sin(2 * phi), np.cos(2 * phi)], -behind, atol=1e-12)


def test_a_ray_met_backwards_is_the_same_ray():
    x = np.linspace(-28e-3, 28e-3, 41)
    rays = round_rim(x, R, INDEX)
    for i, at in enumerate(x):
        _, back, _, behind = traced(at)
        # seen along the light's own way out, the source side is a camera too: turn the picture onto it
        along = behind / np.linalg.norm(behind)  # from the skin to the source
        level = np.array([along[1], -along[0]])  # x of the camera that looks back from there
        mirrored = round_rim(np.array([level @ back]), R, INDEX)
        assert abs(mirrored.impact_m[0]) == pytest.approx(abs(rays.impact_m[i]), abs=1e-15)
        assert mirrored.half_chord_m[0] == pytest.approx(rays.half_chord_m[i])
    np.testing.assert_allclose(rays.impact_m, -rays.impact_m[::-1], atol=1e-17)
    np.testing.assert_allclose(rays.turn_rad, -rays.turn_rad[::-1], atol=1e-15)


def test_no_column_sees_beyond_the_radius_over_the_index():
    x = np.linspace(-1.2 * R, 1.2 * R, 2001)
    rays = round_rim(x, R, INDEX)
    np.testing.assert_array_equal(rays.visible, abs(x) < R)
    assert 0.998 * R / INDEX < rays.impact_m.max() < R / INDEX
    assert not rays.transmission[~rays.visible].any()
    assert not rays.half_chord_m[~rays.visible].any()


@pytest.mark.parametrize("x", [-20e-3, 3e-3, 15e-3])
@pytest.mark.parametrize("place", [(0.0, 0.0), (8e-3, -5e-3), (-3e-3, 12e-3)])
def test_an_axis_sees_the_ray_where_geometry_puts_it(x, place):
    front, back, inside, _ = traced(x)
    offset, start, end = (part[0] for part in round_rim(np.array([x]), R, INDEX).about(*place))
    light = -inside
    for wall, at in ((back, start), (front, end)):
        assert (wall - place) @ light == pytest.approx(at, abs=1e-15)
        assert np.linalg.norm(wall - place) == pytest.approx(np.hypot(offset, at))
    # positive to the right of the light's path, seen with z into the page
    assert np.sign(offset) == np.sign(np.cross([*light, 0], [*(front - place), 0])[2] * -1)


def test_the_level_polarisation_passes_whole_at_brewster_s_angle():
    angle = np.array([np.arctan(1.5)])
    upright, level = fresnel(angle, np.arcsin(np.sin(angle) / 1.5), 1.5)
    assert level[0] == pytest.approx(1.0)
    # the mean loss there, 0.0739645, is what Mitsuba's own tests pin for n = 1.5
    assert (1 - upright[0]) / 2 == pytest.approx(0.0739645, abs=1e-7)


@pytest.mark.parametrize(("radius", "index"), [(0.0, 1.4), (np.inf, 1.4), (R, 0.9), (R, np.nan)])
def test_discs_that_cannot_be_are_refused(radius, index):
    with pytest.raises(RangeError):
        round_rim(np.zeros(2), radius, index)


def test_places_that_are_no_numbers_are_refused():
    with pytest.raises(RangeError, match="NaN"):
        round_rim(np.array([np.nan]), R, INDEX)
    with pytest.raises(InputError, match="finite"):
        round_rim(np.zeros(1), R, 1.0).about(np.nan, 0.0)
