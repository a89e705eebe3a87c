"""Laws of the verb that reads touch on a patterned skin."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import palpate
from palpate.cli import app
from palpate.core import Pose
from palpate.recordings.exchange import image_files

SENSOR = palpate.sensor("nusense")


def save(path, depth=0.0, seed=0, light=1.0):
    press = SENSOR.press(SENSOR.probe("round"), Pose(5e-3, -3e-3, depth))
    image = SENSOR.render(press, np.random.default_rng(seed)).image
    path.write_bytes(image_files.encode(np.uint8(light * image)).tobytes())
    return path


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shear")
    (folder / "frames").mkdir()
    save(folder / "reference.png")
    for i, depth in enumerate((0.0, 0.6e-3, 1.2e-3, 0.0)):
        save(folder / "frames" / f"{i}.png", depth, i + 1)
    save(folder / "frames" / "4.png", 1e-3, 9, light=0.1)
    (folder / "frames" / "5.png").write_bytes(b"no image")
    return folder


def run(*words):
    sensor = () if "--sensor" in words else ("--sensor", "nusense")
    return CliRunner().invoke(app, ["read", *map(str, words), *sensor])


def test_one_json_line_a_frame_with_the_place_where_it_is(place):
    done = run(place / "frames", "--reference", place / "reference.png", "--json")
    assert done.exit_code == 0, done.output
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["frame"] for line in lines] == [f"{i}.png" for i in range(6)]
    assert [len(line["contacts"]) for line in lines] == [0, 1, 1, 0, 0, 0]
    x, y = (lines[2]["readings"][f"{axis}_m"] for axis in "xy")
    assert x["value"] == pytest.approx(5e-3, abs=0.1e-3)
    assert y["value"] == pytest.approx(-3e-3, abs=0.1e-3)
    assert x["low"] < x["value"] < x["high"]
    assert lines[0]["readings"]["x_m"]["value"] is None
    assert lines[0]["readings"]["x_m"]["why"] == "no contact"
    assert [line["read"] for line in lines] == [True] * 4 + [False] * 2
    assert "contrast" in lines[4]["why"]
    assert not any(
        "_N" in key for line in lines for key in line["readings"]
    )  # no newtons without calibration


def test_fields_and_page_are_written_and_nothing_is_overwritten(place, tmp_path, figures_blank):
    fields, page = tmp_path / "fields", tmp_path / "page.html"
    words = (place / "frames", "--reference", place / "reference.png", "--fields", fields, "--html", page)
    done = run(*words)
    assert done.exit_code == 0, done.output
    assert [p.name for p in sorted(fields.iterdir())] == [f"{i:06d}.npz" for i in range(4)]
    with np.load(fields / "000002.npz", allow_pickle=False) as kept:
        at = np.nanargmax(np.hypot(kept["displacement_x"], kept["displacement_y"]))
        x, y = kept["x"].ravel()[at], kept["y"].ravel()[at]
        assert np.hypot(x - 5e-3, y + 3e-3) < 4e-3  # the ring is near the contact
        assert str(kept["unit"]) == "m"
    text = page.read_text(encoding="utf-8")
    assert "2 of 6 frames are touched" in text
    assert "2 cannot be read" in text
    assert "The strongest press: frame 2.png" in text
    again = run(*words)
    assert again.exit_code == 2
    assert "exists" in again.output


def test_bad_input_is_one_line_of_error(place, tmp_path):
    reference, frames = place / "reference.png", place / "frames"
    touched = save(tmp_path / "touched.png", 1e-3)
    lens = tmp_path / "lens.json"
    palpate.core.Lens("pinhole", (333.0, 333.0), (319.5, 239.5), (0.0,) * 5, (480, 640)).write(lens)
    for words, what in (
        ((frames, "--reference", touched), "touched or torn"),
        ((frames, "--reference", reference, "--lens", lens), "another lens"),
        ((frames, "--reference", reference, "--sensor", "palm"), "patterned skin"),
        ((frames, "--reference", tmp_path / "none.png"), "not there"),
        ((tmp_path / "nothing", "--reference", reference), "not there"),
    ):
        done = run(*words)
        assert done.exit_code == 2, done.output
        assert what in done.output
        assert len(done.stderr.strip().splitlines()) == 1
