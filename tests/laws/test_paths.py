"""Whatever takes a path takes it as text and as a Path, and does the same."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused

import palpate
from palpate import CalibrationPlan, Estimator, Manifest, Run, RunWriter
from palpate.recordings import PackedSet, check, export_folder, pack, read_labels, repair
from palpate.recordings.preparation import Preparation

PLAN = CalibrationPlan(("x_mm",), model="mean", split="group:press", size_px=(12, 16))


@pytest.fixture(params=[str, Path], ids=["text", "Path"])
def at(request, tmp_path) -> Callable:
    """Makes what a caller gives of a name in the test's folder."""
    return lambda *names: request.param(str(tmp_path.joinpath(*names)))


@pytest.mark.cases(1)
def test_a_calibration_is_made_opened_and_reported_on(
    at, record_spots, changes_untried, figures_blank
) -> None:
    run = record_spots("run", 10)
    palpate.certify(run, PLAN, at("certified"))
    palpate.calibrate(run, PLAN, at("cal"))
    palpate.write_report(at("cal"), at("cal.html"))
    estimator = Estimator.open(at("cal"))
    assert len(list(palpate.sense(estimator, palpate.open_source(at("run"))))) == len(run)
    assert palpate.evaluate(estimator, Run.open(at("run")))["frames_scored"] == 50
    assert Path(at("cal.html")).is_file()


def test_images_are_read_imported_sensed_and_exported(at, record_spots) -> None:
    run = record_spots("run", 10)
    export_folder(run, at("folder"))
    assert len(read_labels(at("folder", "labels.csv"))) == len(run)
    palpate.import_images(
        at("folder"), at("again"), labels=at("folder", "labels.csv"), image_column="frame_file"
    )
    np.testing.assert_array_equal(
        palpate.read_image(at("folder", "images", "000001.png")), Run.open(at("again")).frame(1).image
    )
    assert len(palpate.open_source(at("folder", "images"))) == len(run)
    assert len(palpate.open_source(at("folder", "images", "000001.png"))) == 1


def test_runs_are_written_resumed_checked_repaired_and_packed(at) -> None:
    with RunWriter.create(at("run"), Manifest.new(sensor="one")) as writer:
        writer.frame(np.zeros((4, 6), np.uint8))
    with RunWriter.resume(at("run")) as writer:
        writer.frame(np.zeros((4, 6), np.uint8))
    assert check(at("run")).frames == repair(at("run"), at("repaired")).frames == 2
    pack(Run.open(at("run")), at("packed"), Preparation(None, (2, 3), 1))
    assert len(PackedSet.open(at("packed"))) == 2
    assert Manifest.read(at("run")).sensor == "one"


def test_what_is_no_source_is_refused_alike(at) -> None:
    with refused("no-images", palpate.PalpateError):
        palpate.open_source(at())
