"""`palpate sensors`: what is known of sensors that people own, and a file for one's own."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from palpate.cli import app


def sensors(*words: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["sensors", *map(str, words)])
    return result.exit_code, result.output


def test_all_presets_are_listed_with_how_their_cameras_are_recognised() -> None:
    code, said = sensors()
    assert code == 0
    rows = {line.split()[0]: line for line in said.splitlines() if line}
    assert "2833:0209" in rows["digit"]
    assert "GelSight Mini" in rows["gelsight-mini"]
    found = json.loads(sensors("--json")[1])["sensors"]
    assert {preset["name"] for preset in found} <= set(rows)


def test_a_file_of_one_s_own_is_begun_checked_and_never_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    assert sensors("new", file)[0] == 0
    assert "A sensor of your own" in sensors(file)[1]
    code, said = sensors("new", file)
    assert (code, "exists" in said) == (2, True)
    file.write_text(file.read_text() + "colour = 1\n")
    assert "colour" in sensors(file)[1]


@pytest.mark.parametrize(("words", "says"), [(["gelsite"], "gelsight-mini"), (["no.toml"], "no.toml")])
def test_what_is_not_there_is_said_in_one_line(words: list[str], says: str) -> None:
    code, said = sensors(*words)
    assert code == 2
    assert says in said
    assert len(said.strip().splitlines()) == 1
