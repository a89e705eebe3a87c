"""An experiment's analysis: what was put in comes out, and what is lacking is counted and said."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.psychophysics.responses import write_responses
from tests.refusals import refused
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import InputError
from palpate.psychophysics import Condition, Judgement, Presentation, Stimulus, Task, write_stimuli
from palpate.psychophysics.analysis import analyse_experiment

LEVELS = (240.0, 170.0, 120.0, 80.0, 50.0)
STIMULI = {f"SS{i + 1}": Stimulus(f"SS{i + 1}", kpa, -1, "kPa") for i, kpa in enumerate(LEVELS)}
NAMES = tuple(STIMULI)
NOISE_KPA = {Condition.INTEGRATED: 22.0, Condition.KINESTHETIC: 110.0, Condition.CUTANEOUS: 45.0}


def simulated(people: int = 10, seed: int = 0, repeats: int = 6, noise=NOISE_KPA) -> list[Judgement]:
    """Answers of people who perceive levels with Gaussian noise, in pairs with SS3 and in rankings."""
    rng, found = np.random.default_rng(seed), []
    for person in range(people):
        for condition, sd in noise.items():
            head = (f"P{person + 1:02d}", condition, Presentation.DIRECT)
            for block in range(1, repeats + 1):
                for trial, other in enumerate(("SS1", "SS2", "SS4", "SS5"), start=1):
                    felt = {n: STIMULI[n].level + sd * rng.standard_normal() for n in ("SS3", other)}
                    soft = min(felt, key=felt.__getitem__)
                    found.append(Judgement(*head, Task.PAIR, block, trial, ("SS3", other), (soft,)))
            for block in range(1, 4):
                felt = {n: STIMULI[n].level + sd * rng.standard_normal() for n in NAMES}
                order = tuple(sorted(NAMES, key=felt.__getitem__, reverse=True))
                found.append(Judgement(*head, Task.RANK, block, 1, NAMES, order))
    return found


@pytest.fixture(scope="module")
def found():
    return analyse_experiment(simulated(), STIMULI)


def test_accuracy_is_counted_and_conditions_that_differ_are_found(found) -> None:
    by = {(one.task, one.setting): one for one in found.accuracies}
    pairs = by[Task.PAIR, "direct I"]
    assert (pairs.n, pairs.participants) == (240, 10)
    assert pairs.clusters[0] <= pairs.wilson[0] < pairs.share < pairs.wilson[1] <= pairs.clusters[1]
    assert by[Task.RANK, "direct I"].share > by[Task.RANK, "direct C"].share > by[Task.RANK, "direct K"].share
    for comparison in found.comparisons:
        first = comparison.shares[0]
        assert (first.first, first.second) == ("direct I", "direct K")
        assert first.value < 0
        assert first.holm_p < 0.05
    assert found.comparisons[0].mixed is not None
    assert found.comparisons[1].mixed is None


def test_thresholds_come_back_in_the_level_s_unit_and_the_spread_is_the_noise(found) -> None:
    for one, sd in zip(found.thresholds, NOISE_KPA.values(), strict=True):
        assert one.standard == "SS3"
        assert one.pse[1] < 120.0 < one.pse[2]
        jnd = 0.6745 * np.sqrt(2) * sd
        assert one.fit.spread.low < jnd < one.fit.spread.high
        assert one.fit.deviance_p > 0.01
        assert one.levels.tolist() == [50.0, 80.0, 170.0, 240.0]
        assert one.given[0] > one.given[-1]  # a greater modulus is called softer less often


def test_a_participant_whose_point_of_equality_is_beyond_the_levels_is_counted_and_said(found) -> None:
    assert all((one.own_bounded, one.participants) == (10, 10) for one in found.thresholds[::2])
    beyond = [
        replace(one, answer=("SS3",)) if (one.participant, one.task) == ("P02", Task.PAIR) else one
        for one in simulated(4)
    ]  # to P02 the standard is always softer
    said = analyse_experiment(beyond, STIMULI)
    one = said.thresholds[0]
    assert (one.own_bounded, one.participants) == (3, 4)
    assert any("I: 3" in line for line in said.caveats)
    without = analyse_experiment([one for one in simulated(4) if one.participant != "P02"], STIMULI)
    assert one.own_pse[0] == pytest.approx(without.thresholds[0].own_pse[0], rel=0.05)
    assert not any("answers bound" in line for line in without.caveats if "direct I" in line)


def test_the_wrong_sign_of_softness_makes_all_of_it_worse_than_chance() -> None:
    turned = {name: replace(one, softer=1) for name, one in STIMULI.items()}
    found = analyse_experiment(simulated(4), turned)
    assert all(one.share < 0.5 for one in found.accuracies)
    assert all(one.tau < 0 for one in found.rankings)
    assert any("falling" in one.fit.notes for one in found.thresholds)


def test_missing_answers_are_counted_by_participant_and_weigh_as_they_are() -> None:
    judgements = [
        one for one in simulated(4) if (one.participant, one.condition, one.block) != ("P02", "K", 2)
    ]
    judgements = [one for one in judgements if (one.participant, one.condition) != ("P03", "C")]
    found = analyse_experiment(judgements, STIMULI, unanswered=["row 3: participant P01 gave no answer"])
    text = " ".join(found.caveats)
    for words in (
        "1 rows have no answer",
        "direct K, pair: not balanced, 4 answers fewer",
        "P02 lacks 4",
        "direct K, rank: not balanced, 1 answers fewer",
        "direct C, pair: not met by P03",
    ):
        assert words in text
    met = {(one.first, one.second): one.participants for one in found.comparisons[0].shares}
    assert met["direct I", "direct C"] == 3


def test_one_participant_all_right_and_all_wrong_are_answered_with_bounds() -> None:
    alone = analyse_experiment(simulated(1), STIMULI)
    assert alone.comparisons == ()
    assert all(one.clusters is None for one in alone.accuracies)
    assert any("one participant" in one for one in alone.caveats)
    certain = dict.fromkeys(NOISE_KPA, 1e-6)
    right = analyse_experiment(simulated(2, noise=certain), STIMULI)
    for one in right.accuracies:
        assert one.share == 1.0
        assert one.wald == (1.0, 1.0)
        assert one.clusters[0] < one.wilson[0] < 1.0
    assert any("all 48" in one for one in right.caveats)
    assert all(not one.fit.spread.bounded[0] for one in right.thresholds)
    assert right.comparisons[0].marginal == ()
    wrong = {name: replace(one, softer=1) for name, one in STIMULI.items()}
    turned = analyse_experiment(simulated(2, noise=certain), wrong)
    assert any("all 48" in one for one in turned.caveats)
    json.dumps(turned.to_dict(), allow_nan=False)
    with refused("no-answers", InputError):
        analyse_experiment([], STIMULI, unanswered=["a", "b"])
    with refused("stimulus-unknown", InputError):
        analyse_experiment(simulated(1), {"SS1": STIMULI["SS1"]})


def palpate(*words: object, status: int = 0) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == status, result.output
    return " ".join(result.output.split())


@pytest.fixture
def study(tmp_path) -> Path:
    write_stimuli(tmp_path / "stimuli.csv", STIMULI.values())
    for person in ("P01", "P02", "P03"):
        (tmp_path / f"sub-{person}").mkdir()
        own = [one for one in simulated(3) if one.participant == person]
        write_responses(tmp_path / f"sub-{person}" / "responses.csv", own)
    return tmp_path


def test_the_verb_prints_answers_first_and_makes_one_page(study: Path, tmp_path, figures_blank) -> None:
    page = tmp_path / "study.html"
    said = palpate("experiment", "analyze", study, "--out", page)
    assert said.startswith("Pairs: ")
    assert "alone, pairs" in said
    assert "both cues" in said
    assert "as SS3" in said
    assert "both cues" in said
    assert not re.search(r"\[[-+.\d]+, [-+.\d]+\]", said), "an interval says of what share it is"
    assert said.count("[95 %: ") >= 9
    assert "below 0.25" in said
    text = page.read_text()
    assert text.index('<ul class="answers">') < text.index("Right answers")
    assert text.count("<img") == 3
    assert "both cues" in text
    assert "four answers" in text
    assert "these numbers" in text
    found = json.loads(CliRunner().invoke(app, ["experiment", "analyze", str(study), "--json"]).output)
    assert found["judgements"] == 3 * 3 * 27
    assert found["accuracies"][0]["share"] > 0.9
    assert "exists" in palpate("experiment", "analyze", study, "--out", page, status=2)


def test_the_verb_refuses_what_is_wrong_in_a_line_and_counts_rows_without_an_answer(study: Path) -> None:
    table = study / "sub-P01" / "responses.csv"
    rows = table.read_text().splitlines()
    table.write_text("\n".join([*rows, rows[1]]) + "\n")
    assert "stands twice" in palpate("experiment", "analyze", study, status=2)
    blank = rows[1].split(",")
    blank[7] = ""
    table.write_text("\n".join([rows[0], ",".join(blank), *rows[2:]]) + "\n")
    said = palpate("experiment", "analyze", study)
    assert "1 rows" in said
    assert "balanced, 1" in said
    assert "gaussian, logistic" in palpate("experiment", "analyze", study, "--shape", "step", status=2)
    assert "no folder" in palpate("experiment", "analyze", study / "none", status=2)
