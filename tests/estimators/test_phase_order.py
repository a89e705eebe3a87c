"""Orders and axes by pixel from phase-stepped frames of known fields, made by Mueller matrices."""

import numpy as np
import pytest
from tests.fringe_fields import disc, leaving, phases
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate.estimators.fringe_map import (
    CAMERA,
    SIX_STEPS,
    CameraReader,
    Untold,
    best_place,
    order_from_phases,
    split_mosaic,
)
from palpate.optics.polariscope import linear_retarder, mueller

SHARE, AXIS, FACE = disc()
MIDDLE = 45


def place_of(N, order):
    """A place on the equator's left half where the disc has about this order."""
    column = int(np.where(FACE[MIDDLE, :MIDDLE], np.abs(N[MIDDLE, :MIDDLE] - order), 9).argmin())
    return MIDDLE, column, float(N[MIDDLE, column])


def turned(found, axis):
    """Angle between two axes, which are the same after half a turn [rad]."""
    return (found - axis + np.pi / 2) % np.pi - np.pi / 2


@pytest.mark.parametrize("at_centre", [0.4, 1.2])
def test_six_steps_give_order_and_axis_past_whole_orders_with_a_deviation_that_is_theirs(at_centre):
    N = SHARE * at_centre
    z = []
    for seed in range(2):
        frames = phases(N, AXIS, SIX_STEPS, seed=seed)
        found = order_from_phases(frames, SIX_STEPS, place_of(N, 0.125), mask=FACE)
        told = found.valid
        error = (found.order - N)[told]
        assert told.sum() > 0.88 * FACE.sum()
        assert np.abs(error).max() < 0.1
        assert np.sqrt(np.mean(error**2)) < 0.006
        z.append(error / found.sigma[told])
    z = np.concatenate(z)
    assert abs(z.mean()) < 0.08
    assert z.std() == pytest.approx(1.0, abs=0.05)
    clear = told & (np.abs(np.sin(2 * np.pi * N)) > 0.5)
    assert np.degrees(np.sqrt(np.mean(turned(found.axis_rad, AXIS)[clear] ** 2))) < 1.5


def test_the_steps_are_those_of_a_polariscope_built_of_its_elements():
    def plate(angle):
        return mueller(linear_retarder(0.25, angle))

    def analyser(angle):
        return np.array([1, np.cos(2 * angle), np.sin(2 * angle), 0]) / 2

    given = plate(np.radians(135)) @ np.array([1, -1, 0, 0])  # polariser at 90 degrees
    np.testing.assert_allclose(given, [1, 0, 0, given[3]], atol=1e-12)
    hand = np.sign(given[3])
    turns = [(0, 45 * hand), (0, -45 * hand), (0, 0), (45, 45), (90, 90), (135, 135)]
    rows = [analyser(np.radians(b)) @ plate(np.radians(q)) for q, b in turns]
    for N, axis in ((0.13, 0.3), (0.4, -0.7), (0.9, 1.2)):
        light = [row @ mueller(linear_retarder(N, axis)) @ given for row in rows]
        s = leaving(np.array(N), np.array(axis)) * hand
        signs = SIX_STEPS * [1, 1, hand]
        np.testing.assert_allclose(light, (1 + signs @ s) / 2, atol=1e-12)


@pytest.mark.parametrize("noise", [0.005, 0.04])
def test_a_polarisation_camera_tells_orders_below_a_quarter_and_says_nothing_beyond(noise):
    N = SHARE * 0.8
    found = order_from_phases(phases(N, AXIS, CAMERA, noise), CAMERA, place_of(N, 0.125), mask=FACE)
    told = found.valid
    assert told.sum() > 0.5 * (FACE & (N < 0.17) & (np.arange(90) < 45)).sum()
    assert not told[N > 0.25].any(), "beyond the fold a falling phase would read as a falling order"
    assert np.sqrt(np.mean((found.order - N)[told] ** 2)) < 0.4 * noise
    small = SHARE * 0.06
    whole = order_from_phases(phases(small, AXIS, CAMERA, noise), CAMERA, place_of(small, 0.05), mask=FACE)
    error = (whole.order - small)[whole.valid]
    assert whole.valid.sum() > 0.95 * FACE.sum()
    assert (error / whole.sigma[whole.valid])[small[whole.valid] > 2 * noise].std() == pytest.approx(
        1, abs=0.08
    )


