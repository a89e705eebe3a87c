"""Divergence over a region reports an expansion that the mean over the whole image cannot contain."""

import cv2
import numpy as np
import pytest

from palpate.estimators.flow.horn_schunck import contact_region, course

GROWTH = 0.004  # of every length, a frame: the divergence is twice that
RADIUS_PX, SIZE = 70, 240


@pytest.fixture(scope="module")
def frames() -> list[np.ndarray]:
    """A disc of random texture on black that expands about its center."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    middle = (SIZE - 1) / 2
    noise = np.random.default_rng(0).uniform(0, 1, (SIZE, SIZE)).astype(np.float32)
    texture = cv2.GaussianBlur(noise, (0, 0), 2.0)
    texture = (texture - texture.min()) / np.ptp(texture) * (np.hypot(x - middle, y - middle) < RADIUS_PX)
    grown = [(1 + GROWTH) ** k for k in range(5)]
    images = [
        cv2.remap(texture, middle + (x - middle) / f, middle + (y - middle) / f, cv2.INTER_CUBIC)
        for f in grown
    ]
    return [np.rint(255 * image.clip(0, 1)).astype(np.uint8) for image in images]


def test_the_whole_image_has_the_flux_through_its_border_alone(frames) -> None:
    steps = list(course(frames))
    assert all(step.divergence == step.border_flux for step in steps)
    assert max(abs(step.border_flux) for step in steps) < 1e-6


def test_the_contact_region_reports_the_expansion(frames) -> None:
    region = contact_region(frames)
    assert region[SIZE // 2, SIZE // 2]
    assert np.pi * RADIUS_PX**2 / 2 < region.sum() < 2 * np.pi * RADIUS_PX**2
    steps = list(course(frames, region=region))
    found = np.mean([step.divergence for step in steps])
    assert GROWTH < found < 2.5 * GROWTH
    assert max(abs(step.border_flux) for step in steps) < 1e-6
    back = [step.divergence for step in course(frames[::-1], region=region)]
    assert np.mean(back) < -GROWTH


def test_where_nothing_moves_the_region_is_the_whole_image(frames) -> None:
    assert contact_region([frames[0], frames[0]]).all()
