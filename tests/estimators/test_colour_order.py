"""Orders by pixel from colours, recovered from frames that the optics made of known fields."""

import numpy as np
import pytest
from tests.fringe_fields import LED, beam, colours, disc, order_from_colour
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError
from palpate.estimators.fringe_light import one_line, tungsten
from palpate.estimators.fringe_map import (
    ColourReader,
    FrameNoise,
    Untold,
    colour_kernels as kernels,
    flat_field,
    grey_order,
    measured_noise,
    nearest_colour,
    table_of,
)
from palpate.optics.colour import encode_srgb

SHARE, AXIS, FACE = disc()
TABLE = table_of(LED)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def test_a_disc_s_orders_come_back_with_a_deviation_that_is_theirs():
    N = SHARE * 1.2
    z = []
    for seed in range(3):
        found = order_from_colour(colours(N, seed=seed), TABLE, noise=0.02, mask=FACE)
        told = found.valid
        error = (found.order - N)[told]
        assert told.sum() > 0.99 * FACE.sum()
        assert not told[~FACE].any()
        assert np.abs(error).max() < 0.1, "no pixel at another order"
        assert rms(error) < 0.01
        z.append(error / found.sigma[told])
    z = np.concatenate(z)
    assert abs(z.mean()) < 0.06
    assert 0.93 < z.std() < 1.05
    assert 0.94 < np.mean(np.abs(z) < 1.96) < 0.97


@pytest.mark.parametrize("noise", [0.005, 0.04])
def test_a_beam_s_orders_rise_evenly_from_its_neutral_line_at_any_noise(noise):
    N = beam(3.2)
    found = order_from_colour(colours(N, noise), TABLE, noise=noise)
    error = (found.order - N)[found.valid]
    assert found.valid.mean() > 0.98
    assert np.mean(np.abs(error) > 0.2) < 1e-3
    assert 1.4826 * np.median(np.abs(error / found.sigma[found.valid])) == pytest.approx(1.0, abs=0.08)


def test_neighbours_keep_a_pixel_from_another_order_of_nearly_its_colour():
    N = beam(3.6)
    light = colours(N, 0.06)
    alone = np.abs(nearest_colour(light, TABLE) - N) > 0.2
    found = order_from_colour(light, TABLE, noise=0.06)
    together = np.abs(found.order - N) > 0.2
    assert alone.mean() > 0.08
    assert together.mean() < alone.mean() / 10


def test_one_grey_channel_reads_half_an_order_and_folds_beyond():
    small, large = beam(0.45), beam(1.2)
    assert rms(grey_order(one_line(550e-9).light(small)[..., 0]) - small) < 1e-6
    assert rms(grey_order(one_line(550e-9).light(large)[..., 0]) - large) > 0.4
    assert rms(order_from_colour(colours(large), TABLE, noise=0.02).order - large) < 0.01


@pytest.mark.parametrize("along", [0, 1])
def test_a_line_of_a_colour_that_two_orders_share_is_not_outvoted_by_itself(along):
    """At order 1.16 the colour is nearly that of 2.13, all along a row or a column."""
    N = np.moveaxis(beam(1.2), 0, along)
    for seed in range(3):
        found = order_from_colour(colours(N, seed=seed), TABLE, noise=0.02)
        assert np.abs(found.order - N)[np.abs(N - 1.16) < 0.02].max() < 0.2


def test_the_index_finds_what_setting_every_colour_against_every_row_finds():
    reader = ColourReader(TABLE, noise=0.02)
    reader.read(colours(beam(3.2)))
    known = reader._prepared
    flat = known.standard(colours(beam(3.2), seed=4)).reshape(-1, 3)
    fast = kernels.by_index(flat, known.table, known.index, known.low, known.size)
    slow = kernels.by_scan(flat, known.table, False)
    best = [
        np.take_along_axis(row, np.where(np.arange(5) < n[:, None], chi, np.inf).argmin(1)[:, None], 1)
        for row, chi, n in (fast, slow)
    ]
    assert np.mean(best[0] == best[1]) > 0.999


def test_a_table_of_another_lamp_shows_as_misfit_and_tells_less():
    N = SHARE * 1.2
    right, wrong = (
        order_from_colour(colours(N, 0.005), table_of(lamp), noise=0.005, mask=FACE)
        for lamp in (LED, tungsten())
    )
    assert right.summary()["misfit_median"] < 1.2
    assert wrong.summary()["misfit_median"] > 4
    assert wrong.valid.sum() < 0.85 * right.valid.sum()


def test_white_light_by_pixel_and_the_polarisers_leak_are_taken_out():
    N, leak = SHARE * 0.8, np.array([0.01, 0.02, 0.03])
    y, x = np.mgrid[-1:1:90j, -1:1:90j]
    white = leak + (1 - 0.4 * (x**2 + y**2) / 2)[..., None] * [0.9, 0.7, 0.5]
    rng = np.random.default_rng(0)
    frame = leak + (white - leak) * LED.light(N) + 0.005 * rng.standard_normal((90, 90, 3))
    found = order_from_colour(frame, TABLE, noise=0.005, white=white, leak=leak, mask=FACE)
    error = (found.order - N)[found.valid]
    assert found.valid.sum() > 0.99 * FACE.sum()
    assert np.abs(error).max() < 0.1
    assert 0.8 < (error / found.sigma[found.valid]).std() < 1.1
    uneven = order_from_colour(frame, TABLE, noise=0.005, mask=FACE)
    assert uneven.valid.sum() < 0.5 * FACE.sum()
    assert np.abs(flat_field(white + 0.02 * rng.standard_normal(white.shape)) - white).mean() < 0.006


