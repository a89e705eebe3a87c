"""Real taps as a video through the live loop: the readings of `evaluate`, frame by frame."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import palpate
from palpate.calibration import CalibrationPlan, calibrate
from palpate.calibration.evaluation import predictions
from palpate.estimators import Estimator
from palpate.recordings import Manifest, Run, RunWriter, import_images

SHOWN = 60
TARGETS = ("depth_mm", "tilt_x_deg")


def even(run: Run, path) -> Run:
    """Every second frame, of even width and height: OpenCV's videos have no others."""
    about = Manifest.new(sensor="tactip", labels=dict.fromkeys(TARGETS, "number"))
    with RunWriter.create(path, about, overflow="wait") as writer:
        for i in range(0, len(run), 2):
            image = run.frame(i).image
            height, width = (size & ~1 for size in image.shape[:2])
            labels = {name: float(run.labels[name][i]) for name in TARGETS}
            writer.frame(image[:height, :width], labels=labels)
    return Run.open(path)


@pytest.mark.slow
def test_a_video_of_real_taps_reads_as_evaluate_does(real_data, tmp_path) -> None:
    source = real_data / "tactip-surface" / "val"
    if not source.is_dir():
        pytest.skip(f"no TacTip recordings at {source}")
    import_images(source, tmp_path / "taps", labels=source / "labels.csv", image_column="image_file")
    run = even(Run.open(tmp_path / "taps"), tmp_path / "even")
    plan = CalibrationPlan(TARGETS, split="random", scored_folds=1, size_px=(56, 56))
    calibration = calibrate(run, plan, tmp_path / "cal")
    first = run.frame(0).image
    writer = cv2.VideoWriter(
        str(tmp_path / "taps.avi"), cv2.VideoWriter.fourcc(*"FFV1"), 20.0, first.shape[1::-1], isColor=True
    )
    for i in range(SHOWN):
        image = run.frame(i).image
        bgr = cv2.COLOR_GRAY2BGR if image.ndim == 2 else cv2.COLOR_RGB2BGR
        writer.write(cv2.cvtColor(image, bgr))
    writer.release()
    table = predictions(Estimator.open(calibration), run)
    with palpate.live(calibration, camera=tmp_path / "taps.avi") as readings:
        live = [[reading.readings[name].value for name in TARGETS] for reading in readings]
    evaluated = table[[f"estimate:{name}" for name in TARGETS]].to_numpy()[:SHOWN]
    assert np.array(live) == pytest.approx(evaluated, rel=1e-6, abs=1e-6)
    assert np.abs(np.array(live) - evaluated[::-1]).max() > 0.5  # in another order they are not
