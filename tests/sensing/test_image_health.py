"""A picture's focus, noise, flicker and exposure: what was put in is told, and what was not is not."""

import math

import cv2
import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import ImageError, InputError, RangeError
from palpate.sensing.image_health import edge_blur_px, image_health

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
    assert image_health(flickering).noise == pytest.approx(math.sqrt(noise**2 + 1 / 12), rel=0.02)


@pytest.mark.parametrize(("lamp_hz", "readout_s"), [(100.0, 0.0), (120.0, 0.02), (7.0, 0.0)])
def test_the_flicker_of_lamps_is_told_with_its_amplitude(lamp_hz: float, readout_s: float) -> None:
    rate_hz = 25.0 if lamp_hz == 120.0 else 30.0
    health = image_health(movie(SCENE, 60, rate_hz, lamp_hz, 0.04, readout_s))
    assert health.flicker == pytest.approx(0.04, rel=0.04)
    assert len(health.advice) == 1


def test_even_light_does_not_flicker_and_lamps_in_step_with_the_frames_are_not_seen() -> None:
    for amplitude in (0.0, 0.04):
        assert image_health(movie(SCENE, 60, 30.0, 120.0, amplitude, 0.02)).flicker < 2e-3


@pytest.mark.parametrize("frames", [16, 60])
@pytest.mark.parametrize("settles_in", [0.3, math.inf])  # of the time filmed; a straight line
def test_a_lamp_that_warms_up_does_not_flicker_and_one_that_does_both_is_told(
    frames: int, settles_in: float
) -> None:
    at = np.linspace(0, 1, frames)
    rise = 0.03 * (at if math.isinf(settles_in) else 1 - np.exp(-at / settles_in))
    assert not image_health(movie(SCENE, frames, rise=rise)).advice
    assert image_health(movie(SCENE, frames, amplitude=0.04, rise=rise)).flicker > 0.03


def test_saturated_and_black_shares_are_those_that_were_put_in() -> None:
    scene = SCENE.copy()
    scene[:12] = 300.0  # a tenth
    scene[-6:] = -20.0  # a twentieth
    health = image_health(movie(scene, 6))
    assert health.clipped == pytest.approx(0.1, abs=1e-3)
    assert health.black == pytest.approx(0.05, abs=1e-3)
    assert "saturated" in health.advice[0]


def test_a_good_picture_needs_nothing() -> None:
    health = image_health(movie(step(0.8), 24, noise=1.0))
    assert health.good
    assert health.blur_px == pytest.approx(0.8, abs=0.1)


def test_frames_that_tell_nothing_are_refused_with_what_to_give() -> None:
    frames = movie(SCENE, 4)
    with refused("too-few-frames", InputError):
        image_health(frames[:3])
    with pytest.raises(RangeError, match="inside"):
        image_health(frames, region=(0, 0, 500, 20))
    with pytest.raises(InputError, match="one camera"):
        image_health([*frames, frames[0][:60]])
    with pytest.raises(ImageError, match="8-bit"):
        image_health([SCENE] * 4)
