from dataclasses import replace

import numpy as np
import pytest
from tests.oracles.half_space_sensor import debug, demo, press, render_clean, render_plain

from palpate.core import InputError, Pose, RangeError
from palpate.optics import StressOpticLaw

SPEC = demo()


def seen(x_px=0.0, depth_m=0.8e-3, spec=SPEC, y_m=0.0):
    return press(spec, Pose(x_px * spec.pitch_m, y_m, depth_m))


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


def test_a_contact_moved_by_one_pixel_is_the_image_moved_by_one_pixel():
    spec = replace(SPEC, corner_loss=0.0, holder_px=0)  # lamp and holder do not move with the contact
    here, there = (render_clean(seen(x, spec=spec), spec) for x in (3.0, 4.0))
    np.testing.assert_allclose(there[:, 1:], here[:, :-1], atol=1e-5)  # float32 splines


def test_only_the_product_of_stiffness_and_coefficient_is_seen():
    stiff = replace(SPEC, youngs_modulus_pa=0.6e6, stress_optic=StressOpticLaw(1.5e-9))
    np.testing.assert_allclose(render_clean(seen(spec=stiff), stiff), render_clean(seen(), SPEC), atol=1e-6)


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
