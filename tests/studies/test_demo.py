"""The demo: exact physics, recorded, calibrated by location, and honest about what the view cannot tell."""

import subprocess
import sys

import pytest

from palpate.estimators import read_card
from palpate.recordings import Run
from palpate.studies import run_demo


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return run_demo(tmp_path_factory.mktemp("demo") / "out", locations=(40, 10))


def test_what_the_view_shows_is_told_and_the_rest_is_not(result) -> None:
    for scores in result.scores.values():
        for name in ("x_mm", "depth_mm", "force_N"):
            # The mean is beaten twofold on places never seen; 40 places are few, so no more is asked here.
            assert scores[name].mae < scores[name].mean_mae / 2
        assert scores["y_mm"].says_nothing
    assert "y_mm: no better than always saying the mean" in result.text()


def test_locations_are_held_out_whole(result) -> None:
    for model in result.scores:
        card = read_card(result.folder / f"cal-{model}")
        assert card.split.kind == "group:location"
        assert card.split.groups == 40
        assert card.split.clean


def test_the_page_says_which_target_cannot_be_told(result) -> None:
    for page in result.reports.values():
        assert "do not tell y" in page.read_text()


def test_the_demo_s_recordings_are_sound_and_say_they_are_virtual(result) -> None:
    run = Run.open(result.folder / "run")
    assert run.damage == ()
    assert "virtual" in run.manifest.origin
    assert len(run.force()) == len(run)


def test_a_dark_frame_is_not_believed(result) -> None:
    assert any("made dark" in line and "unlike those calibrated on" in line for line in result.sensed)


def test_the_demo_loads_no_torch(tmp_path) -> None:
    code = (
        "import sys; from pathlib import Path; from palpate.studies import demo; "
        "demo.record(Path(sys.argv[1]) / 'run', demo.Protocol(), 6, seed=0); "
        "from palpate.calibration import Plan; from palpate.recordings import Run; "
        "demo.certify(Run.open(Path(sys.argv[1]) / 'run'), Plan(('x_mm',)), Path(sys.argv[1]) / 'cal'); "
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False).returncode == 0
