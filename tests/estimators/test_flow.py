"""Optical flow: what any flow must obey, and the fast path against the plain equations."""

import tracemalloc
from functools import cache

import numpy as np
import pytest
import tifffile
from numpy.testing import assert_allclose
from tests.oracles.plain_flow import derivatives, divergence as plain_divergence, horn_schunck
from tests.refusals import refused

from palpate.core.errors import ImageError, InputError, RangeError
from palpate.estimators.flow.horn_schunck import (
    HornSchunck,
    along,
    brightness,
    dis,
    divergence,
    flow,
)
from palpate.recordings.exchange.frame_sequences import TiffFrames


def waves(shape=(90, 120), shift=(0.0, 0.0), stretch=0.0) -> np.ndarray:
    """A smooth pattern, moved by the shift (x, y) px and stretched about the image's middle."""
    y, x = np.indices(shape).astype(float)
    cy, cx = (np.array(shape) - 1) / 2
    x = cx + (x - cx - shift[0]) / (1 + stretch)
    y = cy + (y - cy - shift[1]) / (1 + stretch)
    return 0.5 + 0.2 * np.sin(0.31 * x + 0.11 * y) + 0.2 * np.sin(0.27 * y - 0.13 * x + 1)


def pins(stretch=0.0, rng=None) -> np.ndarray:
    """127 bright pins on dark, 300 x 300 px, stretched about the middle; grey noise if wanted."""
    image = clean_pins(stretch)
    if rng is not None:
        image = image + rng.normal(0, 2, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@cache
def clean_pins(stretch: float) -> np.ndarray:
    y, x = np.indices((300, 300))
    image = np.full((300, 300), 18.0)
    for i in range(-6, 7):
        for j in range(-6, 7):
            if abs(i + j) <= 6:
                px, py = 149.5 + np.array([21 * (i + j / 2), 18.2 * j]) * (1 + stretch)
                image = np.maximum(image, 200 * np.clip((7.5 - np.hypot(x - px, y - py)) / 1.5 + 0.5, 0, 1))
    return image


def test_no_motion_is_no_flow() -> None:
    image = pins()
    for between in (flow, dis):
        assert abs(between(image, image)).max() < 1e-3


def test_flow_solves_the_equations_of_its_minimum() -> None:
    """At rest: alpha^2 (mean - flow) = E (E . flow + E_t), Horn and Schunck's two equations."""
    first, second = waves((45, 60)), waves((45, 60), (0.3, -0.2))
    settings = HornSchunck(alpha=0.05, iterations=3000)
    u, v = horn_schunck(first, second, settings)
    e_x, e_y, e_t = derivatives(first, second)
    means = [
        sum(
            w * np.pad(f, 1, mode="edge")[1 + i : 46 + i, 1 + j : 61 + j]
            for (i, j), w in {
                (0, 1): 1 / 6, (0, -1): 1 / 6, (1, 0): 1 / 6, (-1, 0): 1 / 6,
                (1, 1): 1 / 12, (1, -1): 1 / 12, (-1, 1): 1 / 12, (-1, -1): 1 / 12,
            }.items()
        )
        for f in (u, v)
    ]  # fmt: skip
    off = e_x * u + e_y * v + e_t
    assert_allclose(settings.alpha**2 * (means[0] - u), e_x * off, atol=1e-9)
    assert_allclose(settings.alpha**2 * (means[1] - v), e_y * off, atol=1e-9)


def test_the_divergence_of_a_stretch_is_twice_the_stretch() -> None:
    found = horn_schunck(waves(), waves(stretch=0.01), HornSchunck(alpha=0.01, iterations=500))
    assert_allclose(plain_divergence(found)[20:-20, 20:-20].mean(), 0.02, rtol=0.05)


def test_divergence_of_a_linear_flow_is_exact_up_to_the_border() -> None:
    y, x = np.indices((9, 11)).astype(float)
    field = np.stack([0.3 * x - 0.2 * y + 1, 0.1 * x + 0.05 * y])
    assert_allclose(plain_divergence(field), 0.35, rtol=1e-12)
    assert_allclose(divergence(field.astype(np.float32)), 0.35, rtol=1e-5)


@pytest.mark.parametrize("iterations", [1, 26])
def test_the_fast_path_is_the_reference_to_a_millionth_of_a_pixel(rng, iterations) -> None:
    first, second = pins(0.0, rng), pins(0.01, rng)
    settings = HornSchunck(iterations=iterations)
    plain, fast = horn_schunck(first, second, settings), flow(first, second, settings)
    assert abs(plain).max() > 0.5
    assert abs(plain - fast).max() < 1e-6
    assert abs(plain_divergence(plain) - divergence(fast)).max() < 2e-6


def test_the_fast_path_agrees_on_small_and_narrow_images_whatever_it_did_before(rng) -> None:
    for shape in ((2, 2), (3, 40), (40, 3), (9, 15), (9, 16), (9, 17), (30, 33), (2, 2)):
        first, second = rng.integers(0, 256, (2, *shape), dtype=np.uint8)
        assert_allclose(flow(first, second), horn_schunck(first, second), rtol=1e-6, atol=1e-6)


def test_a_sequence_pairs_each_frame_with_the_last_or_with_the_first() -> None:
    frames = [np.full((4, 4), level, np.uint8) for level in range(30)]

    def pair(a, b):
        return int(a[0, 0]), int(b[0, 0])

    assert list(along(frames, pair, threads=3)) == [(i, i + 1) for i in range(29)]
    assert list(along(frames, pair, from_first=True, threads=3)) == [(0, i + 1) for i in range(29)]


def test_memory_does_not_grow_with_the_sequence(rng, tmp_path) -> None:
    def peak(frames: int) -> int:
        path = tmp_path / f"{frames}.tif"
        with tifffile.TiffWriter(path) as writer:
            for _ in range(frames):
                writer.write(rng.integers(0, 256, (200, 200), dtype=np.uint8), contiguous=False)
        with TiffFrames(path) as pages:
            tracemalloc.start()
            for field in along(pages, flow, threads=2):
                assert field.shape == (2, 200, 200)
            _, most = tracemalloc.get_traced_memory()
            tracemalloc.stop()
        return most

    peak(10)
    short, long = peak(10), peak(60)
    # 50 frames more are 2 MB, their flows 16 MB; of flows that wait for their turn, 0.32 MB each, there may
    # be a few more or fewer.
    assert abs(long - short) < 3e6


def test_what_cannot_be_flow_is_refused_with_the_reason() -> None:
    grey = np.zeros((8, 8), np.uint8)
    with refused("images-differ", InputError):
        flow(grey, np.zeros((8, 9), np.uint8))
    with refused("gray-image", ImageError):
        flow(np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8, 3), np.uint8))
    with refused("brightness-range", ImageError):
        brightness(np.full((8, 8), 255.0))
    with refused("pixel-format", ImageError, match="int64"):
        flow(grey.astype(int), grey.astype(int))
    with refused("too-few-frames", InputError):
        list(along([grey], flow))
    with refused("thread-count", InputError):
        along([grey, grey], flow, threads=-1)
    with refused("alpha-range", RangeError):
        HornSchunck(alpha=0)
    with refused("iteration-count", RangeError):
        HornSchunck(iterations=0)
