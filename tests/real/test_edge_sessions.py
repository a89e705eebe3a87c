"""Real taps on an edge, of two sessions: a stand-in, since no data of our sensors is public."""

import csv

import cv2
import numpy as np
import pytest

from palpate.estimators.networks import TrainingData, make_model
from palpate.estimators.networks.model_interface import predict_rows

PINS_PX = (63, 63, 53)  # centre and radius of what the pins fill; beyond are specks that drift


def taps(real_data, part: str) -> tuple[np.ndarray, np.ndarray]:
    """Images cut to the pins, and offset [mm], depth [mm] and angle [degrees] of the edge."""
    folder = real_data / "edge-two-sessions" / part
    if not folder.is_dir():
        pytest.skip(f"no recordings of an edge at {folder}")
    with (folder / "labels.csv").open() as file:
        rows = list(csv.DictReader(file))
    images = [cv2.imread(str(folder / "images" / row["image_file"]), cv2.IMREAD_GRAYSCALE) for row in rows]
    (x, y, radius), (ys, xs) = PINS_PX, np.mgrid[0:128, 0:128]
    inside = (xs - x) ** 2 + (ys - y) ** 2 <= radius**2
    values = [[float(row[name]) for name in ("edge_mm", "depth_mm", "angle_deg")] for row in rows]
    return (np.stack(images) * inside).astype(np.float32)[:, None], np.array(values)


@pytest.mark.slow
def test_the_default_reads_the_next_sessions_edge_twice_as_well_as_a_linear_map(real_data) -> None:
    (images, labels), (others, truth) = (taps(real_data, part) for part in ("first", "second"))
    angle = np.deg2rad(labels[:, 2])
    values = np.column_stack([labels[:, :2], np.cos(angle), np.sin(angle)])
    rows = np.arange(len(values))
    learn = TrainingData(images.shape[1:], values, rows, lambda chosen: images[chosen])
    next_session = TrainingData(
        images.shape[1:], values[: len(others)], rows[: len(others)], lambda chosen: others[chosen]
    )
    errors = {}
    for name in ("kernel-ridge", "pca-ridge"):
        fitted = make_model(name, {}).fit(learn, rows, seed=0)
        found = predict_rows(fitted, next_session, np.arange(len(others)))
        turn = np.rad2deg(np.arctan2(found[:, 3], found[:, 2])) - truth[:, 2]
        errors[name] = np.append(
            np.abs(found[:, :2] - truth[:, :2]), abs((turn + 180) % 360 - 180)[:, None], 1
        )
    ours, linear = (errors[name].mean(axis=0) for name in ("kernel-ridge", "pca-ridge"))
    assert (ours < linear).all()
    assert ours[0] < 0.25
    assert ours[2] < 4 < 5 < linear[2]
