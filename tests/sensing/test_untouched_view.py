"""Touch without a calibration: what was put in is found, and nothing where nothing was."""

import math

import cv2
import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import ImageError, InputError, Pose, RangeError
from palpate.core.sensor import dark_field_of, for_live, sensor
from palpate.sensing.uncalibrated import edge_share, tail_weights, upper_quantile
from palpate.sensing.untouched_view import UntouchedView

ROWS, COLUMNS = np.mgrid[:480, :640].astype(float)
LIT = 100 + 30 * np.sin(COLUMNS / 200) + 20 * np.cos(ROWS / 150)
NOISE = 2.0  # grey levels


def taken(image: np.ndarray, rng: np.random.Generator, noise: float = NOISE) -> np.ndarray:
    """An image as a camera takes it."""
    return np.clip(np.rint(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)


def disc(x: float, y: float, radius: float) -> np.ndarray:
    """A disc's share of each pixel, to a good approximation."""
    return np.clip(radius + 0.5 - np.hypot(COLUMNS - x, ROWS - y), 0, 1)


@pytest.fixture(scope="module")
def view() -> UntouchedView:
    rng = np.random.default_rng(1)
    return UntouchedView([taken(LIT, rng) for _ in range(10)], mm_per_px=0.05)


@pytest.mark.parametrize(
    ("x", "y", "radius", "level"), [(300.3, 222.7, 25.0, 12.0), (200.0, 260.0, 90.0, -25.0)]
)
def test_a_disc_s_centroid_is_found_to_half_a_pixel_and_its_area_to_three_percent(
    view: UntouchedView, x: float, y: float, radius: float, level: float
) -> None:
    seen = view.seen(taken(LIT + level * disc(x, y, radius), np.random.default_rng(2)))
    assert seen.verdict == "touched"
    assert seen.region is not None
    assert np.hypot(seen.region.centre_px[0] - x, seen.region.centre_px[1] - y) < 0.5
    assert seen.region.area_px == pytest.approx(math.pi * radius**2, rel=0.03)
    assert seen.region.strength == pytest.approx(abs(level), rel=0.05)
    far = np.hypot(*(seen.region.outline_px - [x, y]).T)
    assert abs(far - radius).max() < 4  # two pixels of the grid


def test_millimetres_are_from_the_middle_of_the_skin(view: UntouchedView) -> None:
    seen = view.seen(taken(LIT + 20 * disc(419.5, 139.5, 30), np.random.default_rng(3))).region
    assert seen is not None
    assert seen.centre_mm == pytest.approx((5.0, -5.0), abs=0.025)
    assert seen.area_mm2 == pytest.approx(math.pi * 1.5**2, rel=0.03)


def test_noise_alone_is_a_touch_at_the_stated_rate_at_most_and_not_much_less() -> None:
    """The rate is of frames and references together, since a reference has noise of its own."""
    rng = np.random.default_rng(5)
    part, rate, count = LIT[:120, :160], 0.2, 0
    for _ in range(15):
        small = UntouchedView([taken(part, rng) for _ in range(12)], false_alarm_rate=rate, least_change=0)
        count += sum(small.seen(taken(part, rng)).verdict != "untouched" for _ in range(16))
    assert 0.25 * rate < count / 240 < 1.3 * rate


@pytest.mark.parametrize("gain", [1.1])
def test_brightness_alone_is_no_touch(view: UntouchedView, gain: float) -> None:
    rng = np.random.default_rng(6)
    seen = [view.seen(taken(gain * LIT, rng)) for _ in range(5)]
    assert {one.verdict for one in seen} == {"untouched"}
    assert np.mean([one.gain for one in seen]) == pytest.approx(gain, rel=2e-3)


def test_a_camera_that_moved_is_another_view_and_says_by_how_much() -> None:
    rng = np.random.default_rng(9)
    scene = cv2.GaussianBlur(rng.uniform(0, 255, (500, 660)), (0, 0), 3)
    scene = 128 + (scene - scene.mean()) * 40 / scene.std()
    here, moved = scene[10:490, 10:650], scene[9:489, 8:648]  # what was at (x, y) lies at (x + 2, y + 1)
    still = UntouchedView([taken(here, rng) for _ in range(8)], region=(100, 80, 440, 320))
    assert still.seen(taken(here, rng)).verdict == "untouched"
    seen = still.seen(taken(moved, rng))
    assert seen.verdict == "view-changed"
    assert "2.0, 1.0" in seen.why


def test_a_touch_over_most_of_the_skin_is_a_touch_where_its_surroundings_stay(view: UntouchedView) -> None:
    rng = np.random.default_rng(10)
    skin = UntouchedView([taken(LIT, rng) for _ in range(8)], region=(160, 80, 320, 320))
    glow = 30 * np.sin(COLUMNS / 25) * np.cos(ROWS / 30) * disc(320, 240, 165)
    seen = skin.seen(taken(LIT + glow, rng))
    assert seen.verdict == "touched"
    assert seen.changed_share > 0.6
    other_light = LIT + 40 * np.sin(COLUMNS / 90) + 20 * np.cos(ROWS / 60)
    assert skin.seen(taken(other_light, rng)).verdict == "view-changed"


def test_a_colour_that_changes_and_keeps_its_grey_is_a_touch() -> None:
    rng = np.random.default_rng(11)
    rgb = np.stack([LIT, LIT, LIT], axis=2)
    colour = UntouchedView([taken(rgb, rng) for _ in range(8)])
    shift = disc(300, 200, 30)[..., None] * np.array([12.0, 0.0, -12.0])
    grey = UntouchedView([taken(LIT, rng) for _ in range(8)])
    assert colour.seen(taken(rgb + shift, rng)).verdict == "touched"
    assert grey.seen(taken((rgb + shift).mean(axis=2), rng)).verdict == "untouched"


@pytest.mark.parametrize(("sigma", "spread"), [(1.5, 6.0), (2.0, 1.0)])
def test_the_mean_square_of_smoothed_noise_has_the_stated_tail(sigma: float, spread: float) -> None:
    rng = np.random.default_rng(12)
    weights = tail_weights(sigma, spread)
    assert weights.sum() == pytest.approx(1, abs=5e-3)
    noise = cv2.GaussianBlur(rng.normal(size=(1500, 1500)), (0, 0), sigma)
    mean = cv2.GaussianBlur(noise**2 / noise.var(), (0, 0), spread)
    for probability in (0.1, 1e-2):
        seen = float((mean > upper_quantile(probability, weights, 1)).mean())
        assert seen == pytest.approx(probability, rel=0.25), probability
    assert float((mean > 0.8 * upper_quantile(1e-2, weights, 1)).mean()) > 1.3e-2


def test_a_straight_edge_lies_where_the_mean_square_is_the_stated_share() -> None:
    step = np.zeros((64, 401), np.float64)
    step[:, 200:] = 1.0
    step[:, 200] = 0.5  # the edge lies in the middle of this pixel
    square = cv2.GaussianBlur(cv2.GaussianBlur(step, (31, 31), 3.0) ** 2, (41, 41), 4.0)
    assert square[32, 200] == pytest.approx(edge_share(3.0, 4.0), abs=2e-3)
    assert edge_share(3.0, 1e-9) == pytest.approx(0.25)


def test_frames_of_another_kind_are_refused_with_what_to_do(view: UntouchedView) -> None:
    with refused("frames-differ", InputError):
        view.seen(np.zeros((480, 320), np.uint8))
    with refused("too-few-frames", InputError):
        UntouchedView([LIT.astype(np.uint8)] * 4)
    with refused("pixel-format", ImageError, match="8-bit"):
        UntouchedView([LIT] * 5)
    with refused("region-outside", RangeError):
        UntouchedView([LIT.astype(np.uint8)] * 5, region=(600, 0, 100, 100))
    with refused("false-alarm-rate", RangeError):
        UntouchedView([LIT.astype(np.uint8)] * 5, false_alarm_rate=0.9)


def test_a_small_part_that_changes_much_is_a_touch_however_much_around_it_changes_a_little() -> None:
    rng = np.random.default_rng(14)
    steady = UntouchedView([taken(LIT, rng, 0.5) for _ in range(8)])
    little = 0.9 * disc(320, 240, 180)
    assert steady.seen(taken(LIT + little, rng, 0.5)).verdict == "untouched"
    seen = steady.seen(taken(LIT + little + 25 * disc(380, 200, 14), rng, 0.5))
    assert seen.verdict == "touched"
    assert seen.region is not None
    assert np.hypot(seen.region.centre_px[0] - 380, seen.region.centre_px[1] - 200) < 2
    assert seen.region.strength == pytest.approx(25, rel=0.2)


def test_a_skin_that_the_camera_sees_through_shows_something_in_view_and_no_touch() -> None:
    rng = np.random.default_rng(15)
    clear = UntouchedView([taken(LIT, rng) for _ in range(8)], see_through=True)
    assert clear.seen(taken(LIT, rng)).verdict == "untouched"
    assert clear.seen(taken(LIT + 20 * disc(300, 200, 30), rng)).verdict == "in-view"


DARK = np.where(COLUMNS < 320, 20.0, 90.0)  # crossed polarisers on the left, a mirror's picture on the right
SKIN = (0, 160, 320, 320)


@pytest.fixture(scope="module")
def dark() -> UntouchedView:
    rng = np.random.default_rng(16)
    return UntouchedView([taken(DARK, rng) for _ in range(8)], region=SKIN, dark_field=True)


def test_in_a_dark_field_light_in_the_skin_is_a_touch_and_what_else_is_seen_is_in_view(
    dark: UntouchedView,
) -> None:
    rng = np.random.default_rng(17)
    near = DARK + 40 * disc(480, 200, 40)
    assert {dark.seen(taken(DARK, rng)).verdict for _ in range(4)} == {"untouched"}
    seen = dark.seen(taken(near, rng))
    assert seen.verdict == "in-view"
    assert seen.region is not None
    assert np.hypot(seen.region.centre_px[0] - 480, seen.region.centre_px[1] - 200) < 1
    for light in (6 * disc(100, 300, 20), 120 * (ROWS > 160) * (COLUMNS < 320)):  # a little; all of the skin
        assert dark.seen(taken(near + light, rng)).verdict == "touched"


@pytest.mark.slow
def test_a_ball_over_the_virtual_palm_is_in_view_and_one_that_presses_half_a_newton_touches() -> None:
    palm, rng = for_live(sensor("palm")), np.random.default_rng(19)
    ball = palm.probe(palm.default_probe)

    def taken_at(x_mm: float, depth_mm: float) -> np.ndarray:
        pose = Pose(1e-3 * x_mm, -5e-3, 1e-3 * depth_mm)
        return np.asarray(palm.render(palm.press(ball, pose), rng).image)

    law = palm.force_law(ball)
    half_mm = 1e3 * float(np.interp(0.5, law.force_n, law.depth_m))
    still = [taken_at(0, -3) for _ in range(6)]
    told = UntouchedView(still, region=dark_field_of(palm), dark_field=True)
    assert told.seen(taken_at(0, -3)).verdict == "untouched"
    assert told.seen(taken_at(9, -3)).verdict == "in-view"
    assert told.seen(taken_at(9, half_mm)).verdict == "touched"
