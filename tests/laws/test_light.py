"""What the command costs before it does anything: what is loaded for a verb, and a help that can be read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from palpate.calibration import CalibrationPlan, calibrate
from palpate.cli import HEADINGS, app
from palpate.cli.verb_support import phases, take_output_options

NEVER_TO_SENSE = {
    "jaxtyping", "matplotlib", "mcap", "numba", "onnx", "pandas", "pyarrow", "rosbags", "scipy.stats",
    "sklearn", "torch",
}  # fmt: skip
MEANT_TO_LOAD = """
import sys
from palpate.cli import main

sys.argv[1:] = sys.argv[2:]
try:
    main()
except SystemExit as e:
    assert not e.code, e.code
print(*sys.modules, file=open(ASKED, "w"))
"""


def loaded_by(folder: Path, *words: object) -> set[str]:
    """The modules that a fresh interpreter holds after `palpate WORDS`."""
    asked = folder / "modules.txt"
    code = MEANT_TO_LOAD.replace("ASKED", repr(str(asked)))
    command = [sys.executable, "-c", code, "palpate", *map(str, words)]
    subprocess.run(command, cwd=folder, capture_output=True, check=True, timeout=300)
    return set(asked.read_text().split())


def test_sensing_one_image_loads_no_tables_no_training_and_no_plots(
    record_spots, tmp_path: Path, changes_untried
) -> None:
    run = record_spots("run", 10)
    calibrate(run, CalibrationPlan(("height_mm",), "pca-ridge", size_px=(6, 8)), tmp_path / "cal")
    cv2.imwrite(str(tmp_path / "frame.png"), run.frame(3).image)
    loaded = loaded_by(tmp_path, "read", tmp_path / "frame.png", "--with", tmp_path / "cal", "--timing")
    assert "onnxruntime" in loaded
    assert not NEVER_TO_SENSE & loaded


def test_the_version_is_said_before_numpy_is_loaded(tmp_path: Path) -> None:
    assert not {"numpy", "pydantic"} & loaded_by(tmp_path, "--version")


def test_one_verb_loads_no_other(tmp_path: Path) -> None:
    loaded = {name for name in loaded_by(tmp_path, "check", "--help") if name.startswith("palpate.cli.")}
    assert "palpate.cli.record.recording_verbs" in loaded
    others = ("record.rig_verbs", "calibrate.calibrate_verbs", "study.render_verbs")
    assert not {f"palpate.cli.{name}" for name in others} & loaded


def groups() -> list[tuple[str, ...]]:
    """The root and every verb that holds verbs."""
    root = get_command(app)
    return [(), *((name,) for name in root.commands if hasattr(root.commands[name], "commands"))]


@pytest.mark.parametrize("words", groups(), ids=" ".join)
def test_every_verb_s_first_sentence_stands_uncut_in_one_line_of_80_columns(words: tuple[str, ...]) -> None:
    shown = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "80"}).output
    group = get_command(app)
    for word in words:
        group = group.commands[word]
    assert max(map(len, shown.splitlines())) <= 80
    for name, verb in group.commands.items():
        if not verb.hidden:
            sentence = f"{' '.join(verb.help.split())} ".partition(". ")[0]
            rows = [line for line in shown.splitlines() if line.split()[:1] == [name]]
            assert any(row.split(maxsplit=1)[1].rstrip(".") == sentence.rstrip(".") for row in rows), name


def test_verbs_stand_under_headings() -> None:
    shown = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80"}).output
    assert [line[:-1] for line in shown.splitlines() if line[:1].isupper() and line.endswith(":")] == [
        "Options",
        *HEADINGS,
    ]
    assert "--install-completion" in shown


def test_in_a_pipe_each_phase_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    for words, lines in (([], ["recording", "pca-ridge: fold 1 of 5", "evaluating"]), (["--quiet"], [])):
        take_output_options(words)
        show = phases()
        for what in ("recording", "recording", "pca-ridge: fold 1 of 5: projecting", "evaluating"):
            show(what, 1, 2)
        assert capsys.readouterr().err.splitlines() == lines
