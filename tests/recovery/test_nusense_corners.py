"""Corners that OpenCV finds in NUSense's frames lie where the sensor says that they are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import palpate
from palpate.core import Pose

MAX_RMS_PX = 0.05
HALF_WINDOW = (3, 3)


@pytest.mark.parametrize(("depth_mm", "x_mm", "y_mm"), [(0.0, 0.0, 0.0), (0.8, 4.0, 3.0), (1.7, -12.0, 6.0)])
def test_found_corners_are_the_true_ones_and_not_the_resting_ones(
    depth_mm: float, x_mm: float, y_mm: float
) -> None:
    sensor = palpate.sensor("nusense")
    contact = sensor.press(sensor.probe("round"), Pose(1e-3 * x_mm, 1e-3 * y_mm, 1e-3 * depth_mm))
    truth = sensor.tile_corners(contact)
    grey = np.ascontiguousarray(sensor.render(contact, np.random.default_rng(3)).image[..., 1])
    begun = truth.places_px + np.random.default_rng(4).uniform(-0.5, 0.5, truth.places_px.shape)
    found = cv2.cornerSubPix(
        grey,
        np.ascontiguousarray(begun[:, None], np.float32),
        HALF_WINDOW,
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4),
    )[:, 0]
    rms = float(np.sqrt(((found - truth.places_px) ** 2).mean()))
    assert rms < MAX_RMS_PX
    assert np.abs((found - truth.places_px).mean(axis=0)).max() < 0.02
    if depth_mm > 0:
        resting = sensor.tile_corners(sensor.press(sensor.probe("round"), Pose(0.0, 0.0, 0.0))).places_px
        assert float(np.sqrt(((found - resting) ** 2).mean())) > 3 * MAX_RMS_PX
