import math
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import Pose, RangeError
from palpate.optics.colour import Spectrum
from palpate.sensors import palm
from palpate.sensors.palm import fringe_view, mirror_view
from palpate.sensors.palm.membrane_faults import (
    Wear,
    film,
    passed_by,
    scratches_over,
    worn,
)

SPEC, FULL = palm.debug(), palm.palm()


def seen(wear, depth_m=3e-3, x_m=0.0, y_m=0.0, exact=False, **changed):
    spec = replace(SPEC, wear=wear, **changed)
    return palm.render_clean(palm.press(spec, Pose(x_m, y_m, depth_m)), spec, exact=exact)


def behind_membrane(light):
    z, rays = SPEC.fringes.down_m, fringe_view.columns_kept(SPEC)
    return light[((z >= 0) & (z <= SPEC.thickness_m))[:, None] & rays.visible]


@pytest.mark.parametrize("exact", [False, True])
def test_no_wear_changes_no_bit(exact):
    unused = Wear(scratch_seed=5, scratch_strength=1.0, scratch_width_m=1e-4)
    assert not unused.shows
    for one, other in zip(seen(Wear(), exact=exact), seen(unused, exact=exact), strict=True):
        np.testing.assert_array_equal(one, other)
    everywhere = np.ones((3, 4), bool)
    clear = film(Wear(), np.zeros((3, 4)), np.ones((3, 4)), np.ones((4, 3)), everywhere)
    assert (clear.keep == 1).all()
    assert (clear.add == 0).all()


@pytest.mark.parametrize("region", [0, 1])
def test_haze_takes_a_share_of_the_picture_and_adds_one_veil_whatever_is_pressed(region):
    veils = [
        (seen(Wear(haze=haze), depth)[region] - (1 - haze) * seen(Wear(), depth)[region]) / haze
        for haze in (0.1, 0.5)
        for depth in (0.5e-3, 4e-3)
    ]
    # outside the membrane nothing is hazy, and this difference no veil
    part = behind_membrane if region == 0 else lambda light: light[mirror_view.inside_rim(SPEC)]
    for other in veils[1:]:
        np.testing.assert_allclose(part(other), part(veils[0]), atol=1e-5)  # float32
    assert part(veils[0]).min() > 0


@pytest.mark.parametrize("wear", [Wear(haze=0.3), Wear(scratches=30), Wear(yellowing=0.5)])
def test_only_what_is_seen_through_the_membrane_is_worn(wear):
    (light, below), (new, under) = seen(wear), seen(Wear())
    z, rays = SPEC.fringes.down_m, fringe_view.columns_kept(SPEC)
    beside = (z < 0)[:, None] | (z > SPEC.thickness_m)[:, None] | ~rays.visible
    np.testing.assert_array_equal(light[beside], new[beside])
    outside = ~mirror_view.inside_rim(SPEC)
    np.testing.assert_array_equal(below[outside], under[outside])
    assert (light != new).any()
    assert (below != under).any()


def test_a_wide_scratch_takes_as_much_light_as_its_area_says():
    wear = Wear(scratches=1, scratch_width_m=100e-6, scratch_strength=1.0)
    axis = np.linspace(-10e-3, 10e-3, 1501)
    taken = scratches_over(wear, 0, axis, axis, ((0.0, 0.0), (0.0, 0.0))).sum() * (axis[1] - axis[0]) ** 2
    _, _, _, length, _, wide, strong = np.random.default_rng([0, 0]).uniform(size=7)
    half = 1e-3 * 5**length
    # the mean of 1 - (s / half)^2 along it is 2/3; the bend makes it 0.2 % longer at most
    area = 100e-6 * (0.3 + 0.7 * wide) * (0.3 + 0.7 * strong) * 2 * half * 2 / 3
    assert taken == pytest.approx(area, rel=0.01)


def test_yellowed_silicone_follows_beers_law_and_passes_blue_least():
    one_band = Spectrum(np.array([450e-9]), np.ones((1, 3)))
    path = np.array([0.0, 0.5, 1.0])
    passed = passed_by(0.3, path, one_band)
    np.testing.assert_allclose(passed, 10 ** (-0.3 * path[:, None]) * np.ones(3))
    red, green, blue = passed_by(0.3, np.array([1.0]), fringe_view.spectrum(31))[0]
    assert 10**-0.3 < blue < green < red < 1
    assert red > 0.9


def test_channels_yellow_as_marching_every_band_through_the_absorption_does(monkeypatch):
    absorbance, spec = 0.3, replace(SPEC, extinction=0.0)  # the leak is added after the march
    seen_by = fringe_view.spectrum(spec.bands)
    passed = 10 ** (-absorbance * np.exp((450e-9 - seen_by.wavelength_m) / 60e-9))
    middle = np.flatnonzero(fringe_view.columns_kept(SPEC).half_chord_m > 0.98 * SPEC.radius_m)
    march = fringe_view.march_fringes.__wrapped__  # what is kept knows nothing of another spectrum
    by_channel = march(spec, 4e-3, 0.0, 0.0)[:, middle] * passed_by(absorbance, np.ones(len(middle)), seen_by)
    filtered = replace(seen_by, weight=seen_by.weight * passed[:, None])
    monkeypatch.setattr(fringe_view, "spectrum", lambda bands: filtered)
    by_band = march(spec, 4e-3, 0.0, 0.0)[:, middle]
    assert abs(by_channel - by_band).max() < 0.035  # 0.028 is measured
    assert np.sqrt(np.mean((by_channel - by_band) ** 2)) < 8e-3  # 5e-3


@pytest.mark.parametrize("presses", [-1.0, math.nan])
def test_presses_that_cannot_be_counted_are_refused(presses):
    with refused("press-count", RangeError):
        worn(presses)


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("haze", 1.1),
        ("haze", math.nan),
        ("scratches", -1),
        ("scratch_width_m", 0.0),
        ("scratch_strength", 1.5),
        ("yellowing", math.inf),
    ],
)
def test_wear_that_cannot_be_is_refused_by_name(part, value):
    with refused("wear-range", RangeError, match=part):
        replace(Wear(), **{part: value})
