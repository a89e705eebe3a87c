import math
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, Pose, RangeError
from palpate.optics.colour import Spectrum
from palpate.sensors import palm
from palpate.sensors.palm import fringe_view, mirror_view
from palpate.sensors.palm.membrane_wear import (
    Wear,
    film,
    passed_by,
    scratches_over,
    spread,
    worn,
)
from palpate.sensors.palm.palm_render import lamp

SPEC, FULL = palm.debug(), palm.palm()
USED = Wear(haze=0.2, scratches=20, yellowing=0.2)
BOX = ((-SPEC.radius_m, SPEC.radius_m), (0.0, SPEC.thickness_m))


def seen(wear, depth_m=3e-3, x_m=0.0, y_m=0.0, exact=False, **changed):
    spec = replace(SPEC, wear=wear, **changed)
    return palm.render_clean(palm.press(spec, Pose(x_m, y_m, depth_m)), spec, exact=exact)


def behind_membrane(light):
    z, rays = SPEC.fringes.down_m, fringe_view.columns_kept(SPEC)
    return light[((z >= 0) & (z <= SPEC.thickness_m))[:, None] & rays.visible]


def shares(wear, spec=SPEC):
    return scratches_over(wear, 0, spec.fringes.x_m, spec.fringes.down_m, BOX)


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


def test_wear_changes_nothing_that_is_marched():
    assert replace(SPEC, wear=USED).unlit == SPEC.unlit


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


def test_of_the_lamps_light_the_analyser_passes_at_most_half_once_scattered():
    scattered = behind_membrane(seen(Wear(haze=1.0), 0.0)[0])
    assert 0.1 < scattered.max() <= 0.5
    bright = behind_membrane(lamp(replace(SPEC, corner_loss=0.0)))
    assert scattered.max() < 0.5 * bright.max()


def test_an_even_lamp_without_edges_is_its_own_spread():
    light = np.ones((400, 500))
    even = spread(light, (200e-6, 200e-6))
    np.testing.assert_allclose(even[150:250, 150:350], 1.0, rtol=1e-9)
    assert even[0, 0] < 0.5, "and at its edge the dark beside it takes part"


def test_the_more_haze_the_less_contrast_and_the_brighter_the_dark():
    hazes = (0.0, 0.05, 0.2, 0.6)
    dark = [behind_membrane(seen(Wear(haze=haze), 0.0)[0]).mean() for haze in hazes]
    assert (np.diff(dark) > 0).all()

    def contrast(light):
        low, high = np.quantile(behind_membrane(light), [0.05, 0.95])
        return (high - low) / (high + low)

    assert (np.diff([contrast(seen(Wear(haze=haze))[0]) for haze in hazes]) < 0).all()


def test_a_surface_that_scatters_all_light_shows_nothing_of_a_press():
    for one, other, part in zip(
        seen(Wear(haze=1.0), 1e-3, 4e-3),
        seen(Wear(haze=1.0), 4e-3, -4e-3),
        (behind_membrane, lambda light: light[mirror_view.inside_rim(SPEC)]),
        strict=True,
    ):
        np.testing.assert_array_equal(part(one), part(other))


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


def test_scratches_are_dark_on_bright_and_faintly_bright_on_dark():
    clean, scratched = (seen(wear, 3e-3)[0] for wear in (Wear(), Wear(scratches=30)))
    unlit, lines = (seen(wear, 0.0)[0] for wear in (Wear(), Wear(scratches=30)))
    assert (clean - scratched).max() > 0.02
    assert (lines >= unlit - 1e-7).all()
    assert 0.005 < (lines - unlit).max() < (clean - scratched).max()


def test_in_the_mirror_scratches_dim_the_bright_ball_and_light_up_the_dark_housing():
    coarse = Wear(scratches=300, scratch_width_m=500e-6, scratch_strength=1.0)  # of pixels of 1 mm
    clean, scratched = (seen(wear, 3e-3)[1][..., 0] for wear in (Wear(), coarse))
    ball = clean > 0.8 * clean.max()
    flat = mirror_view.inside_rim(SPEC) & (clean < 1.02 * np.median(clean[mirror_view.inside_rim(SPEC)]))
    assert (clean - scratched)[ball].mean() > 0.01
    assert (scratched - clean)[flat].mean() > 0.002


def test_fewer_pixels_show_the_same_scratches_paler():
    wear = Wear(scratches=20)
    full, few = shares(wear, FULL), shares(wear)
    assert few.max() < 0.5 * full.max()
    # scratches that cross share their light; the rest is what is cut off at the view's edges
    assert few.mean() == pytest.approx(full.mean(), rel=0.02)


