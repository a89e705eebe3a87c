"""The report's specimens from the command line: what each class keeps alike to which cue."""

import json
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from palpate.cli import app
from palpate.mechanics.half_space.hertz import Body

MODULI = ("--moduli-kpa", "800,500,300,150,100")
WORDS = ("pairs", "specimens", *MODULI, "--finger", "100:15")


def palpate(*words: object) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.slow
def test_each_class_is_told_with_both_cues_and_how_far_they_are_apart(tmp_path: Path) -> None:
    ended = palpate(*WORDS, "--force-n", 2, "--figure", tmp_path / "classes.png", "--json")
    assert ended.exit_code == 0, ended.stderr
    classes = json.loads(ended.stdout)["classes"]
    assert list(classes) == ["CL1", "CL2", "CL3"]
    plate = Body(100e3 / 0.75, 15e-3)
    assert_allclose([one["area_mm2"] for one in classes["CL2"]["specimens"]], 1e6 * plate.area_m2(2.0))
    assert classes["CL2"]["area_spread"] < 1e-9 < classes["CL2"]["displacement_spread"]
    outer, inner = classes["CL3"]["mirrored"]
    assert outer["names"] == ["CL3 0 % on 45 %", "CL3 45 % on 0 %"]
    assert_allclose([outer["displacement_ratio"], outer["area_ratio"]], [1.0987, 1.3274], atol=1e-4)
    assert 1 < inner["displacement_ratio"] < outer["displacement_ratio"]
    assert_allclose(classes["CL3"]["series_spread"], 11.25 / (20 / 3) - 1)
    assert "mirrored" not in classes["CL1"]
    assert (tmp_path / "classes.png").stat().st_size > 20_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("CL4", *MODULI, "--finger", "100:15"), "CL1, CL2, CL3, and all"),
        (("CL1", "--moduli-kpa", "800,500", "--finger", "100:15"), "2 moduli; give five"),
        (("CL1", "--moduli-kpa", "soft", "--finger", "100:15"), "no numbers"),
        (("CL1", *MODULI, "--finger", "100"), "MODULUS_KPA:RADIUS_MM"),
        (("CL1", *MODULI, "--finger", "100:15", "--poisson", "0.5"), "below 0.5"),
        (("CL1", *MODULI, "--finger", "100:15", "--force-n", "9"), "CL1 0 %: a press to 9 N"),
        (("CL2", *MODULI, "--finger", "100:15", "--force-n", "nan"), "at most 5 N"),
    ],
)
def test_what_is_no_specimen_is_refused(words: tuple[str, ...], said: str) -> None:
    ended = palpate("pairs", "specimens", *words)
    assert ended.exit_code != 0
    assert said in " ".join(ended.stderr.split())
