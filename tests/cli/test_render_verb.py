import json
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import Pose
from palpate.recordings.exchange import image_files
from palpate.sensors import palm
from palpate.sensors.palm import probe_stress
from palpate.sensors.palm.membrane_faults import Wear, worn

FACTS = {
    "force_N",
    "contact_radius_mm",
    "peak_pressure_Pa",
    "fringe_order_max",
    "youngs_modulus_Pa",
    "thickness_mm",
    "model",
}


def render(*words, out, status=0):
    result = CliRunner().invoke(app, ["render", "palm", *words, "--preset", "debug", "--out", str(out)])
    assert result.exit_code == status, result.output + result.stderr
    return result


def picture(path):
    return image_files.decode(np.frombuffer(path.read_bytes(), np.uint8))


@pytest.fixture
def frame(tmp_path):
    return tmp_path / "frame.png"


PLACED = ("--depth-mm", "3", "--x-mm", "5", "--y-mm", "-2", "--indenter", "sphere:10")


def test_a_probe_in_the_air_is_drawn_and_presses_nothing(frame):
    said = json.loads(render("--depth-mm", "-1", "--json", out=frame).stdout)
    assert (said["force_N"], said["peak_pressure_Pa"], said["fringe_order_max"]) == (0, 0, 0)
    bare = frame.with_name("bare.png")
    render("--depth-mm", "0", out=bare)
    assert (picture(frame) != picture(bare)).any()


@pytest.mark.parametrize(("x_mm", "exact"), [(5, False), (14, True)])  # the fast way is off near the rim
def test_a_press_is_drawn_by_its_seed_and_its_numbers_are_said(frame, x_mm, exact):
    said = json.loads(render(*PLACED, "--x-mm", str(x_mm), "--seed", "1", "--json", out=frame).stdout)
    assert said.keys() >= FACTS
    spec = palm.debug()
    contact = palm.press(spec, Pose(1e-3 * x_mm, -2e-3, 3e-3))
    assert said["force_N"] == pytest.approx(contact.force_n)
    assert said["contact_radius_mm"] == pytest.approx(contact.radius_m * 1e3)
    assert said["out"] == str(frame)
    drawn, other = (
        palm.render(contact, spec, np.random.default_rng(seed), exact=exact).image for seed in (1, 0)
    )
    np.testing.assert_array_equal(picture(frame), drawn)
    assert picture(frame).shape == (108, 192, 3)
    assert (drawn != other).any()
    assert abs(drawn.astype(int).mean() - other.astype(int).mean()) < 1


def test_nothing_is_overwritten_nor_computed_in_vain(frame, monkeypatch):
    frame.write_bytes(b"mine")
    monkeypatch.setattr(palm, "press", None)
    assert "exists" in render("--depth-mm", "-1", out=frame, status=2).stderr
    assert frame.read_bytes() == b"mine"


@pytest.mark.slow
def test_a_ball_that_no_table_holds_is_pressed_into_layers(frame, monkeypatch):
    monkeypatch.setattr(probe_stress, "PLANES", 12)  # with the next line, three times as fast
    monkeypatch.setattr(import_module("palpate.sensors.palm.palm_press"), "CELLS", 80)
    said = json.loads(render("--depth-mm", "0.5", "--indenter", "sphere:6", "--json", out=frame).stdout)
    assert "linear elastic layers" in said["model"]
    assert said["fringe_order_max"] > 0.1
    assert picture(frame).shape == (108, 192, 3)


def test_a_smaller_ball_with_a_table_of_its_own_is_pressed_deep(frame):
    said = json.loads(render("--depth-mm", "2.5", "--indenter", "sphere:5", "--json", out=frame).stdout)
    assert "finite-strain table" in said["model"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "changed"),
    [
        (["--presses", "20000"], {"wear": worn(20_000)}),
        (["--haze", "0.1", "--scratches", "7", "--yellowing", "0.2"], {"wear": Wear(0.1, 7, yellowing=0.2)}),
        (["--presses", "20000", "--haze", "0"], {"wear": replace(worn(20_000), haze=0.0)}),
        (["--ambient", "0.05", "--lamp-mired", "40"], {"ambient": 0.05, "lamp_mired": 40.0}),
        (["--no-probe-in-mirror"], {"probe_in_mirror": False}),
        (["--opaque-underside"], {"opaque_underside": True}),
    ],
)
def test_wear_and_light_are_drawn_as_asked_for(words, changed, frame):
    render(*PLACED, *words, out=frame)
    spec = replace(palm.debug(), **changed)
    contact = palm.press(spec, Pose(5e-3, -2e-3, 3e-3))
    drawn = palm.render(contact, spec, np.random.default_rng(0)).image
    np.testing.assert_array_equal(picture(frame), drawn)
    new = palm.render(contact, palm.debug(), np.random.default_rng(0)).image
    assert (drawn != new).any()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--depth-mm", "1", "--indenter", "pyramid:10"], "sphere:DIAMETER_MM"),
        (["--depth-mm", "1", "--indenter", "punch:-6"], "positive, in mm"),
        (["--depth-mm", "6.5"], "0 to 6 mm"),
        (["--depth-mm", "-inf"], "0 to 6 mm"),
        (["--depth-mm", "nan"], "0 to 6 mm"),
        (["--depth-mm", "2", "--indenter", "punch:7"], "0 to 1.5 mm"),
        (["--depth-mm", "1", "--x-mm", "28"], "rim at 28.5 mm"),
        (["--depth-mm", "1", "--y-mm", "inf"], "not finite"),
        (["--depth-mm", "1", "--haze", "1.5"], "0 to 1"),
        (["--depth-mm", "1", "--scratches", "-1"], "0 to 1000"),
        (["--depth-mm", "1", "--yellowing", "nan"], "absorbance"),
        (["--depth-mm", "1", "--presses", "-1"], "0 or more"),
        (["--depth-mm", "1", "--ambient", "-0.1"], "0 to 10"),
        (["--depth-mm", "1", "--lateral-n", "1"], "X,Y"),
        (["--depth-mm", "1", "--lateral-n", "left,0"], "X,Y"),
        (["--depth-mm", "1", "--lateral-n", "nan,0"], "not finite"),
        (["--depth-mm", "1", "--lateral-n", "5,0"], "1.57346 N"),
    ],
)
def test_what_cannot_be_drawn_is_said_in_one_line_and_nothing_is_written(words, says, frame):
    result = render(*words, out=frame, status=2)
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
    assert not frame.exists()
