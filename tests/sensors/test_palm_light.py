from dataclasses import replace

import numpy as np
import pytest

from palpate.core import Pose
from palpate.optics.colour import SECOND_RADIATION_M_K, lamp_tint
from palpate.sensors import palm
from palpate.sensors.palm import fringe_view
from palpate.sensors.palm.palm_render import BACKGROUND, room_light

SPEC = palm.debug()


def seen(depth_m=3e-3, x_m=4e-3, y_m=-2e-3, exact=False, **changed):
    spec = replace(SPEC, **changed)
    return palm.render_clean(palm.press(spec, Pose(x_m, y_m, depth_m)), spec, exact=exact)


def planck(wavelength_m, kelvin):
    return wavelength_m**-5 / np.expm1(SECOND_RADIATION_M_K / (wavelength_m * kelvin))


@pytest.mark.parametrize(("before", "after"), [(6500, 4000), (4000, 3000), (5000, 6500)])
def test_a_shift_in_mired_turns_one_black_body_into_the_other(before, after):
    spectrum = fringe_view.spectrum(31)
    ratio = planck(spectrum.wavelength_m, after) / planck(spectrum.wavelength_m, before)
    wanted = ratio @ spectrum.weight
    # Wien's law for Planck's: 2 % at 700 nm and 6500 K
    tint = lamp_tint(1e6 / after - 1e6 / before, spectrum)
    np.testing.assert_allclose(tint, wanted / wanted[1], rtol=0.02)


def test_room_light_adds_the_same_whatever_is_pressed_and_however_bright_the_lamp():
    for view, *pairs in zip(
        (SPEC.fringes, SPEC.mirror),
        *(
            one
            for changed in ({}, {"depth_m": 1e-3}, {"lamp_gain": 0.3})
            for one in (seen(**changed), seen(**changed, ambient=0.05))
        ),
        strict=True,
    ):
        wanted = 0.05 * room_light(SPEC.frame_px)[view.window]
        for dark, lit in zip(pairs[::2], pairs[1::2], strict=True):
            np.testing.assert_allclose(lit - dark, np.broadcast_to(wanted, lit.shape), atol=1e-6)


def test_room_light_fills_the_frame_between_the_regions():
    quiet = replace(SPEC, camera=replace(SPEC.camera, full_well_e=1e12, read_noise_e=0.0, bits=16))
    lit = replace(quiet, ambient=0.05)
    contact = palm.press(lit, Pose(0.0, 0.0, 0.0))
    codes = palm.render_raw(contact, lit, np.random.default_rng(0))
    outside = np.ones(codes.shape[:2], bool)
    for view in (SPEC.fringes, SPEC.mirror):
        x, y, w, h = view.box_px
        outside[y : y + h, x : x + w] = False
    top = codes[..., 1][outside] / (2**16 - 1) / quiet.camera.exposure
    sensitivity = fringe_view.spectrum(31).sensitivity[1]
    wanted = (BACKGROUND + 0.05 * room_light(SPEC.frame_px)[..., 0][outside]) * sensitivity
    np.testing.assert_allclose(top, wanted, rtol=2e-3)  # 16-bit steps


@pytest.mark.parametrize("changed", [{"ambient": 0.1}, {"lamp_mired": 60.0}])
def test_in_other_light_the_fast_way_shows_what_the_exact_one_does(changed):
    z = SPEC.fringes.down_m
    fast, exact = (seen(exact=which, **changed) for which in (False, True))
    rows = (z > 3e-3) & (z < SPEC.thickness_m)
    assert np.sqrt(np.mean((fast[0] - exact[0])[rows] ** 2)) < 1e-2  # as in the lamp's own
    assert np.sqrt(np.mean((fast[1] - exact[1]) ** 2)) < 2e-2  # a contact's sharp edge in pixels of 1 mm
