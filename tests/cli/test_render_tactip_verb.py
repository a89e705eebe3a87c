import json

import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.recordings import Run
from palpate.recordings.exchange.press_folder import press_folder

FAST = ("--speed-mm-s", "20", "--trials", "1")


def render(*words, status=0):
    result = CliRunner().invoke(app, ["render", "tactip", *words])
    assert result.exit_code == status, result.output + result.stderr
    return result


def test_a_press_is_made_and_said_to_be_virtual(tmp_path) -> None:
    out = tmp_path / "presses"
    said = json.loads(render(str(out), "--specimen", "S1=7.6", "--json", "--quiet", *FAST).stdout)
    assert (said["virtual"], said["presses"], said["stiffness_N_per_mm"]) == (True, 1, {"S1": 7.6})
    (one,) = press_folder(out).specimens
    assert one.stiffness_n_m == pytest.approx(7600)
    assert len(one.presses) == 1


def test_a_rigid_plate_other_pins_and_runs_in_json(tmp_path) -> None:
    out = tmp_path / "presses"
    words = (str(out), "--rigid", "--preset", "331", "--runs", "--json", "--quiet", *FAST)
    said = json.loads(render(*words).stdout)
    assert said == {
        "out": str(out),
        "virtual": True,
        "presses": 1,
        "runs": 1,
        "tilt_deg": 0.0,
        "stiffness_N_per_mm": {"rigid": "inf"},
        "model": {"rigid": "finite strain, without friction"},
    }
    assert len(Run.open(out / "rigid" / "01")) > 3
    assert json.loads((out / "virtual.json").read_text())["spec"]["pins"]["rings"] == 10


def test_a_rigid_plate_at_30_degrees_is_pressed_at_finite_strain(tmp_path) -> None:
    said = json.loads(
        render(str(tmp_path / "a"), "--rigid", "--tilt-deg", "30", "--json", "--quiet", *FAST).stdout
    )
    assert said["model"] == {"rigid": "finite strain, without friction"}
    truth = json.loads((tmp_path / "a" / "virtual.json").read_text())
    assert truth["specimens"]["rigid"]["model"] == said["model"]["rigid"]
    assert truth["spec"]["friction"] == 0


def test_a_linear_rig_is_chosen_by_name(tmp_path) -> None:
    out = tmp_path / "presses"
    render(str(out), "--rigid", "--rig", "linear", "--quiet", *FAST)
    assert json.loads((out / "virtual.json").read_text())["rig"]["name"] == "linear"
    said = render(str(tmp_path / "b"), "--rigid", "--rig", "belt", *FAST, status=2).stderr
    assert "there are ideal, linear" in said
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--specimen", "S1"], "NAME=STIFFNESS in N/mm"),
        (["--specimen", "S1=soft"], "NAME=STIFFNESS in N/mm"),
        (["--specimen", "S1=1.1", "--specimen", "S1=2"], "given twice"),
        (["--specimen", "=1.1"], "cannot name a folder"),
        (["--specimen", "../S1=7.6"], "cannot name a folder"),
        (["--specimen", "S1=0.1"], "down to 0.942 N/mm"),
        (["--specimen", "S1=nan"], "down to 0.942 N/mm"),
        (["--specimen", "b=sphere:R_mm=15"], "20 mm and larger"),
        (["--specimen", "b=sphere:R_mm=-15"], "finite number above 0"),
        (["--specimen", "b=layer:h_mm=2"], "needs E_MPa"),
        (["--specimen", "b=layer:h_mm=20,E_MPa=0.1"], "1 to 8 mm"),
        (["--specimen", "b=sphere:R_mm=30", "--tip", "even"], "flat cylinders only"),
        (["--specimen", "b=sphere:R_mm=30", "--tilt-deg", "20"], "head-on"),
        (["--tilt-deg", "60"], "0 to 50 degrees"),
        (["--tilt-deg", "-1"], "0 to 50 degrees"),
        (["--tilt-deg", "nan"], "0 to 50 degrees"),
        (["--preset", "128"], "127 and 331"),
        (["--tip", "hard"], "no tip 'hard'"),
    ],
)
def test_what_cannot_be_pressed_is_said_in_one_line_and_nothing_is_written(words, says, tmp_path) -> None:
    result = render(str(tmp_path / "out"), *words, *FAST, status=2)
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_there_is_refused_before_anything_is_solved(tmp_path) -> None:
    result = render(str(tmp_path), "--tilt-deg", "45", status=2)
    assert "exists" in result.stderr
