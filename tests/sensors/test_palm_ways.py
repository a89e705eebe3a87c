from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from palpate.core import Pose, Probe
from palpate.sensors import palm
from palpate.sensors.palm import fringe_rays, fringe_view, palm_press, probe_stress

SPEC = palm.debug()
STEP = 1 / 255  # of light: an 8-bit step


def edge_on(depth_m, x_m=0.0, y_m=0.0, spec=SPEC, exact=False):
    contact = palm.press(spec, Pose(x_m, y_m, depth_m))
    return palm.render_clean(contact, spec, exact=exact)[0]


def below(light, depth_m, spec=SPEC):
    """Rows in the membrane below the dimple."""
    z = spec.fringes.down_m
    return light[(z > depth_m) & (z < spec.thickness_m)]


def layered(words, depth_m=0.8e-3, lateral_n=(0.0, 0.0)):
    return palm.press(SPEC, Pose(0.0, 0.0, depth_m), palm.parse_probe(words), lateral_n)


def rms(difference):
    return float(np.sqrt(np.mean(difference**2)))


@pytest.fixture
def coarse(monkeypatch):
    """A quarter of the planes of stress and fewer cells: 1e-3 rms of light off, and ten times as fast."""
    monkeypatch.setattr(probe_stress, "PLANES", 12)
    monkeypatch.setattr(import_module("palpate.sensors.palm.palm_press"), "CELLS", 96)


@pytest.mark.parametrize("place", [(0.0, 7e-3)])
def test_the_fast_way_shows_what_the_exact_one_does(place):
    fast, exact = (edge_on(3e-3, *place, exact=which) for which in (False, True))
    assert rms(below(fast - exact, 3e-3)) < 1e-2  # 5e-3 is measured; at 5 mm or near the rim it is more


@pytest.mark.parametrize(("x_m", "way"), [(11.2e-3, False), (11.6e-3, True)])
def test_a_picture_is_marched_anew_where_the_fast_way_is_off_and_nowhere_else(x_m, way):
    chosen = edge_on(3e-3, x_m, exact=None)
    assert np.array_equal(chosen, edge_on(3e-3, x_m, exact=way))
    assert not np.array_equal(chosen, edge_on(3e-3, x_m, exact=not way))


def test_twice_the_slices_or_bands_change_no_8_bit_step():
    one = fringe_view.march_fringes(SPEC, 5e-3, 0.0, 0.0)
    for spec, slices in ((SPEC, 2 * fringe_view.SLICES), (replace(SPEC, bands=62), fringe_view.SLICES)):
        two = fringe_view.march_fringes(spec, 5e-3, 0.0, 0.0, slices)
        assert np.quantile(abs(below(one - two, 5e-3)), 0.999) < STEP


@pytest.mark.parametrize("polariser", [np.pi / 4, 0.0])  # one shows s_xx - s_zz, the other s_xz
def test_layers_under_a_ball_show_what_the_finite_strain_table_does(polariser, coarse):
    spec = replace(SPEC, polariser_rad=polariser)
    pose = Pose(16e-3, -8e-3, 0.3e-3)  # where rays are turned most
    nearly_still = palm_press.press_layers(spec, pose, Probe("sphere", 5e-3)).contact
    nearly_still = replace(nearly_still, shear_pa=np.zeros((2, *nearly_still.pressure_pa.shape)))
    layers, _ = palm.render_clean(nearly_still, spec)
    table, _ = palm.render_clean(palm.press(spec, pose), spec, exact=True)
    # 0.8e-3 is measured, of light up to 0.18; the layers' stress is where the skin was at rest
    assert rms(below(layers - table, 0.6e-3)) < 1.5e-3


def test_a_probe_that_does_not_press_shows_the_membrane_at_rest(coarse):
    at_rest = edge_on(0.0)
    np.testing.assert_allclose(palm.render_clean(layered("punch:6", 0.0), SPEC)[0], at_rest, rtol=1e-4)
    untabled = replace(SPEC, thickness_m=8e-3)  # of which there is no table
    untouched = palm.press(untabled, Pose(0.0, 0.0, 0.0), palm.parse_probe("punch:6"))
    np.testing.assert_allclose(palm.render_clean(untouched, untabled)[0], at_rest, rtol=1e-4)


@pytest.mark.parametrize(
    ("words", "lateral_n"),
    [("sphere:8", (0.3, -0.2))],
)
def test_finer_planes_slices_and_rays_change_no_8_bit_step(words, lateral_n, monkeypatch):
    spec = palm.cropped(SPEC, 32, "small")
    contact = layered(words, lateral_n=lateral_n)
    one = fringe_rays.march_contact(spec, contact)
    monkeypatch.setattr(probe_stress, "PLANES", 40)
    for name, value in (("SLICES", 160), ("MORE_SLICES", 80), ("MAX_ACROSS_M", 0.05e-3)):
        monkeypatch.setattr(fringe_rays, name, value)
    two = fringe_rays.march_contact(spec, contact)
    assert rms(below(one - two, 1.1e-3, spec)) < 0.1 * STEP
    assert np.quantile(abs(below(one - two, 1.1e-3, spec)), 0.999) < STEP
