"""Experiments from the command line: a page's five cups, what is refused, and sittings that are killed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.psychophysics import read_judgements
from palpate.psychophysics.experiments import (
    Enrolment,
    Sitting,
    enrol,
    make_experiment,
    noisy_answers,
    read_design,
)

REPOSITORY = Path(__file__).resolve().parents[2]


def palpate(*words: object, typed: str = "") -> Any:
    return CliRunner().invoke(app, [str(word) for word in words], input=typed)


def child(*words: object, **pipes: Any) -> subprocess.Popen[str]:
    """A process of its own that finds this package."""
    paths = os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)])
    environment = os.environ | {"PYTHONPATH": paths}
    command = [sys.executable, "-m", *map(str, words)]
    return subprocess.Popen(command, env=environment, text=True, **pipes)


def test_five_cups_are_judged_paused_gone_on_with_and_exported(tmp_path: Path) -> None:
    folder = tmp_path / "jelly"
    made = palpate("experiment", "new", folder, "--seed", 7, "--json")
    assert json.loads(made.stdout)["judgements_of_the_first"] == 13
    first = palpate(
        "experiment", "run", folder, "--participant", "P01", typed="yes\n" + "\n1\n" * 5 + "\nq\n"
    )
    assert first.exit_code == 0, first.stderr
    assert "5 judgements are kept; paused" in first.stdout
    assert "key.csv" in first.stderr
    again = palpate(
        "experiment", "run", folder, "--participant", "P01", "--json", typed="\n2\n" * 7 + "\n54321\n"
    )
    answer = json.loads(again.stdout)
    assert answer["complete"]
    after = palpate("experiment", "run", folder, "--participant", "P01").stdout
    assert f"palpate experiment analyze {folder} --out" in after
    assert palpate("experiment", "analyze", folder).exit_code == 0
    assert answer["judgements"] == 13
    assert not answer["simulated"]
    done = palpate("experiment", "export", folder, tmp_path / "bids", "--json")
    assert json.loads(done.stdout)["complete"] == ["P01"]
    assert palpate("experiment", "export", folder, tmp_path / "bids").exit_code == 2


def test_a_closed_input_says_so_and_keeps_what_was_given(tmp_path: Path) -> None:
    folder = tmp_path / "jelly"
    palpate("experiment", "new", folder)
    closed = palpate("experiment", "run", folder, "--participant", "P01")
    assert closed.exit_code == 2
    assert "nobody can consent" in closed.stderr
    assert not (folder / "sub-P01").exists()
    closed = palpate("experiment", "run", folder, "--participant", "P01", typed="y\n\n1\n\n2\n")
    assert closed.exit_code == 2
    assert "2 judgements are kept" in closed.stdout
    assert "input is closed" in closed.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("run", "{}", "--participant", "../P01"), "letters, digits"),
        (("run", "{}", "--participant", "Anna Schmidt"), "no person's name"),
        (("run", "{}", "--participant", "Anna"), "a code has a digit"),
        (("run", "{}", "--participant", "sub-P01"), "give P01"),
        (("run", "{}/none", "--participant", "P01"), "has no experiment.toml"),
        (("run", "{}", "--participant", "P01", "--answers", "{}/none.txt"), "check the path"),
        (("run", "{}", "--participant", "P01", "--noise", "-1"), "0 or more"),
        (("new", "{}"), "nothing is ever overwritten"),
        (("new", "{}x", "--preset", "jam"), "there are jelly, bianchi-2010, threshold"),
        (("new", "{}x", "--preset", "bianchi-2010", "--moduli-kpa", "1,2"), "five above 0"),
        (("new", "{}x", "--preset", "bianchi-2010", "--moduli-kpa", "1,2,3,4,5"), "have to fall"),
        (("new", "{}x", "--preset", "bianchi-2010", "--moduli-kpa", "soft"), "no numbers"),
        (("new", "{}x", "--seed", "-1"), "palpate: seed -1; 0 to"),
        (("export", "{}", "{}-bids"), "no participant yet"),
    ],
)
def test_bad_input_is_one_line_and_makes_nothing(words, said: str, tmp_path: Path) -> None:
    folder = tmp_path / "jelly"
    palpate("experiment", "new", folder, "--seed", 1)
    before = sorted(tmp_path.rglob("*"))
    refused = palpate("experiment", *(word.replace("{}", str(folder)) for word in words), typed="yes\n")
    assert refused.exit_code == 2, refused.stdout
    assert said in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_answers_of_a_file_and_a_simulated_observer_are_a_rehearsal(tmp_path: Path) -> None:
    folder = tmp_path / "jelly"
    palpate("experiment", "new", folder, "--seed", 1)
    script = tmp_path / "answers.txt"
    script.write_text("1\n2\n" * 6 + "1 2 3 4 4\n1 2 3 4 5\n")
    scripted = palpate("experiment", "run", folder, "--participant", "R01", "--answers", script, "--json")
    assert json.loads(scripted.stdout) | {"group": ""} == {
        "participant": "R01", "group": "", "complete": True, "judgements": 13, "paused": None,
        "simulated": True,
    }  # fmt: skip
    observed = palpate("experiment", "run", folder, "--participant", "R02", "--noise", 0.3)
    assert "simulated: no measurement" in observed.stdout
    assert f"palpate experiment analyze {folder / 'rehearsal'} --out" in observed.stdout
    assert len(read_judgements(folder / "rehearsal")) == 26
    assert not list(folder.glob("sub-*"))
    short = tmp_path / "short.txt"
    short.write_text("1\n")
    ended = palpate("experiment", "run", folder, "--participant", "R03", "--answers", short)
    assert ended.exit_code == 2
    assert "1 judgements are kept" in ended.stdout


def test_a_person_is_never_asked_about_a_display_that_nobody_can_feel(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    palpate("experiment", "new", folder, "--preset", "threshold", "--seed", 1)
    refused = palpate("experiment", "run", folder, "--participant", "P01", typed="yes\n")
    assert refused.exit_code == 2
    assert "--bench" in refused.stderr
    assert "first" not in refused.stderr, "no trial was begun"
    assert (folder / "sub-P01" / "responses.csv").read_text().count("\n") == 1


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_kill_9_loses_at_most_the_judgement_being_given(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    design = make_experiment(tmp_path / "killed" / "study", "bianchi-2010", 4)
    whole = make_experiment(tmp_path / "whole" / "study", "bianchi-2010", 4)
    for one in (design, whole):
        enrol(one, "P01", Enrolment(True))
    assert "direct" in (design.folder / "sub-P01" / "participant.json").read_text()
    table = design.folder / "sub-P01" / "responses.csv"
    answer = noisy_answers(whole, "P01", 20.0)
    with Sitting(whole, "P01", lambda: "2026-01-01T10:00:00+00:00") as sitting:
        while sitting.next is not None:
            sitting.take(answer(sitting.next), 0.0)
    for _ in range(2):
        before = table.read_bytes()
        with child("tests.psychophysics.run_until_killed", design.folder, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            for _ in range(rng.randint(3, 9)):
                said = int(process.stdout.readline())
            time.sleep(rng.random() * 0.02)
            process.send_signal(signal.SIGKILL)
        assert process.returncode == -signal.SIGKILL
        after = table.read_bytes()
        assert after.startswith(before), "what was kept stays"
        assert after.count(b"\n") - 1 >= said
    answer = noisy_answers(design, "P01", 20.0)
    with Sitting(read_design(design.folder), "P01", lambda: "") as sitting:
        while sitting.next is not None:
            sitting.take(answer(sitting.next), 0.0)
    kept = [(one.key, one.presented, one.answer) for one in read_judgements(table)]
    meant = [(one.key, one.presented, one.answer) for one in read_judgements(whole.folder)]
    assert kept == meant


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("full", ["stdout", pytest.param("stderr", marks=pytest.mark.slow)])
def test_a_terminal_that_takes_nothing_more_ends_it_by_one_line_and_answers_are_kept(
    full: str, tmp_path: Path
) -> None:
    folder = tmp_path / "jelly"
    palpate("experiment", "new", folder, "--seed", 1)
    palpate("experiment", "run", folder, "--participant", "P01", typed="yes\n\n1\n\n2\nq\n")
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with (
        Path("/dev/full").open("w") as taken,
        child(
            "palpate.cli", "experiment", "run", folder, "--participant", "P01", **pipes | {full: taken}
        ) as process,
    ):
        told, complained = process.communicate("\n1\nq\n", timeout=60)
    assert process.returncode == 2
    assert "Traceback" not in f"{told}{complained}"
    assert "Exception ignored" not in f"{told}{complained}"
    if full == "stdout":
        assert "palpate: nothing more can be printed: " in complained.splitlines()[-1]
    kept = 3 if full == "stdout" else 2
    assert len(read_judgements(folder)) == kept
    assert palpate("experiment", "run", folder, "--participant", "P01", typed="q\n").exit_code == 0


def test_ctrl_c_leaves_all_whole_and_says_how_to_go_on(tmp_path: Path) -> None:
    folder = tmp_path / "jelly"
    palpate("experiment", "new", folder, "--seed", 1)
    with child(
        "palpate.cli", "experiment", "run", folder, "--participant", "P01",
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        process.stdin.write("yes\n\n1\n\n2\n")
        process.stdin.flush()
        table = folder / "sub-P01" / "responses.csv"
        end_s = time.monotonic() + 60
        while not table.is_file() or table.read_text().count("\n") < 3:
            assert time.monotonic() < end_s
            time.sleep(0.05)
        second = palpate("experiment", "run", folder, "--participant", "P01")
        assert second.exit_code == 2
        assert "is being run in another terminal" in second.stderr
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "paused; 2 judgements are kept, and the same command goes on" in told
    assert "Traceback" not in told
    assert len(read_judgements(folder)) == 2
    assert "KeyboardInterrupt" in (folder / "sub-P01" / "sittings.csv").read_text()
