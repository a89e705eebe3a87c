from dataclasses import replace

import numpy as np
import pytest
from tests.oracles.half_space_sensor import debug, demo, press, render, render_clean, render_plain

from palpate.core import InputError, Pose, RangeError
from palpate.optics import StressOpticLaw

SPEC = demo()


def seen(x_px=0.0, depth_m=0.8e-3, spec=SPEC, y_m=0.0):
    return press(spec, Pose(x_px * spec.pitch_m, y_m, depth_m))


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("polariser", [np.pi / 4, 0.3])
@pytest.mark.parametrize("depth", [0.1e-3, 1.2e-3])
@pytest.mark.cases(1)
def test_the_table_shows_what_the_plain_march_shows(polariser, depth):
    spec = replace(debug(), polariser_rad=polariser)
    contact = press(spec, Pose(0.3e-3, 0.0, depth))
    # measured 2e-4; an 8-bit step of sRGB is 3e-4 of linear light in the dark and 9e-3 in the bright
    np.testing.assert_allclose(
        render_clean(contact, spec), render_plain(contact, spec, slices=256), atol=1e-3
    )


@pytest.mark.slow
def test_at_the_demos_size_the_table_shows_what_the_plain_march_shows():
    contact = seen(depth_m=1.2e-3)
    error = abs(render_clean(contact, SPEC) - render_plain(contact, SPEC, slices=256))
    assert error.max() < 5e-3


def test_light_is_between_none_and_the_lamps():
    for depth in (0.0, 0.02e-3, 1.25e-3):
        light = render_clean(seen(depth_m=depth), SPEC)
        assert light.min() >= 0.0
        assert light.max() <= 1.0


def test_a_contact_moved_by_one_pixel_is_the_image_moved_by_one_pixel():
    spec = replace(SPEC, corner_loss=0.0, holder_px=0)  # lamp and holder do not move with the contact
    here, there = (render_clean(seen(x, spec=spec), spec) for x in (3.0, 4.0))
    np.testing.assert_allclose(there[:, 1:], here[:, :-1], atol=1e-5)  # float32 splines


def test_with_lamp_and_holder_fixed_to_the_camera_a_moved_image_is_not_a_moved_contact():
    here, there = (render_clean(seen(x), SPEC) for x in (0.0, 16.0))
    apart = abs(there[:, 16:] - here[:, :-16])
    assert apart[:, SPEC.holder_px : -SPEC.holder_px].max() > 0.02, "the lamp, under the contact"
    assert apart[:, : SPEC.holder_px].min() > 0.002, "the holder, everywhere"


def test_moving_along_the_ray_changes_nothing():
    near, far = (render(seen(y_m=y), SPEC, rng()).image for y in (-4e-3, 4e-3))
    np.testing.assert_array_equal(near, far)


def test_the_image_under_the_middle_is_its_own_mirror():
    spec = replace(SPEC, corner_loss=0.0)
    image = render_clean(seen(spec=spec), spec)
    np.testing.assert_allclose(image, image[:, ::-1], atol=1e-5)


def test_turning_the_polariser_the_other_way_mirrors_the_image():
    one, other = (replace(SPEC, corner_loss=0.0, polariser_rad=angle) for angle in (0.3, -0.3))
    np.testing.assert_allclose(
        render_clean(seen(spec=one), one), render_clean(seen(spec=other), other)[:, ::-1], atol=1e-5
    )


def test_only_the_product_of_stiffness_and_coefficient_is_seen():
    stiff = replace(SPEC, youngs_modulus_pa=0.6e6, stress_optic=StressOpticLaw(1.5e-9))
    np.testing.assert_allclose(render_clean(seen(spec=stiff), stiff), render_clean(seen(), SPEC), atol=1e-6)


def test_without_contact_only_the_leak_is_seen():
    light = render_clean(seen(depth_m=0.0), SPEC)
    assert light.max() <= SPEC.extinction
    open_view = light[:, SPEC.holder_px : -SPEC.holder_px]
    assert open_view.min() >= SPEC.extinction * (1 - 1.2 * SPEC.corner_loss) * SPEC.skin_transmission


def test_a_light_touch_grows_from_nothing():
    untouched = render_clean(seen(depth_m=0.0), SPEC)[SPEC.air_px :]
    brightest = [
        abs(render_clean(seen(depth_m=d), SPEC)[SPEC.air_px :] - untouched).max() for d in (1e-7, 1e-5, 1e-4)
    ]
    assert brightest[0] < 1e-5 < brightest[1] < brightest[2]


def test_the_ball_hides_the_leak_above_the_contact():
    air = render_clean(seen(), SPEC)[: SPEC.air_px]
    assert (air[:, SPEC.width_px // 2] == 0.0).all()
    assert (air[:, SPEC.holder_px] > 0.0).all()


def test_a_frame_is_noise_around_the_clean_image():
    spec = replace(SPEC, full_well_e=1e9, read_noise_e=0.0, bits=16)
    quiet = render(seen(spec=spec), spec, rng()).image.astype(int)
    noisy = [render(seen(), SPEC, rng(seed)).image.astype(int) for seed in range(20)]
    assert (noisy[0] != noisy[1]).any()
    # twenty frames: the mean is within a level or two of the clean image, more where sRGB is steep
    assert abs(np.mean(noisy, axis=0) - quiet).max() < 4


def test_the_same_seed_gives_the_same_frame():
    np.testing.assert_array_equal(render(seen(), SPEC, rng(7)).image, render(seen(), SPEC, rng(7)).image)


def test_a_frame_says_what_it_is():
    frame = render(seen(spec=debug()), debug(), rng())
    assert frame.image.shape == (24, 40, 3)
    assert frame.image.dtype == np.uint8
    assert (frame.sensor, frame.exposure_s) == ("half-space-debug", 0.01)


def test_a_brighter_lamp_scales_the_light():
    np.testing.assert_allclose(
        render_clean(seen(), replace(SPEC, lamp_gain=0.5)), render_clean(seen(), SPEC) / 2, rtol=1e-6
    )


def test_the_seating_offset_deepens_a_touch_and_touches_nothing_alone():
    offset = replace(SPEC, depth_offset_m=0.05e-3)
    assert press(offset, Pose(0.0, 0.0, 0.5e-3)).pose.depth_m == pytest.approx(0.55e-3)
    assert press(offset, Pose(0.0, 0.0, 0.0)).force_n == 0.0
    assert press(replace(SPEC, depth_offset_m=-1e-3), Pose(0.0, 0.0, 0.5e-3)).force_n == 0.0


def test_a_negative_depth_is_refused_whatever_the_offset():
    with pytest.raises(RangeError, match="depth"):
        press(replace(SPEC, depth_offset_m=1e-3), Pose(0.0, 0.0, -0.5e-3))


def test_a_contact_that_the_spec_could_not_make_is_refused():
    with pytest.raises(RangeError, match="retardance"):
        render_clean(seen(spec=replace(SPEC, youngs_modulus_pa=3e6)), SPEC)


def test_a_spec_that_cannot_be_is_refused():
    with pytest.raises(RangeError, match="incompressible"):
        replace(SPEC, poisson_ratio=0.49)
    with pytest.raises(InputError, match="no skin"):
        replace(SPEC, air_px=96)
    with pytest.raises(RangeError, match="pitch"):
        replace(SPEC, pitch_m=0.0)
