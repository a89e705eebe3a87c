from dataclasses import replace

import numpy as np
import pytest

from palpate.core import InputError, Pose
from palpate.optics import encode_srgb
from palpate.optics.image_chain import strip_light
from palpate.sensors import palm
from palpate.sensors.palm.palm_render import BACKGROUND, lamp

SPEC = palm.debug()
QUIET = replace(SPEC, camera=replace(SPEC.camera, full_well_e=1e12, read_noise_e=0.0, bits=16))


def pressed(depth_m, x_m=0.0, y_m=0.0, spec=SPEC):
    return palm.press(spec, Pose(x_m, y_m, depth_m))


def rng(seed=0):
    return np.random.default_rng(seed)


def test_the_same_seed_gives_the_same_frame_and_another_another():
    contact = pressed(2e-3, 3e-3, 2e-3)
    one, two, other = (palm.render(contact, SPEC, rng(seed)).image for seed in (7, 7, 8))
    np.testing.assert_array_equal(one, two)
    assert (one != other).mean() > 0.1


@pytest.mark.parametrize("exact", [False, True])
def test_the_regions_are_where_the_spec_says_and_the_rest_is_dark(exact):
    contact = pressed(3e-3, 5e-3, -2e-3)
    image = palm.render(contact, QUIET, rng(), exact=exact).image.astype(int)
    outside = np.ones(image.shape[:2], bool)
    seen = palm.render_views(contact, QUIET, rng(), exact=exact)
    for view, alone in zip((SPEC.fringes, SPEC.mirror), seen, strict=True):
        x, y, w, h = view.box_px
        # noise is 1e-6 of the light: a pixel may round to the other code
        assert abs(image[y : y + h, x : x + w] - alone).max() <= 1
        outside[y : y + h, x : x + w] = False
    assert abs(image[outside] - int(encode_srgb(np.array([BACKGROUND]))[0])).max() <= 1
    assert image[outside].max() < 0.1 * image.max()


def test_a_shorter_exposure_scales_the_codes_and_not_the_developed_picture():
    short = replace(QUIET, camera=replace(QUIET.camera, exposure=0.3))
    codes = [palm.render_raw(pressed(2e-3), spec, rng()).astype(float) for spec in (QUIET, short)]
    np.testing.assert_allclose(codes[1], codes[0] / 3, atol=1.5)  # of 65535 codes
    images = [palm.render(pressed(2e-3), spec, rng()).image.astype(int) for spec in (QUIET, short)]
    assert abs(images[0] - images[1]).max() <= 1


def test_too_much_light_saturates_and_does_not_wrap():
    glaring = replace(SPEC, lamp_gain=100.0)
    codes = palm.render_raw(pressed(3e-3), glaring, rng())
    assert codes.max() == 2**12 - 1
    image = palm.render(pressed(3e-3), glaring, rng()).image
    assert image.max() == 255
    levels = [palm.render(pressed(3e-3), replace(QUIET, lamp_gain=g), rng()).image for g in (1, 3, 100)]
    assert (levels[0] <= levels[1] + np.uint8(levels[1] < 255)).all()
    assert (levels[1] <= levels[2] + np.uint8(levels[2] < 255)).all()


def test_a_probe_in_the_air_is_seen_and_loads_nothing():
    hanging, bare = pressed(-1e-3, 3e-3), pressed(0.0, 3e-3)
    assert hanging.force_n == 0
    assert not hanging.touching.any()
    (fringes, below), (rest, under) = (palm.render_clean(one, SPEC) for one in (hanging, bare))
    inside = SPEC.fringes.down_m >= 0
    np.testing.assert_array_equal(fringes[inside], rest[inside])
    assert (fringes != rest).any()
    assert (below != under).any()


@pytest.mark.parametrize("exact", [False, True])
def test_nothing_jumps_where_a_probe_comes_to_touch(exact):
    over, on = (palm.render_clean(pressed(d, 3e-3), SPEC, exact=exact) for d in (-1e-7, 1e-7))
    for one, other in zip(over, on, strict=True):
        assert np.abs(one - other).mean() < 1e-5


@pytest.mark.parametrize("exact", [False, True])
def test_the_probe_s_body_edge_on_is_left_out_and_the_dimple_stays_dark(exact):
    unseen = replace(SPEC, probe_edge_on=False)
    contact, z = pressed(3e-3, 4e-3), SPEC.fringes.down_m
    (without, mirrored), (seen, same) = (palm.render_clean(contact, s, exact=exact) for s in (unseen, SPEC))
    np.testing.assert_array_equal(mirrored, same)
    black = palm.render_clean(contact, replace(unseen, ball_albedo=0.0), exact=exact)[0]
    np.testing.assert_array_equal(without, black)
    below = z > 3e-3
    np.testing.assert_array_equal(without[below], seen[below])
    # well above the bulge only the polarisers' leak is left
    above = z < -1.5e-3
    np.testing.assert_allclose(without[above], SPEC.extinction * lamp(SPEC)[above], rtol=1e-3)
    assert (seen[above] != without[above]).any()
    assert (without[(z > 0) & (z < 2e-3)] == 0).any()


@pytest.mark.parametrize("exact", [False, True])
def test_without_a_membrane_there_are_no_fringes_and_no_lens(exact):
    air = replace(SPEC, membrane=False, corner_loss=0.0)
    leak = palm.render_clean(pressed(0.0), air, exact=exact)[0]
    evenly = strip_light(SPEC.lamp, SPEC.fringes.x_m, SPEC.fringes.down_m)
    np.testing.assert_allclose(leak, SPEC.extinction * evenly[..., None] * np.ones(3), rtol=1e-6)
    ball = (palm.render_clean(pressed(3e-3, 5e-3), air, exact=exact)[0] != leak).any(axis=-1)
    x, z = SPEC.fringes.x_m, SPEC.fringes.down_m
    R = SPEC.indenter_radius_m
    away = np.hypot(x - 5e-3, z[:, None] - (3e-3 - R))
    np.testing.assert_array_equal(ball, away < R)


def test_without_a_membrane_only_the_palm_s_own_ball_is_drawn():
    air = replace(SPEC, membrane=False)
    punch = palm.press(SPEC, Pose(0.0, 0.0, 1e-3), palm.parse_probe("punch:6"))
    nowhere = replace(pressed(1e-3), pose=Pose(float("nan"), 0.0, 1e-3))
    for contact in (punch, nowhere):
        with pytest.raises(InputError, match="own ball"):
            palm.render_clean(contact, air)
