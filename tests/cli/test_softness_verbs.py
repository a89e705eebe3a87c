"""Pairs that one cue cannot tell apart, and the envelope of a display, from the command line."""

import json
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from palpate.cli import app

FOAM = """
name = "foam ball"
[force_area]
N_per_cm2 = [0.554, 0.33, 1.4]
until_cm2 = 1.33
[force_displacement]
N_per_cm = [0.64, 42.0]
until_cm = 0.08
"""


def palpate(*words: object) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words])


def answer(*words: object) -> Any:
    ended = palpate(*words, "--json")
    assert ended.exit_code == 0, ended.stderr
    return json.loads(ended.stdout)


def test_the_reports_pairs_are_found_and_stop_being_pairs_under_another_finger() -> None:
    arm = answer("pairs", "kinesthetic", "1000:2.5", 150, "--finger", "100:15")
    skin = answer("pairs", "cutaneous", "200:30", 20, "--finger", "100:15")
    assert_allclose([arm["other_radius_mm"], skin["other_radius_mm"]], [7.3199, 3.0], atol=1e-4)
    assert_allclose(arm["force_ratio_at_equal_displacement"], 1.0)
    assert_allclose(skin["force_ratio_at_equal_area"], 1.0)
    assert arm["force_ratio_at_equal_area"] < 0.5
    under = answer("pairs", "compare", "1000:2.5", "150:7.3199", "--finger", "20:15")
    assert_allclose(1 / under["force_ratio_at_equal_displacement"], 0.7336, atol=5e-4)
    under = answer("pairs", "compare", "200:30", "20:3", "--finger", "20:15")
    assert_allclose(1 / under["force_ratio_at_equal_area"], 0.4545, atol=1e-4)


def test_a_contact_too_wide_for_hertz_is_told(tmp_path: Path, figures_small) -> None:
    words = ("pairs", "compare", "1000:2.5", "150:7.32", "--finger", "100:15")
    assert not answer(*words, "--figure", tmp_path / "p.png")["in_hertz_range"]
    assert (tmp_path / "p.png").stat().st_size > 1_000
    assert answer(*words, "--force-n", 0.01)["in_hertz_range"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("kinesthetic", "1000", 150, "--finger", "100:15"), "MODULUS_KPA:RADIUS_MM"),
        (("kinesthetic", "1000:-1", 150, "--finger", "100:15"), "above 0"),
        (("kinesthetic", "1000:2.5", 0, "--finger", "100:15"), "above 0 kPa"),
        (("thermal", "20:30", 20, "--finger", "100:15"), "kinesthetic, cutaneous, compare, specimens"),
        (("compare", "20:30", "--finger", "100:15"), "two objects"),
        (("cutaneous", "20:30", "soft", "--finger", "100:15"), "no number of kPa"),
        (("compare", "20:30", "20:30"), "Missing option '--finger'"),
        (("cutaneous", "20:30", 2000, "--finger", "100:15"), "hollow"),
        (("compare", "20:30", "20:30", "--finger", "100:15", "--force-n", "nan"), "above 0 N"),
        (("compare", "20:30", "20:30", "--finger", "100:15", "--poisson", 0.6), "0 to 0.5"),
    ],
)
def test_objects_that_cannot_be_are_refused(words: tuple[object, ...], said: str) -> None:
    ended = palpate("pairs", *words)
    assert ended.exit_code == 2
    assert said in ended.stderr
    assert ended.stdout == ""


def test_the_envelope_says_what_is_rendered_and_why_the_rest_is_not(tmp_path: Path, figures_small) -> None:
    file = tmp_path / "foam.toml"
    file.write_text(FOAM)
    found = answer("display", "envelope", "--object", file, "--figure", tmp_path / "foam.png")
    assert [one["limit"] for one in found["spans"]] == ["onset", None]
    assert_allclose(found["spans"][1]["to_mm2"], 132.73, atol=0.01)
    assert_allclose(found["spans"][1]["force_N"], 3.459, atol=2e-3)
    assert (tmp_path / "foam.png").stat().st_size > 1_000
    weak = answer("display", "envelope", "--object", file, "--pressure-kpa", 24)
    assert {"pressure", None} <= {one["limit"] for one in weak["spans"]}
    for wrong, said in ((("--mode", "CM2"), "plate"), (("--pressure-kpa", 1), "more than 1 kPa")):
        ended = palpate("display", "envelope", "--object", file, *wrong)
        assert ended.exit_code == 2
        assert said in ended.stderr
    again = palpate("display", "envelope", "--object", file, "--figure", tmp_path / "foam.png")
    assert again.exit_code == 2
    assert "foam.png" in again.stderr


LINE = """
name = "line"
[force_area]
area_mm2 = [0.0, 20, 130]
force_N = [0.0, 0.6, 3.9]
[force_displacement]
displacement_mm = [0.0, 6]
force_N = [0.0, 3.9]
"""


def test_a_simulated_press_says_how_well_both_cues_were_kept(tmp_path: Path, figures_small) -> None:
    file = tmp_path / "line.toml"
    file.write_text(LINE)
    press = ("display", "simulate", "--object", file, "--peak-n", 3, "--presses", 2)
    found = answer(*press, "--figure", tmp_path / "felt.png")
    assert found["force_area_rms_of_peak"]["all"] < 0.02
    assert found["force_displacement_rms_of_peak"]["all"] < 0.02
    assert_allclose(found["peak_N"], 3.0, rtol=0.02)
    assert (tmp_path / "felt.png").stat().st_size > 1_000
    other = answer(*press, "--mode", "CM3", "--servo", "pid", "--frequency-hz", 3)
    assert other["force_displacement_rms_of_peak"] is None
    assert other["force_area_rms_of_peak"]["all"] > 1.05 * found["force_area_rms_of_peak"]["all"]
    plate = answer(*press, "--mode", "CM2")
    assert plate["force_area_rms_of_peak"] is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--peak-n", 4), "0 to 3.9 N"),
        (("--peak-n", "nan"), "0 to 3.9 N"),
        (("--mode", "CM4"), "CM1, CM2, CM3"),
        (("--servo", "none"), "flow and pid"),
        (("--frequency-hz", 50), "0.1 to 20 Hz"),
        (("--figure", "line.toml"), "exists"),
    ],
)
def test_a_press_that_cannot_be_simulated_is_refused(
    words: tuple[object, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "line.toml"
    file.write_text(LINE)
    ended = palpate("display", "simulate", "--object", file, *words)
    assert ended.exit_code == 2
    assert said in ended.stderr
