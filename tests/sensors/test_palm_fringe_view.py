import colorsys
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

from palpate.core import Pose
from palpate.optics import encode_srgb
from palpate.sensors import palm
from palpate.sensors.palm import fringe_view
from palpate.sensors.palm.palm_render import lamp

SPEC = palm.debug()
GREEN_M = 550e-9


def edge_on(depth_m, x_m=0.0, y_m=0.0, spec=SPEC, exact=False):
    contact = palm.press(spec, Pose(x_m, y_m, depth_m))
    return palm.render_clean(contact, spec, exact=exact)[0]


def below(light, depth_m, spec=SPEC):
    """Rows in the membrane below the dimple."""
    z = spec.fringes.down_m
    return light[(z > depth_m) & (z < spec.thickness_m)]


@pytest.mark.parametrize("exact", [False, True])
def test_without_load_only_the_polarisers_leak_is_seen(exact):
    dark = edge_on(0.0, exact=exact)
    np.testing.assert_allclose(dark, SPEC.extinction * lamp(SPEC), rtol=1e-4)
    assert dark.max() < 0.02 * below(edge_on(3e-3), 3e-3).max()


def colours_of(rgb):
    """Names of the colours in their order, each run once."""

    def name(pixel):
        hue, saturation, value = colorsys.rgb_to_hsv(*(pixel / 255))
        hue *= 360
        if value < 0.15:
            return "dark"
        if saturation < 0.09 or (208 <= hue < 240 and saturation < 0.25):  # the blue die tints the first grey
            return "grey"
        bounds = ((30, "red"), (70, "yellow"), (195, "green"), (260, "blue"), (361, "red"))
        return next(word for bound, word in bounds if hue < bound)

    return [word for word, _ in groupby(name(pixel) for pixel in rgb)]


FIRST_ORDER = ["dark", "grey", "yellow", "red", "blue", "green"]


def test_a_rising_order_runs_through_newton_s_colours():
    seen = fringe_view.spectrum(31)
    order = np.linspace(0, 1.5, 61)
    phase = SPEC.stress_optic.half_phase(seen.wavelength_m)
    at_green = SPEC.stress_optic.half_phase(np.array([GREEN_M]))[0]
    light = np.sin(np.pi * np.outer(order, phase / at_green)) ** 2 @ seen.weight
    assert colours_of(encode_srgb(light)) == [*FIRST_ORDER, "yellow"]


@pytest.mark.parametrize(("polariser", "column"), [(0.0, 20), (np.pi / 2, 95)])
def test_where_the_axes_of_stress_lie_along_the_polarisers_it_is_dark(polariser, column):
    # a column in which the contact's axis lies: there the stress is along x and z whatever the depth
    view = replace(SPEC.fringes, middle_px=(70.5, 11.0))
    spec = replace(SPEC, polariser_rad=polariser, fringes=view, rays_per_pixel=(1, 1))
    rays = fringe_view.columns(spec, view)
    x = float(rays.impact_m[column] / np.cos(rays.turn_rad[column]))
    seen = below(fringe_view.march_fringes(spec, 2e-3, x, 0.0), 2e-3)
    np.testing.assert_allclose(seen[:, column], spec.extinction, atol=1e-6)
    assert seen[:, column + 8].max() > 0.1
    turned = fringe_view.march_fringes(replace(spec, polariser_rad=np.pi / 4), 2e-3, x, 0.0)
    assert below(turned, 2e-3)[:, column].max() > 0.5


@pytest.mark.parametrize("exact", [False, True])
def test_a_contact_to_the_right_is_that_to_the_left_mirrored(exact):
    left, right = (edge_on(3e-3, x, 2e-3, exact=exact) for x in (-6e-3, 6e-3))
    np.testing.assert_allclose(left, right[:, ::-1], atol=1e-5)


def test_frozen_birefringence_lights_the_membrane_at_rest():
    frozen = replace(SPEC, frozen_birefringence=2e-6)
    # the light of a plate 57 mm thick at the middle column: 2e-6 * 57 mm is 0.2 orders
    seen = fringe_view.spectrum(31)
    wanted = np.sin(np.pi * 2e-6 * 57e-3 / seen.wavelength_m) ** 2 @ seen.weight
    light = fringe_view.march_fringes(frozen, 0.0, 0.0, 0.0)[
        SPEC.fringes.down_m > 0.5e-3, SPEC.fringes.size_px[0] // 2
    ]
    np.testing.assert_allclose(light[3], SPEC.extinction + (1 - SPEC.extinction) * wanted, atol=1e-3)
