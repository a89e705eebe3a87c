"""A calibration folder is believed only when all of its parts belong together."""

import json
import os
import shutil

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import CertificateError, Frame, ImageError
from palpate.core.files import sha256_of
from palpate.core.reading import ReasonCode
from palpate.estimators import Estimator, read_card
from palpate.estimators.card_ground import card_id


@pytest.fixture
def calibration(calibrate_spots, tmp_path, changes_untried):
    plan = {"targets": ("x_mm", "height_mm"), "split": "group:press", "size_px": (24, 32)}
    return calibrate_spots(tmp_path / "cal", 16, model="pca-ridge", **plan)


def reseal(folder, change) -> None:
    """Change a card and give it the id that belongs to the change, as a forger would."""
    card = json.loads((folder / "card.json").read_text())
    change(card)
    card["id"] = card_id(card)
    (folder / "card.json").write_text(json.dumps(card))


def test_a_reading_carries_all_that_makes_it_trustworthy(calibration) -> None:
    run, folder = calibration
    estimator = Estimator.open(folder)
    readings = estimator.read(run.frame(1), estimator.zero(run.frame(0).image))
    reading, truth = readings["x_mm"], run.labels["x_mm"][1]
    assert reading.unit == "mm"
    assert reading.low < reading.value < reading.high
    assert reading.value == pytest.approx(truth, abs=0.5)
    assert reading.calibrated_range == pytest.approx((-2, 2), abs=0.2)
    assert (readings["x"].unit, readings["x"].value) == ("m", pytest.approx(1e-3 * reading.value))
    assert (reading.valid, reading.why) == (True, "")
    assert reading.drift is not None
    assert not reading.drift.drifted
    assert reading.calibration == read_card(folder).id
    assert reading.column == "x_mm"
    assert reading.time_s == run.times_s[1]


def test_an_image_is_read_as_its_frame_is(calibration) -> None:
    run, folder = calibration
    estimator, frame = Estimator.open(folder), run.frame(1)
    assert estimator.read(frame.image)["x_mm"].value == estimator.read(frame)["x_mm"].value
    with refused("image-channels", ImageError, match="RGB"):
        estimator.read(np.zeros((48, 64, 4), np.uint8))


@pytest.mark.parametrize("coloured", [True, False])
def test_a_grey_image_is_not_read_as_one_of_colour(calibration, coloured: bool) -> None:
    run, folder = calibration
    opened = Estimator.open(folder)
    image, parts = run.frame(1).image, (opened.card, opened._session, opened._novelty)
    estimator = Estimator(folder, *parts, coloured=coloured)
    tinted = np.stack([image, image, image], axis=-1)
    for grey in (image, tinted):
        reading = estimator.read(grey)["x_mm"]
        assert reading.valid is not coloured
        assert ("grey" in reading.why) is coloured
    tinted = tinted.copy()
    tinted[0, 0, 2] ^= 1
    assert estimator.read(tinted)["x_mm"].valid


def test_an_image_of_another_size_gives_no_value(calibration) -> None:
    run, folder = calibration
    readings = Estimator.open(folder).read(Frame(run.frame(1).image[:40]))
    for reading in readings.values():
        assert np.isnan(reading.value)
        assert not reading.valid
        assert reading.code == ReasonCode.IMAGE_SIZE
        assert "64x40" in reading.why
        assert "64x48" in reading.why


