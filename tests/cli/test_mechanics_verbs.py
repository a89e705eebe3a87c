import json

import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.mechanics.half_space import sneddon


def mechanics(*words, status=0):
    result = CliRunner().invoke(app, ["mechanics", *words])
    assert result.exit_code == status, result.output + result.stderr
    return result


def found(*words):
    return json.loads(mechanics(*words, "--json").stdout)


SKIN = ("--modulus-kpa", "300", "--poisson", "0.49")
BALL = ("--radius-mm", "5", *SKIN)


def test_hertz_gives_the_golden_numbers():
    got = found("hertz", *BALL, "--depth-mm", "1")
    assert got["force_N"] == pytest.approx(1.1770328, rel=5e-8)
    assert got["contact_radius_mm"] == pytest.approx(2.2360680, rel=5e-8)
    assert got["peak_pressure_kPa"] == pytest.approx(112.39835, rel=5e-8)
    assert got["greatest_shear_kPa"] == pytest.approx(0.26842 * 112.39835, rel=3e-5)
    back = found("hertz", *BALL, "--force-n", str(got["force_N"]))
    assert back["depth_mm"] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(
    "words",
    [
        ["sphere", *BALL],
        ["punch", *BALL],
        ["cone", "--half-angle-deg", "70", *SKIN],
    ],
)
def test_a_depth_and_its_force_lead_back_to_each_other(words):
    there = found(*words, "--depth-mm", "0.5")
    back = found(*words, "--force-n", str(there["force_N"]))
    assert back["depth_mm"] == pytest.approx(0.5, rel=1e-9)
    assert back["contact_radius_mm"] == pytest.approx(there["contact_radius_mm"], rel=1e-9)


def test_the_verbs_say_what_the_laws_say():
    got = found("sphere", *BALL, "--depth-mm", "3")
    assert got["force_N"] == pytest.approx(sneddon.sphere_force_from_depth(3e-3, 5e-3, 0.3e6, 0.49))
    got = found("layer", *BALL, "--thickness-mm", "10", "--depth-mm", "0.5")
    assert got["half_space_force_N"] == pytest.approx(
        sneddon.sphere_force_from_depth(5e-4, 5e-3, 0.3e6, 0.49)
    )
    assert got["half_space_force_N"] < got["force_N"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["hooke", *BALL, "--depth-mm", "1"], "hertz, sphere, punch, cone, layer"),
        (["hertz", *BALL], "either --depth-mm or --force-n"),
        (["hertz", *BALL, "--depth-mm", "1", "--force-n", "1"], "not both"),
        (["hertz", *BALL, "--depth-mm", "2"], "a/R <= 0.5"),
        (["hertz", *BALL, "--depth-mm", "nan"], "outside 0 to"),
        (["hertz", "--radius-mm", "-5", *SKIN, "--depth-mm", "1"], "radius"),
        (["sphere", *BALL, "--depth-mm", "14"], "a/R <= 0.99"),
        (["punch", *BALL, "--depth-mm", "3"], "d/a <= 0.5"),
        (["cone", "--half-angle-deg", "95", *SKIN, "--depth-mm", "1"], "half-angle"),
        (["layer", *BALL, "--thickness-mm", "4", "--depth-mm", "1"], "fifth of the layer"),
        (
            ["layer", *BALL, "--thickness-mm", "9", "--depth-mm", "1", "--base", "glued"],
            "'bonded' or 'sliding'",
        ),
    ],
)
def test_what_cannot_be_worked_out_is_said_in_one_line(words, says):
    result = mechanics(*words, status=2)
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
