import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from typer.testing import CliRunner

from palpate.cli import app
from palpate.optics import encode_srgb

LOADS_N = np.array([0.0, 40.0, 90.0, 130.0, 150.0, 200.0, 260.0])
C = 8e-11


def fit_c(*words, status=0):
    result = CliRunner().invoke(app, ["optics", "fit-c", *map(str, words)])
    assert result.exit_code == status, result.output + result.stderr
    return result


@pytest.fixture
def photos(tmp_path):
    """A strip 20 mm wide in sodium light, one grey level a load, and its labels."""
    folder = tmp_path / "photos"
    folder.mkdir()
    for load in LOADS_N:
        light = 0.01 + 0.7 * np.sin(np.pi * C * load / (20e-3 * 589.3e-9)) ** 2
        Image.fromarray(encode_srgb(np.full((30, 40), light))).save(folder / f"{load:g}.png")
    table = pd.DataFrame({"image_file": [f"{load:g}.png" for load in LOADS_N], "load_N": LOADS_N})
    table.to_csv(folder / "labels.csv", index=False)
    return folder


def asked(photos, **options):
    words = {"--labels": "labels.csv", "--roi-px": "4,4,24,20", "--strip-mm": "20x6"} | options
    return [photos, *(word for pair in words.items() if pair[1] is not None for word in pair)]


def test_fit_c_prints_c_with_its_unit_and_its_interval(photos):
    said = fit_c(*asked(photos)).stdout
    assert "coefficient per pa: 8" in said
    assert "wavelength [m]: 5.893e-07" in said


def test_fit_c_states_where_its_search_ends(photos):
    assert "greatest order: 24" in fit_c(*asked(photos)).stdout
    assert "greatest order: 3" in fit_c(*asked(photos), "--max-order", "3").stdout


def test_json_holds_c_and_every_photograph(photos):
    got = json.loads(fit_c(*asked(photos), "--json").stdout)
    assert got["coefficient_per_pa"] == pytest.approx(C, rel=5e-3)  # 8-bit steps
    assert got["load_n"] == LOADS_N.tolist()


def test_a_disc_is_another_breadth(photos):
    strip = json.loads(fit_c(*asked(photos), "--json").stdout)["coefficient_per_pa"]
    words = asked(photos, **{"--strip-mm": None, "--disc-mm": "40"})
    disc = json.loads(fit_c(*words, "--json").stdout)["coefficient_per_pa"]
    assert disc / strip == pytest.approx(np.pi * 40 / 8 / 20)


def test_nothing_is_written_unless_asked_and_nothing_is_overwritten(photos, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    fit_c(*asked(photos))
    assert sorted(tmp_path.rglob("*")) == before
    figure = tmp_path / "fit.png"
    fit_c(*asked(photos), "--out", figure)
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "overwritten" in fit_c(*asked(photos), "--out", figure, status=2).stderr


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"--strip-mm": None}, "either --strip-mm"),
        ({"--disc-mm": "40"}, "either --strip-mm"),
        ({"--strip-mm": "20"}, "WIDTHxTHICKNESS"),
        ({"--strip-mm": "20x-6"}, "positive"),
        ({"--strip-mm": "nanx6"}, "positive"),
        ({"--lamp": "candle"}, "not line, led or tungsten"),
        ({"--tone": "log"}, "not srgb or linear"),
        ({"--roi-px": "1,2,3"}, "not 4 whole numbers"),
        ({"--roi-px": "30,4,24,20"}, "leaves 0.png"),
        ({"--wavelength-nm": "0.5893"}, "wavelength"),
        ({"--labels": "other.csv"}, "not there"),
        ({"--load-column": "image_file"}, "carries no unit"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(photos, options, said):
    err = fit_c(*asked(photos, **options), status=2).stderr
    assert said in err
    assert len(err.splitlines()) == 1
