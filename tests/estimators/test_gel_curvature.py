"""The gel's bulge by coloured light: its curvature, and nothing else that happens to an image."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.core.errors import ImageError, InputError
from palpate.estimators.compliance.gel_curvature import ImprintRegion, Lamps, bulge

LAMPS = Lamps(((0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)))  # red from below, green from the left, blue from above
MIDDLE = ImprintRegion(40, 30, 41, 31)
GAIN = 40.0  # grey levels a unit of slope
ROUNDED = 2e-7  # white/px: half a grey level at random over 41 x 31 px moves a slope by a tenth of this


def lit(slope_x, slope_y, shade=120.0) -> np.ndarray:
    """A coat of these slopes towards the camera, in the lamps' light: a lamp lights what falls towards it."""
    channels = [shade - GAIN * (x * slope_x + y * slope_y) for x, y in LAMPS.towards]
    return np.rint(np.clip(np.stack(channels, axis=-1), 0, 255)).astype(np.uint8)


def grid(at=(60.0, 45.0)):
    y, x = np.mgrid[:96, :128].astype(float)
    return x - at[0], y - at[1]


def flat(shade=120.0):
    x, _ = grid()
    return lit(0 * x, 0 * x, shade)


def ball(radius_px: float, at=(60.0, 45.0), shade=120.0):
    x, y = grid(at)
    return lit(-x / radius_px, -y / radius_px, shade)


@pytest.mark.parametrize("radius", [50.0, 100.0, 400.0])
def test_a_bulge_has_the_curvature_that_made_it(radius) -> None:
    # 400 px make 3 grey levels over the region, and whole ones are seen
    assert_allclose(bulge(flat(), ball(radius), MIDDLE, LAMPS), GAIN / 255 / radius, rtol=0.03)


def test_a_dent_is_negative_and_no_change_is_nothing() -> None:
    assert bulge(flat(), flat(), MIDDLE, LAMPS) == 0
    assert bulge(ball(100.0), flat(), MIDDLE, LAMPS) == -bulge(flat(), ball(100.0), MIDDLE, LAMPS)


def test_it_does_not_matter_where_in_the_gel_the_ball_presses() -> None:
    here, there = (bulge(flat(), ball(100.0, at), MIDDLE, LAMPS) for at in ((60.0, 45.0), (72.0, 38.0)))
    assert_allclose(here, there, rtol=0.01)


def test_a_plane_tilt_of_the_gel_is_no_bulge() -> None:
    x, _ = grid()
    assert abs(bulge(flat(), lit(0.2 + 0 * x, -0.1 + 0 * x), MIDDLE, LAMPS)) < ROUNDED


def test_light_that_all_colours_share_is_no_bulge() -> None:
    """A lamp that fades, or a gel that comes nearer to one side, changes all colours alike."""
    x, y = grid()
    for shade in (100.0, 120.0 + 0.2 * x, 120.0 - 0.3 * y + 0.1 * x):
        assert abs(bulge(flat(), flat(shade + 0 * x), MIDDLE, LAMPS)) < 5 * ROUNDED


def test_a_fine_texture_of_the_object_is_hardly_a_bulge(rng) -> None:
    x, _ = grid()
    rough = lit(0.3 * rng.standard_normal(x.shape), 0.3 * rng.standard_normal(x.shape))
    # slopes of 0.3 at random, a third of the channels along each axis: 5 standard errors of their regression
    error = 0.3 * GAIN / 255 / np.sqrt(41 * 31 * (31**2 / 12))
    assert abs(bulge(flat(), rough, MIDDLE, LAMPS)) < 5 * error


def test_lamps_on_one_side_tell_no_slope() -> None:
    with pytest.raises(InputError, match="one side"):
        Lamps(((1.0, 0.0), (1.0, 0.0)))
    with pytest.raises(InputError, match="unit vectors"):
        Lamps(((2.0, 0.0), (0.0, 1.0)))


def test_images_that_tell_nothing_are_refused() -> None:
    with pytest.raises(ImageError, match="black or white"):
        bulge(flat(), flat(255.0), MIDDLE, LAMPS)
    with pytest.raises(ImageError, match="channel a lamp"):
        bulge(flat()[..., 0], flat()[..., 0], MIDDLE, LAMPS)
    with pytest.raises(ImageError, match="one size"):
        bulge(flat(), flat()[:-5], MIDDLE, LAMPS)
    with pytest.raises(InputError, match="region"):
        bulge(flat(), flat(), ImprintRegion(100, 30, 41, 31), LAMPS)
    with pytest.raises(InputError, match="region"):
        bulge(flat(), flat(), ImprintRegion(10, 10, 4, 4), LAMPS)