@pytest.mark.parametrize(("side", "noise"), [(120, 0.005), pytest.param(300, 0.04, marks=pytest.mark.slow)])
def test_no_path_leads_past_a_quarter_order_however_steep_the_fringes_beside_a_load(side, noise):
    share, axis, inside = disc(side, steepest=20.0)
    for at_centre in (0.1, 0.3, 0.8):
        N, row = share * at_centre, side // 2
        left = np.where(inside[row, :row], np.abs(N[row, :row] - 0.1), 9)
        place = row, int(left.argmin()), float(N[row, int(left.argmin())])
        told = order_from_phases(phases(N, axis, CAMERA, noise), CAMERA, place, mask=inside).valid
        assert not (told & (N > 0.25)).any()
        assert told.sum() > 0.4 * (inside & (N < 0.15)).sum()


def test_a_camera_s_raw_frame_holds_its_four_polarisers():
    raw = np.arange(24, dtype=np.uint8).reshape(4, 6)
    at_0, at_45, at_90, at_135 = split_mosaic(raw)
    four = (at_0[0, 0], at_45[0, 0], at_90[0, 0], at_135[0, 0])
    assert (raw[1, 1], raw[0, 1], raw[0, 0], raw[1, 0]) == four
    assert at_45.shape == (2, 3)
    with pytest.raises(InputError, match="even size"):
        split_mosaic(raw[:3])


def test_a_camera_s_frames_are_followed_from_place_to_place():
    before = None
    for load in (0.04, 0.06, 0.08):
        N = SHARE * load
        frames = np.rint(250 * phases(N, AXIS, CAMERA, 0.005)).clip(0, 253).astype(np.uint8)
        raw = np.zeros((180, 180), np.uint8)
        raw[1::2, 1::2], raw[::2, 1::2], raw[::2, ::2], raw[1::2, ::2] = frames
        reader = CameraReader(place_of(SHARE * 0.04, 0.03), mask=FACE)
        before = reader.read(raw, before)
        assert np.abs(before.order - N)[before.valid].max() < 0.03
        assert before.valid.sum() > 0.9 * FACE.sum()


def test_a_saturated_pixel_and_one_that_is_no_retarder_are_not_told():
    N = SHARE * 0.4
    frames = phases(N, AXIS, SIX_STEPS)
    frames[:, 40:44, 40:44] = 0.5  # light without polarisation
    burnt = np.zeros(N.shape, bool)
    burnt[60:62, 60:62] = True
    found = order_from_phases(frames, SIX_STEPS, place_of(N, 0.125), mask=FACE, saturated=burnt)
    assert (found.why[41:43, 41:43] == Untold.UNLIKE).all()
    assert (found.why[burnt] == Untold.SATURATED).all()
    row, column, order = best_place(found)
    assert order == pytest.approx(N[row, column], abs=0.03)


def test_what_cannot_be_read_is_refused():
    N = SHARE * 0.8
    frames, place = phases(N, AXIS, SIX_STEPS), place_of(N, 0.125)
    with refused("phase-folded", InputError):
        order_from_phases(frames, SIX_STEPS, place_of(N, 0.5), mask=FACE)
    with refused("analyzer-count", InputError):
        order_from_phases(frames[:3], SIX_STEPS[:3], place)
    with refused("reference-outside", InputError):
        order_from_phases(frames, SIX_STEPS, (90, 0, 0.1))
    with refused("reference-outside", InputError):
        order_from_phases(frames[2:], CAMERA, (45, 45, 0.8))
    with refused("frame-order", InputError):
        order_from_phases(frames[[1, 0, 2, 3, 4, 5]], SIX_STEPS, place)
    with refused("light-range", InputError):
        order_from_phases(np.where(np.arange(6)[:, None, None] == 2, np.nan, frames), SIX_STEPS, place)
    with refused("light-range", InputError):
        order_from_phases(0 * frames, SIX_STEPS, place)
