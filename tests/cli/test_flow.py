"""`palpate flow`, as typed: what it prints, what it makes, and how it refuses."""

import json
import re
import shlex

import numpy as np
import pandas as pd
import pytest
import tifffile
from typer.testing import CliRunner

from palpate.cli import app


def palpate(*words: object, status: int = 0):
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == status, result.output
    return result


pytestmark = pytest.mark.usefixtures("figures_blank")


@pytest.fixture
def press(tmp_path):
    """Twelve frames of a pattern that moves by a fifth of a pixel a frame to the right."""
    y, x = np.indices((96, 128)).astype(float)
    path = tmp_path / "press.tif"
    with tifffile.TiffWriter(path) as writer:
        for k in range(12):
            moved = x - 0.2 * k
            level = 127 + 40 * np.sin(0.4 * moved + 0.1 * y) + 40 * np.sin(0.3 * y - 0.15 * moved)
            writer.write(np.rint(level).astype(np.uint8), contiguous=False)
    return path


def test_the_example_in_the_help_runs(press, monkeypatch) -> None:
    monkeypatch.chdir(press.parent)
    said = palpate("flow", "--help").stdout
    example = re.search(r"Example: palpate (flow press\.tif --out \S+)", said)
    assert example is not None
    palpate(*shlex.split(example[1]))
    assert {path.name for path in (press.parent / "flow").iterdir()} == {"flow.csv", "flow.png"}


def test_the_table_has_one_row_for_every_frame_but_the_first_and_json_says_what_was_done(
    press, tmp_path
) -> None:
    said = palpate("flow", press, "--out", tmp_path / "out").stdout
    assert "steps: 11" in said
    table = pd.read_csv(tmp_path / "out/flow.csv")
    assert list(table) == [
        "frame", "speed_px", "divergence_per_frame", "border_flux_per_frame", "accumulated_divergence",
        "accumulated_border_flux",
    ]  # fmt: skip
    assert table["frame"].tolist() == list(range(1, 12))
    assert table["speed_px"].between(0.15, 0.21).all()  # of the 0.2 px, smoothness takes a little
    got = json.loads(palpate("flow", press, "--out", tmp_path / "again", "--json").stdout)
    assert (got["method"], got["steps"], got["from_first"]) == ("horn-schunck", 11, False)
    assert got["mean_speed_px"] == pytest.approx(table["speed_px"].mean())
    assert 1 <= got["fastest_frame"] <= 11


def test_opencvs_method_finds_the_motion_since_the_first_frame(press, tmp_path) -> None:
    palpate("flow", press, "--out", tmp_path / "out", "--method", "dis", "--from-first")
    speeds = pd.read_csv(tmp_path / "out/flow.csv")["speed_px"]
    assert speeds.iloc[-1] == pytest.approx(2.2, rel=0.35)  # rough on so small an image


def test_the_divergence_is_of_the_region_that_is_given(press, tmp_path) -> None:
    words = ("flow", press, "--json", "--region", "10,20,60,40", "--out", tmp_path / "out")
    got = json.loads(palpate(*words).stdout)
    assert got["region"] == {"kind": "given", "pixels": 2400, "box_px": [10, 20, 60, 40]}
    assert got["accumulated_divergence"] != got["accumulated_border_flux"]


def test_a_region_of_the_whole_image_has_no_divergence_but_the_border_flux(press, tmp_path) -> None:
    words = ("flow", press, "--region", "0,0,128,96", "--out")
    said = palpate(*words, tmp_path / "out").stdout
    assert "--region" in said
    got = json.loads(palpate(*words, tmp_path / "again", "--json").stdout)
    assert got["region"]["kind"] == "image"
    assert got["accumulated_divergence"] == got["accumulated_border_flux"]


@pytest.mark.parametrize("region", ["100,20,60,40", "0,0,0,5", "-1,0,5,5", "1,2"])
def test_a_region_outside_the_images_is_refused(press, tmp_path, region) -> None:
    palpate("flow", press, "--out", tmp_path / "out", f"--region={region}", status=2)
    assert not (tmp_path / "out").exists()


def test_fields_are_kept_on_request(press, tmp_path) -> None:
    palpate("flow", press, "--out", tmp_path / "out", "--fields", "--region", "0,0,128,96")
    fields = np.load(tmp_path / "out/fields.npy")
    assert fields.shape == (11, 2, 96, 128)
    assert fields.dtype == np.float32
    speeds = pd.read_csv(tmp_path / "out/flow.csv")["speed_px"]
    assert np.hypot(fields[:, 0], fields[:, 1]).mean(axis=(1, 2)) == pytest.approx(speeds, rel=1e-5)


def test_one_page_is_no_sequence(tmp_path) -> None:
    tifffile.imwrite(tmp_path / "one.tif", np.zeros((20, 30), np.uint8))
    said = palpate("flow", tmp_path / "one.tif", "--out", tmp_path / "out", status=2)
    assert "two frames" in said.stderr
    assert not (tmp_path / "out").exists()


def test_nothing_is_written_over(press, tmp_path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "flow.csv").write_text("mine")
    said = palpate("flow", press, "--out", out, status=2)
    assert "nothing is ever overwritten" in said.stderr
    assert (out / "flow.csv").read_text() == "mine"
    assert [path.name for path in out.iterdir()] == ["flow.csv"]
