"""Every verb, as typed: what it prints, what it makes, and how it refuses."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from tests.small_figures import saved_blank
from typer.testing import CliRunner

from palpate.cli import app


def palpate(*words: object, status: int = 0):
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == status, result.output
    return result


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Where images, their run and its calibration are made once; a test has copies."""
    return tmp_path_factory.mktemp("made")


@pytest.fixture
def taps(made_taps, tmp_path) -> Path:
    return Path(shutil.copytree(made_taps, tmp_path / "taps"))


@pytest.fixture(scope="module")
def made_taps(made) -> Path:
    """A folder of labelled images: a spot whose place is the label."""
    folder, rng = made / "taps", np.random.default_rng(0)
    (folder / "images").mkdir(parents=True)
    rows, columns = np.mgrid[0:40, 0:40]
    table = []
    for i in range(60):
        x = rng.uniform(-1, 1)
        image = 40 + 150 * np.exp(-((columns - 20 - 10 * x) ** 2 + (rows - 20) ** 2) / 20)
        name = f"tap_{i:02d}.png"
        cv2.imwrite(str(folder / "images" / name), (image + rng.normal(0, 2, image.shape)).astype(np.uint8))
        table.append({"image_file": name, "x_mm": x, "tap": i // 4, "remark": "fine", "nothing": 1.5})
    pd.DataFrame(table).to_csv(folder / "labels.csv", index=False)
    return folder


@pytest.mark.slow
def test_circular_targets_and_vectors_are_asked_for_in_one_line(run, tmp_path) -> None:
    words = ("calibrate", run, "--targets", "x_mm", "--split", "random", "--size", "16x16", "--quiet")
    said = palpate(*words, "--circular", "x_mm=4", "--out", tmp_path / "cal").stdout
    assert "calibration" in said
    card = json.loads((tmp_path / "cal" / "card.json").read_text())
    assert card["targets"][0]["circular"]["period"] == 4
    sensed = palpate("read", run, "--with", tmp_path / "cal", "--json").stdout.splitlines()[0]
    assert json.loads(sensed)["readings"]["x_mm"]["period"] == 4
    for option, value, message in (
        ("--circular", "x_mm=round", "--circular 'x_mm=round' is not COLUMN or COLUMN=PERIOD"),
        ("--circular", "x_mm", "has no period of its own"),
        ("--vector", "place", "--vector 'place' is not NAME=COLUMN,COLUMN"),
        ("--circular", "x_mm=4,x_mm=4", "--circular names 'x_mm' twice"),
        ("--circular", "x_mm=4, x_mm", "--circular names 'x_mm' twice"),
        ("--vector", "place=x_mm", "two components or more"),
        ("--vector", "=x_mm,y_mm", "--vector '=x_mm,y_mm' is not NAME=COLUMN,COLUMN"),
        ("--instruments", str(tmp_path / "none.toml"), "is no file of instruments"),
    ):
        refused = palpate(*words, option, value, "--out", tmp_path / "no", status=2)
        assert message in " ".join(refused.output.split())


@pytest.fixture
def run(made_run, taps, tmp_path) -> Path:
    return Path(shutil.copytree(made_run, tmp_path / "run"))


@pytest.fixture(scope="module")
def made_run(made_taps, made) -> Path:
    labels = ("--labels", "labels.csv", "--image-column", "image_file")
    palpate("import", "images", made_taps, made / "run", *labels)
    return made / "run"


@pytest.fixture
def calibration(made_calibration, run, tmp_path) -> Path:
    return Path(shutil.copytree(made_calibration, tmp_path / "cal"))


@pytest.fixture(scope="module")
def made_calibration(made_run, made, changes_untried) -> Path:
    words = ("--targets", "x_mm", "--split", "group:tap", "--size", "12x12", "--model", "pca-ridge")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("matplotlib.figure.Figure.savefig", saved_blank)
        palpate("calibrate", made_run, *words, "--out", made / "cal")
    return made / "cal"


def test_a_folder_becomes_a_run_that_checks_sound(run) -> None:
    found = json.loads(palpate("check", run, "--json").output)
    assert found["frames"] == 60
    assert found["sound"]
    assert found["labels"]["x_mm"] == "mm"
    assert "sound" in palpate("check", run).output


def test_a_cut_run_fails_its_check_and_is_repaired_into_a_new_one(run, tmp_path) -> None:
    segment = next(run.glob("**/*frames.mcap"))
    segment.write_bytes(segment.read_bytes()[: segment.stat().st_size // 2])
    assert "damage" in palpate("check", run, status=1).output
    kept = json.loads(palpate("check", run, "--repair", tmp_path / "new", "--json").output)
    assert 0 < kept["frames"] < 60
    assert kept["lost"]
    palpate("check", tmp_path / "new")


def test_scores_are_written_in_the_stated_form(calibration, run, tmp_path) -> None:
    said = palpate("evaluate", calibration, run, "--out", tmp_path / "scores.json").output
    assert "say nothing about new presses" in said
    found = json.loads((tmp_path / "scores.json").read_text())
    assert {"unit", "n", "mae", "rmse", "r2", "coverage_90"} <= set(found["targets"]["x_mm"])
    palpate("evaluate", calibration, run, "--out", tmp_path / "scores.json", status=2)


def test_sensing_prints_one_object_a_line(calibration, taps) -> None:
    result = palpate("read", taps / "images", "--with", calibration, "--json", "--timing")
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert len(lines) == 60
    assert lines[0]["frame"] == "tap_00.png"
    assert lines[0]["readings"]["x_mm"]["unit"] == "mm"
    assert "95th percentile" in result.stderr
    assert (
        "inside the calibrated range"
        in palpate("read", taps / "images" / "tap_01.png", "--with", calibration).output
    )


def test_what_is_of_a_virtual_sensor_is_said_once_to_be_simulated(
    calibration, run, taps, tmp_path, figures_blank
) -> None:
    labels = ("--labels", "labels.csv", "--image-column", "image_file")
    virtual = ("--provenance", "simulated")
    palpate("import", "images", taps, tmp_path / "made", *labels, *virtual)
    learns = ("--targets", "x_mm", "--split", "group:tap", "--size", "12x12", "--model", "mean")
    palpate("calibrate", tmp_path / "made", *learns, "--out", tmp_path / "virtual")
    for cal, read, named in (
        (calibration, tmp_path / "made", "the run is"),
        (tmp_path / "virtual", run, "the calibration is"),
        (tmp_path / "virtual", tmp_path / "made", "the calibration and the run are"),
        (calibration, run, ""),
    ):
        told = f"simulated, not measured: {named} of a virtual sensor"
        sensed = palpate("read", read, "--with", cal).stdout
        found = json.loads(palpate("evaluate", cal, read, "--no-keep", "--quiet", "--json").stdout)
        assert sensed.count(told) == ("simulated" in sensed) == found["simulated"] == (named != "")
    assert palpate("evaluate", cal, read, "--no-keep", "--quiet").stdout.count("simulated") == 0
    lines = palpate("read", run, "--with", tmp_path / "virtual", "--json").stdout.splitlines()
    assert all(json.loads(line)["simulated"] for line in lines)
    sensed = palpate("read", taps / "images", "--with", tmp_path / "virtual").stdout
    assert "the calibration is of a virtual" in sensed


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["calibrate", "RUN", "--targets", "y_mm", "--out", "OUT"], "y_mm"),
        (["calibrate", "RUN", "--targets", "remark", "--out", "OUT"], "remark"),
        (["calibrate", "RUN", "--targets", "nothing", "--out", "OUT"], "nothing"),
        (["calibrate", "RUN", "--targets", "x_mm", "--model", "oracle", "--out", "OUT"], "kernel-ridge"),
        (["calibrate", "RUN", "--targets", "x_mm", "--split", "by luck", "--out", "OUT"], "by luck"),
        (
            [
                "calibrate",
                "RUN",
                "--targets",
                "x_mm",
                "--split",
                "group:tap",
                "--folds",
                "99",
                "--out",
                "OUT",
            ],
            "15",
        ),
        (["calibrate", "RUN", "--targets", "x_mm", "--crop", "0,0,80,80", "--out", "OUT"], "80x80"),
        (["calibrate", "RUN", "--targets", "x_mm", "--size", "24", "--out", "OUT"], "--size"),
        (["calibrate", "RUN", "--targets", "x_mm", "--option", "layers", "--out", "OUT"], "NAME=VALUE"),
        (["calibrate", "RUN", "--targets", "x_mm", "--option", "layers=3", "--out", "OUT"], "components"),
        (["calibrate", "OUT", "--targets", "x_mm", "--out", "OUT2"], "OUT"),
        (["check", "OUT"], "OUT"),
        (["read", "RUN", "--with", "RUN"], "palpate calibrate"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(words, says, run, tmp_path) -> None:
    places = {"RUN": str(run), "OUT": str(tmp_path / "OUT"), "OUT2": str(tmp_path / "OUT2")}
    result = palpate(*(places.get(word, word) for word in words), status=2)
    assert says in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "OUT").exists()


def test_a_format_takes_its_own_options_only(taps, tmp_path) -> None:
    run = tmp_path / "new"
    for words, said in (
        (("movie", taps, run), "images, palm, press"),
        (("palm", taps, run, "--labels", "labels.csv"), "No such option: --labels"),
        (("press", taps / "press.avi", run), "Missing option '--force'"),
    ):
        assert said in " ".join(palpate("import", *words, status=2).output.split())
        assert not run.exists()
