"""Verbs of fringe orders by pixel."""

import csv
import json

import numpy as np
import pytest
import tifffile
from PIL import Image
from tests.fringe_fields import beam, colours, disc
from typer.testing import CliRunner

from palpate.cli import app
from palpate.optics.colour import encode_srgb

SHARE, _, FACE = disc()


def optics(*words, status=0):
    result = CliRunner().invoke(app, ["optics", *map(str, words)])
    assert result.exit_code == status, result.output + result.stderr
    return result


def save(path, light):
    Image.fromarray(encode_srgb(0.9 * light)).save(path)
    return path


@pytest.fixture
def pictures(tmp_path):
    """A disc at two loads, the mask, white light, a beam in bending, and a grey picture."""
    save(tmp_path / "a.png", colours(SHARE * 0.6, 0.01))
    save(tmp_path / "b.png", colours(SHARE * 1.0, 0.01, seed=1))
    save(tmp_path / "white.png", np.ones((90, 90, 3)))
    save(tmp_path / "beam.png", colours(beam(3.0, 300, 120), 0.01))
    Image.fromarray((FACE * 255).astype(np.uint8)).save(tmp_path / "mask.png")
    save(tmp_path / "grey.png", SHARE)
    return tmp_path


@pytest.mark.slow
def test_a_measured_table_maps_the_frames_and_all_of_it_is_written(pictures):
    table, out = pictures / "beam.csv", pictures / "orders"
    said = optics(
        "colour-table",
        pictures / "beam.png",
        "--line-px",
        "60,0,60,299",
        "--orders=-3,3",
        "--out",
        table,
        "--json",
    )
    assert json.loads(said.stdout)["greatest_order"] == pytest.approx(3.0, abs=0.02)
    frames = [pictures / "a.png", pictures / "b.png"]
    words = ["--calibration", table, "--mask", pictures / "mask.png", "--out", out, "--json"]
    lines = [json.loads(line) for line in optics("fringe-order", *frames, *words).stdout.splitlines()]
    assert [line["frame"] for line in lines] == ["a.png", "b.png"]
    assert all(line["told_share"] > 0.97 for line in lines)
    order, sigma = tifffile.imread(out / "order.tif"), tifffile.imread(out / "sigma.tif")
    for page, s, at_centre in zip(order, sigma, (0.6, 1.0), strict=True):
        told = np.isfinite(page)
        z = ((page - SHARE * at_centre) / s)[told]
        assert told.sum() > 0.97 * FACE.sum()
        assert not told[~FACE].any()
        assert 0.7 < 1.4826 * np.median(np.abs(z)) < 1.2
    kept = np.load(out / "000001.npz")
    np.testing.assert_array_equal(kept["order"][kept["why"] == 0], order[1][np.isfinite(order[1])])
    with (out / "frames.csv").open() as file:
        assert [row["frame"] for row in csv.DictReader(file)] == ["a.png", "b.png"]
    assert (out / "order.png").read_bytes().startswith(b"\x89PNG")
    assert "overwritten" in optics("fringe-order", *frames, *words, status=2).stderr
    assert "overwritten" in optics(
        "colour-table", pictures / "beam.png", "--disc-px", "60,150,100", "--centre-order", "1", "--out",
        table, status=2,
    ).stderr  # fmt: skip


def test_an_assumed_lamp_with_white_light_reads_a_frame_and_writes_nothing_unasked(pictures):
    before = sorted(pictures.rglob("*"))
    said = optics("fringe-order", pictures / "b.png", "--white", pictures / "white.png").stdout
    assert "frame b.png" in said
    assert "told share 0.9" in said
    assert sorted(pictures.rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--calibration", "neon"], "led, tungsten"),
        (["--tone", "log"], "srgb or linear"),
        (["--noise", "0"], "noise"),
        (["--white", "grey.png"], "grey"),
        (["--calibration", "missing.csv"], "not there"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(pictures, words, said):
    words = [pictures / word if word.endswith((".png", ".csv")) else word for word in words]
    err = optics("fringe-order", pictures / "a.png", *words, status=2).stderr
    assert said in err
    assert len(err.splitlines()) == 1
