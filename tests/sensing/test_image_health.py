"""A picture's focus, noise, flicker and exposure: what was put in is told, and what was not is not."""

import math

import cv2
import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import ImageError, InputError, RangeError
from palpate.sensing.image_health import edge_blur_px, image_health, seen_frequency_hz

HEIGHT, WIDTH = 120, 160
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH].astype(float)


def step(blur: float, fine: int = 8) -> np.ndarray:
    """An inclined edge of a step blurred by a Gaussian, averaged over pixels: no more blur than that."""
    y, x = np.mgrid[: HEIGHT * fine, : WIDTH * fine] / fine
    sharp = np.where((x - 80) * np.cos(0.15) + (y - 60) * np.sin(0.15) > 0, 180.0, 60.0).astype(np.float32)
    return cv2.resize(
        cv2.GaussianBlur(sharp, (0, 0), blur * fine), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA
    )


def movie(
    scene: np.ndarray,
    frames: int = 48,
    rate_hz: float = 30.0,
    lamp_hz: float = 100.0,
    amplitude: float = 0.0,
    readout_s: float = 0.0,
    noise: float = 1.5,
    seed: int = 0,
    rise: np.ndarray | None = None,
) -> list[np.ndarray]:
    """A still scene under a lamp, rows exposed one after the other, for a moment each; brighter by `rise`."""
    rng = np.random.default_rng(seed)
    taken = []
    for i in range(frames):
        at = i / rate_hz + np.arange(HEIGHT) / HEIGHT * readout_s
        light = 1 + amplitude * np.sin(2 * np.pi * lamp_hz * at + 0.3) + (0.0 if rise is None else rise[i])
        seen = scene * light[:, None] + rng.normal(0, noise, scene.shape)
        taken.append(np.clip(np.rint(seen), 0, 255).astype(np.uint8))
    return taken


SCENE = 100 + 30 * np.sin(COLUMNS / 30)


@pytest.mark.parametrize(("blur", "noise"), [(1.0, 0.0), (2.0, 1.0), (4.0, 1.0)])
def test_the_blur_of_an_edge_is_told(blur: float, noise: float) -> None:
    image = step(blur) + np.random.default_rng(1).normal(0, noise, (HEIGHT, WIDTH))
    assert edge_blur_px(image, noise) == pytest.approx(blur, rel=0.03)


def test_what_has_no_edge_has_no_blur() -> None:
    assert edge_blur_px(SCENE) is None
    assert edge_blur_px(np.random.default_rng(2).normal(100, 2, (HEIGHT, WIDTH)), 2.0) is None


@pytest.mark.parametrize("noise", [0.7, 5.0])
def test_noise_is_told_with_the_rounding_to_grey_levels_and_without_the_flicker(noise: float) -> None:
    flickering = movie(SCENE, amplitude=0.05, readout_s=0.02, noise=noise)
    assert image_health(flickering, 30.0).noise == pytest.approx(math.sqrt(noise**2 + 1 / 12), rel=0.02)


@pytest.mark.parametrize(
    ("rate_hz", "lamp_hz", "readout_s", "seen_hz", "mains_hz"),
    [
        (30.0, 100.0, 0.0, 10.0, 50.0),
        (25.0, 120.0, 0.02, 5.0, 60.0),
    ],
)
def test_the_flicker_of_lamps_on_mains_is_told_with_its_amplitude_and_the_exposure_against_it(
    rate_hz: float, lamp_hz: float, readout_s: float, seen_hz: float, mains_hz: float
) -> None:
    health = image_health(movie(SCENE, 60, rate_hz, lamp_hz, 0.04, readout_s), rate_hz)
    assert seen_frequency_hz(lamp_hz, rate_hz) == pytest.approx(seen_hz)
    assert health.flicker.frequency_hz == pytest.approx(seen_hz, abs=0.1)
    assert health.flicker.mains_hz == mains_hz
    assert math.hypot(health.flicker.amplitude, health.flicker.bands) == pytest.approx(0.04, rel=0.03)
    (advice,) = health.advice
    assert ("10 ms" if mains_hz == 50 else "8.333 ms") in advice


