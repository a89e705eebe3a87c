"""Frames in, readings out, whatever they come from; a bad frame says so and does not end the rest."""

import cv2
import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import ImageError, InputError
from palpate.estimators import Estimator
from palpate.recordings import export_folder
from palpate.sensing import open_source, sense


@pytest.fixture
def estimator(calibrate_spots, tmp_path):
    plan = {"presses": 9, "targets": ("x_mm",), "split": "group:press", "size_px": (24, 32)}
    return Estimator.open(calibrate_spots(tmp_path / "cal", **plan)[1])


def test_a_run_and_its_exported_images_are_read_alike(estimator, record_spots, tmp_path) -> None:
    run = record_spots("fresh", 2, seed=4)
    export_folder(run, tmp_path / "exported")
    from_run = [s.readings["x_mm"].value for s in sense(estimator, open_source(run.path))]
    from_files = [
        s.readings["x_mm"].value for s in sense(estimator, open_source(tmp_path / "exported" / "images"))
    ]
    assert len(from_run) == 12
    assert from_run == from_files


def test_a_bad_image_among_good_ones_has_no_value_and_a_reason(estimator, record_spots, tmp_path) -> None:
    run = record_spots("fresh", 1, seed=5)
    folder = tmp_path / "mixed"
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), run.frame(1).image)
    (folder / "b.png").write_bytes((folder / "a.png").read_bytes()[:100])
    cv2.imwrite(str(folder / "c.png"), run.frame(2).image)
    good, bad, after = (s.to_dict() for s in sense(estimator, open_source(folder)))
    assert good["readings"]["x_mm"]["valid"]
    assert after["readings"]["x_mm"]["valid"]
    assert bad["readings"]["x_mm"]["value"] is None
    assert not bad["readings"]["x_mm"]["valid"]
    assert "b.png" in bad["readings"]["x_mm"]["why"]


def test_a_lamp_that_has_dimmed_is_seen_as_drift(estimator, record_spots) -> None:
    dimmed = record_spots("dimmed", 2, seed=8, lamp=-15.0)
    assert all(s.readings["x_mm"].drift.drifted for s in sense(estimator, open_source(dimmed.path)))


def test_there_must_be_something_to_sense(tmp_path) -> None:
    with refused("no-images", InputError):
        open_source(tmp_path)
    with refused("file-missing", ImageError, match=r"none.png"):
        open_source(tmp_path / "none.png")
    np.save(tmp_path / "array.png", np.zeros(3))
    (tmp_path / "array.png.npy").rename(tmp_path / "array.png")
    with refused("image-format", ImageError, match=r"array.png"):
        open_source(tmp_path / "array.png")