def test_a_strange_image_is_flagged(calibration) -> None:
    run, folder = calibration
    estimator, image = Estimator.open(folder), run.frame(1).image
    for bad in (image // 8, np.full_like(image, 255), np.roll(image, 6, axis=1)):
        reading = estimator.read(Frame(bad))["x_mm"]
        assert not reading.valid
        assert reading.code == ReasonCode.OUT_OF_DISTRIBUTION


def test_a_value_beyond_the_calibrated_range_is_flagged(calibration) -> None:
    run, folder = calibration
    reseal(folder, lambda card: card["targets"][1].update(least=5.0, greatest=6.0))
    reading = Estimator.open(folder).read(run.frame(1))["height_mm"]
    assert not reading.valid
    assert reading.code == ReasonCode.OUTSIDE_RANGE
    assert reading.calibrated_range == (5.0, 6.0)


@pytest.mark.usefixtures("changes_untried")
def test_a_differential_calibration_asks_for_its_reference(calibrate_spots, tmp_path) -> None:
    plan = {"targets": ("x_mm",), "split": "group:press", "size_px": (12, 16), "delta": True}
    run, folder = calibrate_spots(tmp_path / "cal", 10, model="pca-ridge", **plan)
    estimator = Estimator.open(folder)
    with pytest.raises(ImageError, match="--reference FRAME"):
        estimator.read(run.frame(1))
    assert estimator.read(run.frame(1), estimator.zero(run.frame(0).image))["x_mm"].valid


def test_a_card_that_is_none_is_refused(tmp_path) -> None:
    for content in (b"", b"{}", b"[1]", b"\xff\xfe", b'{"format": "palpate-calibration/1"', b'{"id": NaN}'):
        (tmp_path / "card.json").write_bytes(content)
        with refused("card-damaged", CertificateError):
            Estimator.open(tmp_path)


def test_a_missing_part_is_named(calibration) -> None:
    _, folder = calibration
    for part in ("guard.npz", "model.onnx", "card.json"):
        kept = (folder / part).rename(folder / "elsewhere")
        with pytest.raises(CertificateError, match=part):
            Estimator.open(folder)
        kept.rename(folder / part)


def test_a_part_that_is_a_link_is_refused(calibration, tmp_path) -> None:
    _, folder = calibration
    shutil.move(folder / "model.onnx", tmp_path / "elsewhere.onnx")
    (folder / "model.onnx").symlink_to(tmp_path / "elsewhere.onnx")
    with refused("file-missing", CertificateError):
        Estimator.open(folder)


def test_a_card_of_before_takes_a_value_whose_interval_reaches_into_the_range(calibration) -> None:
    """At both ends; at the end itself an interval is half inside, and no reason to doubt."""
    run, folder = calibration
    reading = Estimator.open(folder).read(run.frame(1))["x_mm"].in_unit("mm")
    value, half = reading.value, reading.high - reading.value
    reaching = {0.0: True, 0.9: True, 1.1: False}
    for beyond, valid in reaching.items():
        for least, greatest in (
            (value + beyond * half, value + 10 + beyond * half),
            (value - 10 - beyond * half, value - beyond * half),
        ):

            def narrowed(card, least=least, greatest=greatest) -> None:
                card["targets"][0] |= {"least": least, "greatest": greatest}
                card["targets"][0].pop("over_range", None)

            reseal(folder, narrowed)
            assert Estimator.open(folder).read(run.frame(1))["x_mm"].valid == valid, (beyond, least)


@pytest.mark.parametrize(
    "change", [{"coefficients": [0.0]}, {"least": 3.0, "greatest": 2.0}, {"column": "height_mm"}]
)
def test_targets_that_do_not_fit_are_refused(change, calibration) -> None:
    _, folder = calibration
    reseal(folder, lambda card: card["targets"][0].update(change))
    with refused("card-damaged", CertificateError):
        Estimator.open(folder)


@pytest.mark.parametrize("part", ["limits", "drift"])
def test_limits_of_a_guard_that_limit_nothing_are_refused(part, calibration) -> None:
    _, folder = calibration
    path = folder / "guard.npz"
    with np.load(path) as archive:
        parts = dict(archive)
    for values in (["a", "b"], [np.nan, 1.0], [np.inf, 1.0], [0.0, 1.0], [1.0]):
        np.savez(path, **parts | {part: np.array(values)})
        reseal(folder, lambda card: card["guard"].update(sha256=sha256_of(path)))
        with pytest.raises(CertificateError, match=r"guard\.npz.*guard"):
            Estimator.open(folder)


def test_a_part_outside_the_folder_cannot_be_named(calibration) -> None:
    _, folder = calibration
    reseal(folder, lambda card: card["model"].update(file="../model.onnx"))
    with pytest.raises(CertificateError, match=r"model\.file"):
        Estimator.open(folder)


def test_a_folder_that_is_no_calibration_is_refused(tmp_path) -> None:
    with pytest.raises(CertificateError, match="palpate calibrate"):
        Estimator.open(tmp_path)


def test_a_session_s_folder_is_answered_by_the_newest_calibration_within(calibration, tmp_path) -> None:
    for k, name in enumerate(("calibration-2", "calibration")):  # the one that was written last is meant
        shutil.copytree(calibration[1], tmp_path / "my-sensor" / name)
        os.utime(tmp_path / "my-sensor" / name / "card.json", (2e9 - k, 2e9 - k))
    with refused("card-missing", CertificateError, match="my-sensor.calibration-2"):
        Estimator.open(tmp_path / "my-sensor")
    Estimator.open(tmp_path / "my-sensor" / "calibration-2")