def test_a_plane_polariscope_s_isoclinics_may_be_left_free():
    N = SHARE * 0.8
    seen = np.sin(2 * AXIS - np.pi / 4) ** 2
    rng = np.random.default_rng(0)
    frame = seen[..., None] * LED.light(N) + 0.005 * rng.standard_normal((90, 90, 3))
    clear = FACE & (seen > 0.3) & (N > 0.4)
    found = order_from_colour(frame, table_of(LED, 3.0), noise=0.005, mask=clear, isoclinics=True)
    error = np.abs(found.order - N)[found.valid]
    assert found.valid.sum() > 0.7 * clear.sum()
    assert np.mean(error < 0.1) > 0.97


def test_a_saturated_pixel_an_order_beyond_the_table_and_a_scratch_are_not_told():
    N = beam(1.8)
    codes = encode_srgb(0.95 * colours(N, 0.005))
    codes[10:14, 5:25] = 255
    codes[100:103, 5:25] = (20, 200, 20)
    found = order_from_colour(codes, table_of(LED, 1.5), noise=0.005, white=np.full(3, 0.95))
    assert (found.why[10:14, 5:25] == Untold.SATURATED).all()
    assert (found.why[100:103, 5:25] == Untold.UNLIKE).mean() > 0.9
    assert found.valid[N > 1.55].mean() < 0.05
    assert found.valid[(N < 1.45) & (found.why != Untold.SATURATED)].mean() > 0.9


@pytest.mark.parametrize("noise", [0.005, 0.05])
def test_orders_past_those_looked_for_are_not_told_as_lower_ones(noise):
    share, _, face = disc(140, steepest=20.0)
    N = share * 1.3
    found = order_from_colour(colours(N, noise), TABLE, noise=noise, mask=face)
    assert found.valid[face & (N > 4.1)].mean() < 0.03
    error = np.abs(found.order - N)[found.valid & (N < 3.9)]
    assert np.mean(error > 0.2) < 1e-3


def test_noise_alone_tells_nothing():
    light = np.random.default_rng(1).uniform(0, 1, (60, 60, 3))
    assert order_from_colour(light, TABLE, noise=0.01).valid.mean() < 0.02


def test_noise_is_measured_from_the_frame_in_the_dark_and_by_light():
    v = LED.light(beam(1.2, 400, 300))
    rng = np.random.default_rng(0)
    found = measured_noise(v + np.sqrt(0.01**2 + 0.0008 * v) * rng.standard_normal(v.shape))
    assert found.read == pytest.approx(0.01, rel=0.1)
    assert found.shot == pytest.approx(0.0008, rel=0.1)
    scale = FrameNoise(0.01, 0.0008).standard(np.array([0.5, 0.5 + 1e-4]))
    assert np.diff(scale)[0] == pytest.approx(1e-4 / np.sqrt(0.01**2 + 0.0004), rel=1e-3)


def test_a_frame_goes_on_from_the_one_before_where_colours_alone_do_not_tell():
    N = np.full((30, 30), 2.13)  # nearly of the colour of order 1.15
    light = colours(N, 0.08)
    before = order_from_colour(colours(N - 0.05, 0.005), TABLE, noise=0.005)
    assert np.mean(np.abs(order_from_colour(light, TABLE, noise=0.08).order - N) > 0.2) > 0.5
    found = ColourReader(TABLE, noise=0.08).read(light, before)
    assert np.abs(found.order - N)[found.valid].max() < 0.2
    assert found.valid.mean() > 0.9


def test_a_load_that_jumped_is_not_held_back_by_the_frame_before():
    before = order_from_colour(colours(beam(3.5), 0.005), TABLE, noise=0.005)
    jumped = ColourReader(TABLE, noise=0.01).read(colours(beam(1.0), 0.01), before)
    assert rms((jumped.order - beam(1.0))[jumped.valid]) < 0.01
    assert jumped.valid.mean() > 0.97


DISC = colours(SHARE * 1.2, 0.01)


@pytest.mark.parametrize(
    ("frame", "code", "said"),
    [
        (DISC[..., 0], "no-color-image", "grey"),
        (np.repeat(DISC[..., :1], 3, axis=-1), "gray-image", "same"),
        (DISC[..., ::-1], "channel-order", "blue, green"),
        (DISC * [1, 1, 0], "one-color-only", "in blue"),
        (np.where(np.arange(90)[:, None, None] == 3, np.nan, DISC), "not-finite", "NaN"),
        (np.full((90, 90, 3), 255, np.uint8), "saturated", "saturated"),
    ],
    ids=["grey", "equal", "bgr", "no-blue", "nan", "saturated"],
)
def test_a_frame_that_colours_cannot_be_read_from_is_refused_with_the_reason(frame, code, said):
    with refused(code, InputError, match=said):
        order_from_colour(frame, TABLE, noise=0.01, mask=FACE)


def test_numbers_and_sizes_that_cannot_be_are_refused():
    reader = ColourReader(TABLE, noise=0.01, mask=FACE)
    with refused("image-size", InputError):
        reader.read(DISC[:80])
    with refused("image-size", InputError):
        ColourReader(TABLE, noise=0.01).read(DISC, order_from_colour(DISC[:80], TABLE, noise=0.01))
    with refused("noise-range", RangeError):
        order_from_colour(DISC, TABLE, noise=0.0)
    with refused("white-image", InputError):
        order_from_colour(DISC, TABLE, noise=0.01, white=np.array([1.0, 0.0, 1.0]))
    with refused("mask-empty", InputError):
        order_from_colour(DISC, TABLE, noise=0.01, mask=np.zeros((90, 90), bool))
