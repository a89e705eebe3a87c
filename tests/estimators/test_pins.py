"""Pins: found where they are, followed where they go, given up where they are gone."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import ImageError, InputError, RangeError
from palpate.estimators.pins import FLOOR, PinTracks, find_pins, follow


def hexagon(rings: int, pitch: float) -> np.ndarray:
    steps = [
        (i, j) for i in range(-rings, rings + 1) for j in range(-rings, rings + 1) if abs(i + j) <= rings
    ]
    i, j = np.array(sorted(steps, key=lambda s: s[0] ** 2 + s[0] * s[1] + s[1] ** 2)).T
    return pitch * np.stack([i + j / 2, np.sqrt(0.75) * j], axis=1)


def drawn(xy, rng, radius=6.0, size=300, noise=2.0) -> np.ndarray:
    y, x = np.indices((size, size))
    image = np.full((size, size), 18.0)
    for px, py in xy:
        share = np.clip((radius - np.hypot(x - px, y - py)) / 1.5 + 0.5, 0, 1)
        image = np.maximum(image, 18 + 182 * share)
    return np.clip(np.rint(image + noise * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)


def matched(found, truth) -> np.ndarray:
    """Distance of every found pin to the nearest true one."""
    return np.hypot(*(found[:, None] - truth[None]).transpose(2, 0, 1)).min(axis=1)


def test_pins_are_found_to_a_few_hundredths_of_a_pixel(rng) -> None:
    truth = np.array([149.3, 150.8]) + hexagon(6, 20.3)
    pins = find_pins(drawn(np.concatenate([truth, [[2.0, 30.0]]]), rng))  # one is cut by the border
    assert len(pins.xy_px) == 127
    assert matched(pins.xy_px, truth).max() < 0.06
    assert_allclose(pins.xy_px[0], [149.3, 150.8], atol=0.06)


@pytest.mark.slow
def test_pins_are_followed_through_stretch_and_shift(rng) -> None:
    middle, lattice = np.array([149.5, 149.5]), hexagon(6, 18.0)
    truths = [middle + lattice * (1 + 0.004 * k) + 0.3 * k for k in range(20)]
    frames = [drawn(truth, rng) for truth in truths]
    pins = find_pins(frames[0])
    order = [int(np.argmin(np.hypot(*(truths[0] - xy).T))) for xy in pins.xy_px]
    for truth, now in zip(truths[1:], follow(frames[1:], pins), strict=True):
        assert np.hypot(*(now.xy_px - truth[order]).T).max() < 0.08


def test_a_pin_that_fades_is_lost_and_stays_lost(rng) -> None:
    truth = np.array([149.5, 149.5]) + hexagon(4, 25.0)
    first, without = drawn(truth, rng), drawn(np.delete(truth, 5, axis=0), rng)
    pins = find_pins(first)
    gone = int(np.argmin(np.hypot(*(pins.xy_px - truth[5]).T)))
    later = list(follow([without, first], pins))
    for now in later:
        assert not now.found[gone]
        assert now.found.sum() == 60


def test_a_centroid_is_the_mean_place_weighed_by_what_is_over_the_floor(rng) -> None:
    image = drawn(np.array([[30.3, 40.2], [5.0, 4.0], [76.0, 75.2]]), rng, size=80)
    pins = PinTracks(
        np.array([[30.0, 40.0], [6.0, 5.0], [75.0, 75.0]]), 18.0, 200.0, np.full(3, 14.0), np.ones(3)
    )
    now = next(follow([image], pins))
    y, x = np.indices(image.shape)
    over = np.clip(image - (18.0 + FLOOR * 182), 0, None)
    for at in now.xy_px:
        near = over * (np.hypot(x - at[0], y - at[1]) <= 14)
        assert_allclose(at, [(near * x).sum() / near.sum(), (near * y).sum() / near.sum()], atol=0.01)


def test_wide_windows_do_not_overflow(rng) -> None:
    truth = np.array([[600.0, 500.0], [1800.0, 500.0]])
    image = np.zeros((1000, 2400), np.uint8)
    for x, y in truth:
        cv2.circle(image, (int(x), int(y)), 400, 200, -1)
    assert matched(find_pins(image, least=2).xy_px, truth).max() < 0.1


def test_images_without_pins_are_refused(rng) -> None:
    noise = rng.integers(0, 30, (300, 300)).astype(np.uint8)
    for image in (noise, np.zeros((300, 300), np.uint8), np.full((300, 300), 255, np.uint8)):
        with refused("pins-not-found", ImageError):
            find_pins(image, least=40)
    with refused("pin-count", RangeError):
        find_pins(noise, least=1)
    with refused("pixel-format", ImageError, match="8-bit"):
        find_pins(np.zeros((10, 10)))
    pins = find_pins(drawn(np.array([149.5, 149.5]) + hexagon(2, 40.0), rng))
    with refused("pixel-format", InputError, match="8-bit"):
        next(follow([np.zeros((10, 10, 4), np.uint8)], pins))
