"""The lens's verbs: a file and its picture, nothing overwritten, and a calibration that takes the lens."""

import json

import cv2
import numpy as np
import pytest
from tests.calibration.lens.board_scenes import BOARD, FISHEYE, write_photographs
from typer.testing import CliRunner

from palpate.calibration import CalibrationPlan, calibrate
from palpate.cli import app
from palpate.core import ImageError, Lens
from palpate.estimators import Estimator
from palpate.recordings import Run


def run_verb(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.slow
def test_calibrate_makes_a_lens_file_and_a_picture_and_overwrites_nothing(tmp_path):
    photos = tmp_path / "photos"
    write_photographs(photos, FISHEYE, BOARD, 9)
    out = tmp_path / "lens.json"
    words = ("lens", "calibrate", photos, "--board", "9x6", "--out", out, "--json", "--name", "left")
    done = run_verb(*words)
    assert done.exit_code == 0, done.output
    lens = Lens.read(out)
    assert json.loads(done.stdout)["id"] == lens.id
    assert lens.name == "left"
    assert json.loads(out.read_text())["calibration"]["views"]
    assert cv2.imread(str(out.with_suffix(".png"))) is not None
    before = out.read_bytes()
    assert run_verb(*words).exit_code == 2
    assert out.read_bytes() == before
    shown = run_verb("lens", "show", out, "--json")
    assert json.loads(shown.stdout)["field_deg"] == pytest.approx(np.degrees(lens.field_rad))
    flat = tmp_path / "flat.png"
    done = run_verb("lens", "undistort", photos / "000.png", "--lens", out, "--out", flat)
    assert done.exit_code == 0, done.output
    assert cv2.imread(str(flat), 0).shape == (480, 640)
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((24, 32), np.uint8))
    refused = run_verb(
        "lens", "undistort", tmp_path / "small.png", "--lens", out, "--out", tmp_path / "no.png"
    )
    assert refused.exit_code == 2
    assert not (tmp_path / "no.png").exists()


def test_too_few_views_leave_no_file(tmp_path):
    write_photographs(tmp_path / "photos", FISHEYE, BOARD, 1)
    out = tmp_path / "lens.json"
    done = run_verb("lens", "calibrate", tmp_path / "photos", "--board", "9x6", "--out", out)
    assert done.exit_code == 2
    assert "6 or more" in done.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["photos"]


def test_a_board_is_drawn_for_print(tmp_path):
    out = tmp_path / "board.png"
    assert run_verb("lens", "board", "--board", "7x5", "--charuco", "4X4_50", "--out", out).exit_code == 0
    assert cv2.imread(str(out), 0).shape == (8 * 120, 10 * 120)


@pytest.mark.slow
def test_a_calibration_keeps_its_lens_and_reads_by_it(record_spots, tmp_path):
    lens = Lens("kannala-brandt", (40.0, 40.0), (31.5, 23.5), (0.05, 0, 0, 0), (48, 64), 0.7)
    run = record_spots("run", 16)
    lens.write(tmp_path / "lens.json")
    done = run_verb(
        "calibrate", run.path, "--targets", "x_mm", "--model", "pca-ridge", "--size", "24x32",
        "--lens", tmp_path / "lens.json", "--out", tmp_path / "cal", "--json",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    estimator = Estimator.open(tmp_path / "cal")
    assert estimator.card.input.lens.id == lens.id
    assert estimator.card.input.preparation.lens == lens
    assert estimator.card.steps.rule == "palpate-steps/3"
    assert CalibrationPlan.of_card(estimator.card, None, "auto").lens == lens
    # Read by the lens: a plain calibration of frames rectified beforehand reads the same.
    frame = Run.open(run.path).frame(3).image
    plain = calibrate(run, CalibrationPlan(("x_mm",), "pca-ridge", size_px=(24, 32)), tmp_path / "plain")
    assert "lens" not in json.loads((plain / "card.json").read_text())["input"]
    assert estimator.read(frame)["x_mm"].value != Estimator.open(plain).read(frame)["x_mm"].value
    # Whoever says the lens of the frames is refused where it is another one than the calibration's.
    other = Lens("kannala-brandt", (40.5, 40.5), (31.5, 23.5), (0.05, 0, 0, 0), (48, 64), 0.7)
    other.write(tmp_path / "other.json")

    def given(verb, calibration):
        return (run.path, "--with", calibration) if verb == "read" else (calibration, run.path)

    for verb, more in (("read", []), ("evaluate", ["--no-keep"]), ("adapt", ["--out", tmp_path / "own"])):
        refused = run_verb(verb, *given(verb, tmp_path / "cal"), *more, "--lens", tmp_path / "other.json")
        assert refused.exit_code == 2, refused.output
        assert other.id in refused.output
        assert lens.id in refused.output
        without = run_verb(verb, *given(verb, plain), *more, "--lens", tmp_path / "lens.json")
        assert without.exit_code == 2
        assert "without a lens" in without.output
    assert not (tmp_path / "own").exists()
    same = run_verb("read", *given("read", tmp_path / "cal"), "--lens", tmp_path / "lens.json")
    assert same.exit_code == 0, same.output


def test_a_lens_of_another_camera_is_refused_before_work(record_spots, tmp_path):
    lens = Lens("kannala-brandt", (300.0, 300.0), (320, 240), (0.05, 0, 0, 0), (480, 640), 0.7)
    plan = CalibrationPlan(("x_mm",), "pca-ridge", size_px=(24, 32), lens=lens)
    with pytest.raises(ImageError, match=r"64x48 px.*640x480 px"):
        calibrate(record_spots("run", 16), plan, tmp_path / "cal")
    assert not (tmp_path / "cal").exists()