def test_even_light_does_not_flicker_and_lamps_in_step_with_the_frames_are_not_seen() -> None:
    for amplitude in (0.0, 0.04):
        flicker = image_health(movie(SCENE, 60, 30.0, 120.0, amplitude, 0.02), 30.0).flicker
        assert (flicker.frequency_hz, flicker.mains_hz) == (None, None)
        assert max(flicker.amplitude, flicker.bands) < 2e-3


def test_a_lamp_that_is_on_no_mains_is_told_as_such() -> None:
    health = image_health(movie(SCENE, 60, 30.0, 7.0, 0.03), 30.0)
    assert health.flicker.frequency_hz == pytest.approx(7.0, abs=0.1)
    assert health.flicker.mains_hz is None
    assert "supply" in health.advice[0]


@pytest.mark.parametrize("frames", [16, 60])
@pytest.mark.parametrize("settles_in", [0.3, math.inf])  # of the time filmed; a straight line
def test_a_lamp_that_warms_up_does_not_flicker_and_one_that_does_both_is_told(
    frames: int, settles_in: float
) -> None:
    at = np.linspace(0, 1, frames)
    rise = 0.03 * (at if math.isinf(settles_in) else 1 - np.exp(-at / settles_in))
    alone = image_health(movie(SCENE, frames, rise=rise), 30.0)
    assert alone.flicker.frequency_hz is None
    assert not [word for word in alone.advice if "flicker" in word or "supply" in word]
    both = image_health(movie(SCENE, frames, amplitude=0.04, rise=rise), 30.0)
    assert both.flicker.frequency_hz == pytest.approx(10.0, abs=0.3)
    assert both.flicker.mains_hz == 50.0


def test_saturated_and_black_shares_are_those_that_were_put_in() -> None:
    scene = SCENE.copy()
    scene[:12] = 300.0  # a tenth
    scene[-6:] = -20.0  # a twentieth
    health = image_health(movie(scene, 6), 30.0)
    assert health.clipped == pytest.approx(0.1, abs=1e-3)
    assert health.black == pytest.approx(0.05, abs=1e-3)
    assert "saturated" in health.advice[0]


def test_focus_beside_a_reference_is_lost_with_blur_and_not_with_noise_or_brightness() -> None:
    texture = cv2.GaussianBlur(np.random.default_rng(3).uniform(0, 255, (HEIGHT, WIDTH)), (0, 0), 1.0)
    sharp = np.clip(128 + (texture - 128) * 1.5, 5, 250)
    (reference,) = movie(sharp, 1, noise=1.0)
    same = image_health(movie(0.8 * sharp, 12, noise=4.0), 30.0, reference=reference)
    assert same.sharpness == pytest.approx(1.0, abs=0.04)
    blurred = image_health(movie(cv2.GaussianBlur(sharp, (0, 0), 1.2), 12), 30.0, reference=reference)
    assert blurred.sharpness is not None
    assert 0.3 < blurred.sharpness < 0.75
    assert "refocus" in blurred.advice[0]


def test_a_good_picture_needs_nothing() -> None:
    health = image_health(movie(step(0.8), 24, noise=1.0), 30.0)
    assert health.good
    assert health.blur_px == pytest.approx(0.8, abs=0.1)
    assert health.to_dict()["flicker"]["frequency_hz"] is None


def test_frames_that_tell_nothing_are_refused_with_what_to_give() -> None:
    frames = movie(SCENE, 4)
    with refused("too-few-frames", InputError):
        image_health(frames[:3], 30.0)
    with refused("frame-rate", RangeError, match="0 Hz"):
        image_health(frames, 0.0)
    with pytest.raises(RangeError, match="inside"):
        image_health(frames, 30.0, region=(0, 0, 500, 20))
    with pytest.raises(InputError, match="one camera"):
        image_health([*frames, frames[0][:60]], 30.0)
    with pytest.raises(ImageError, match="8-bit"):
        image_health([SCENE] * 4, 30.0)