def test_a_wide_scratch_takes_as_much_light_as_its_area_says():
    wear = Wear(scratches=1, scratch_width_m=100e-6, scratch_strength=1.0)
    axis = np.linspace(-10e-3, 10e-3, 1501)
    taken = scratches_over(wear, 0, axis, axis, ((0.0, 0.0), (0.0, 0.0))).sum() * (axis[1] - axis[0]) ** 2
    _, _, _, length, _, wide, strong = np.random.default_rng([0, 0]).uniform(size=7)
    half = 1e-3 * 5**length
    # the mean of 1 - (s / half)^2 along it is 2/3; the bend makes it 0.2 % longer at most
    area = 100e-6 * (0.3 + 0.7 * wide) * (0.3 + 0.7 * strong) * 2 * half * 2 / 3
    assert taken == pytest.approx(area, rel=0.01)


def test_more_scratches_are_the_same_and_some_more():
    few, more, others = (shares(Wear(scratches=n, scratch_seed=s)) for n, s in ((5, 1), (15, 1), (5, 2)))
    assert (more >= few - 1e-12).all()
    assert more.sum() > 2 * few.sum()
    assert abs(few - others).max() > 0.05


def test_a_seed_gives_the_same_scratches_again_and_others_in_the_mirror():
    wear = Wear(scratches=10)
    x, z = SPEC.fringes.x_m, SPEC.fringes.down_m
    here, again, mirrored = (scratches_over(wear, stream, x, z, BOX) for stream in (0, 0, 1))
    np.testing.assert_array_equal(here, again)
    assert (here != mirrored).any()


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


def test_the_mirrors_shorter_way_through_the_membrane_yellows_less():
    (light, below), (new, under) = seen(Wear(yellowing=0.4)), seen(Wear())
    blue_edge_on = behind_membrane(light)[:, 2].sum() / behind_membrane(new)[:, 2].sum()
    blue_below = below[..., 2].sum() / under[..., 2].sum()
    assert blue_edge_on < 0.6
    assert 0.8 < blue_below < 0.95


def test_a_dimmer_lamp_dims_what_is_scattered_as_well():
    for one, other in zip(seen(USED), seen(USED, lamp_gain=0.25), strict=True):
        np.testing.assert_allclose(other, one / 4, rtol=1e-4, atol=1e-7)


def test_a_mirror_that_sees_a_dark_layer_sees_no_wear():
    for wear in (USED, worn(1e6)):
        np.testing.assert_array_equal(
            seen(wear, opaque_underside=True)[1], seen(Wear(), opaque_underside=True)[1]
        )


def test_without_a_membrane_nothing_is_worn():
    for one, other in zip(seen(USED, membrane=False), seen(Wear(), membrane=False), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("place", [(0.0, 0.0), (9e-3, -5e-3)])
def test_worn_the_fast_way_shows_what_the_exact_one_does(place):
    z = SPEC.fringes.down_m
    fast, exact = (seen(USED, 3e-3, *place, exact=which) for which in (False, True))
    rows = (z > 3e-3) & (z < SPEC.thickness_m)
    assert np.sqrt(np.mean((fast[0] - exact[0])[rows] ** 2)) < 1e-2  # as of a new membrane
    assert np.sqrt(np.mean((fast[1] - exact[1]) ** 2)) < 2e-2  # a contact's sharp edge in pixels of 1 mm


def test_wear_grows_with_presses_and_comes_to_an_end():
    assert worn(0) == Wear()
    laps = [worn(n) for n in (0, 100, 1e3, 1e4, 1e5)]
    assert (np.diff([wear.haze for wear in laps]) > 0).all()
    assert (np.diff([wear.scratches for wear in laps]) >= 0).all()
    assert worn(1e7).haze == pytest.approx(worn(1e9).haze)
    assert worn(1e4).haze == pytest.approx((1 - math.exp(-1)) * worn(1e9).haze)


@pytest.mark.parametrize("presses", [-1.0, math.nan, math.inf])
def test_presses_that_cannot_be_counted_are_refused(presses):
    with refused("press-count", RangeError):
        worn(presses)


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("haze", -0.1),
        ("haze", 1.1),
        ("haze", math.nan),
        ("scratches", -1),
        ("scratch_seed", -1),
        ("scratch_width_m", 0.0),
        ("scratch_strength", 1.5),
        ("yellowing", -0.1),
        ("yellowing", math.inf),
    ],
)
def test_wear_that_cannot_be_is_refused_by_name(part, value):
    with refused("wear-range", RangeError, match=part):
        replace(Wear(), **{part: value})


@pytest.mark.parametrize("part", ["scratches", "scratch_seed"])
def test_half_a_scratch_is_refused(part):
    with pytest.raises((InputError, TypeError), match=part):  # the latter is the tests' own check of types
        Wear(**{part: 2.5})
