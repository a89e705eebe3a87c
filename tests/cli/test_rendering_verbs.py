"""Softness rendered now, from the command line: on virtual devices, on one's own, and what is refused."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palpate.cli import app

LINE = """
name = "line"
[force_area]
area_mm2 = [0.0, 130.0]
force_N = [0.0, 4.0]
[force_displacement]
displacement_mm = [0.0, 6.0]
force_N = [0.0, 4.0]
"""
OWN = """
name = "failing {name}"
[display]
kind = "tests.softness.own_bench:FailingDisplay"
fault = "its wire is off"
[arm]
kind = "tests.softness.own_bench:arm"
[limits]
late_ms = 20
"""


def palpate(*words: object) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words])


def kept_up(said: str, *words: object, out: Path | None = None) -> Any:
    """What came of it in the first of three tries that other work of the machine did not end too soon."""
    for _ in range(3):
        if out is not None:
            out.unlink(missing_ok=True)
        ended = palpate(*words)
        if said in ended.stdout + ended.stderr:
            break
    return ended


@pytest.fixture
def line(tmp_path: Path) -> Path:
    path = tmp_path / "line.toml"
    path.write_text(LINE)
    return path


def test_a_rendering_says_how_it_went_and_keeps_its_samples(line: Path, tmp_path: Path) -> None:
    table = tmp_path / "felt.csv"
    words = ("display", "run", "--object", line, "--seconds", 2.5, "--frequency-hz", 2, "--samples", table)
    ended = kept_up("its 2.5 s were over", *words, "--json", out=table)
    assert ended.exit_code == 0, ended.stderr
    answer = json.loads(ended.stdout)
    assert answer["simulated"]
    assert not answer["ended_by_fault"]
    assert answer["ended"] == "its 2.5 s were over"
    assert answer["peak_N"] == pytest.approx(1.0, rel=0.1)
    assert answer["force_area_rms_of_peak"] < 0.06
    assert 1500 < answer["periods"] < 2700
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == answer["samples"]
    assert float(rows[-1]["time_s"]) == pytest.approx(2.5, abs=0.3)
    felt = max(rows, key=lambda row: float(row["force_N"]))
    assert float(felt["displacement_mm"]) == pytest.approx(1.5 * float(felt["force_N"]), rel=0.1)
    again = palpate(*words)
    assert again.exit_code == 2
    assert "overwritten" in again.stderr


def test_a_fault_of_a_device_ends_it_with_its_name_and_an_error(line: Path, tmp_path: Path) -> None:
    bench = tmp_path / "bench.toml"
    bench.write_text(OWN.format(name=tmp_path.name))
    words = ("display", "run", "--object", line, "--bench", bench, "--seconds", 20)
    ended = kept_up("its wire is off", *words)
    assert ended.exit_code == 2
    assert "its wire is off" in ended.stderr
    assert re.search(r"simulated: no\n", ended.stdout)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--mode", "CM4"), "CM1, CM2, CM3"),
        (("--seconds", 0), "more than 0 s"),
        (("--seconds", "nan"), "more than 0 s"),
        (("--frequency-hz", 50), "0.1 to 5 Hz"),
        (("--peak-n", 9), "from 0 to 4 N"),
        (("--bench", "nowhere.toml"), "no bench's file"),
    ],
)
def test_a_rendering_that_cannot_be_is_refused(line: Path, words: tuple[object, ...], said: str) -> None:
    ended = palpate("display", "run", "--object", line, *words)
    assert ended.exit_code == 2
    assert said in ended.stderr


def test_nobody_is_stopped_where_nobody_renders(tmp_path: Path) -> None:
    ended = palpate("display", "stop", "--name", f"nobody {tmp_path.name}")
    assert ended.exit_code == 2
    assert "[nothing-renders]" in ended.stderr
