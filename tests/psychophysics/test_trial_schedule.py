"""Schedules: balanced, a pure function of design, seed and number, and the same on every machine."""

import itertools
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from tests.refusals import refused

from palpate.core import ExistsError, InputError, LabelError
from palpate.psychophysics import Judgement, Presentation, Task
from palpate.psychophysics.experiments import (
    PRESETS,
    ExperimentDesign,
    Schedule,
    make_experiment,
    make_schedule,
    read_design,
)
from palpate.psychophysics.experiments.experiment_file import EXPERIMENT
from palpate.psychophysics.experiments.trial_schedule import (
    Course,
    allocation,
    order_of_conditions,
    tracks_of,
    williams_rows,
)
from palpate.softness import read_object


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> ExperimentDesign:
    return make_experiment(tmp_path_factory.mktemp("report") / "study", "bianchi-2010", 11)


@pytest.fixture(scope="module")
def threshold(tmp_path_factory) -> ExperimentDesign:
    return make_experiment(tmp_path_factory.mktemp("threshold") / "study", "threshold", 11)


def answered(schedule: Schedule, answer) -> list[Judgement]:
    """All judgements of a participant who answers by a rule."""
    judgements: list[Judgement] = []
    course = Course(schedule)
    while (one := course.next) is not None:
        given = answer(one.presented, one.task)
        place = one.condition, one.presentation, one.task, one.block, one.trial
        judgements.append(Judgement("P01", *place, one.presented, given))
        course.take(judgements[-1])
    return judgements


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_a_williams_design_has_each_condition_in_each_place_and_after_each_other_equally_often(count) -> None:
    rows = williams_rows(count)
    places = Counter((k, one) for row in rows for k, one in enumerate(row))
    follows = Counter(pair for row in rows for pair in itertools.pairwise(row))
    assert all(sorted(row) == list(range(count)) for row in rows)
    assert set(places.values()) == {len(rows) // count}
    assert count == 1 or (len(set(follows.values())) == 1 and len(follows) == count * (count - 1))


def test_fifteen_participants_are_five_a_group_with_conditions_balanced_over_places(report) -> None:
    groups = Counter(report.file.group[allocation(report.file, n)[0]].name for n in range(1, 16))
    assert groups == {"direct": 5, "rendered": 5, "both": 5}
    first = [[c for _, c in order_of_conditions(report.file, n)][:3] for n in range(1, 16)]
    places = Counter((k, one) for row in first for k, one in enumerate(row))
    assert set(places.values()) == {5}, "each condition five times in each place"
    assert {tuple(sorted(row)) for row in first} == {("C", "I", "K")}


def test_the_standard_is_first_in_half_of_a_block_and_of_each_pair_in_two_blocks(report) -> None:
    for number in range(1, 16):
        blocks = [b for b in make_schedule(report, number).blocks if b.task is Task.PAIR]
        for three in (blocks[k : k + 3] for k in range(0, len(blocks), 3)):
            standard = "SS3" if three[0].presentation is Presentation.DIRECT else "SH3"
            firsts = [{t[1]: True for t in b.trials if t[0] == standard} for b in three]
            assert [len(one) for one in firsts] == [2, 2, 2]
            assert not set(firsts[0]) & set(firsts[1]), "whatever came second comes first in the next block"


def test_a_schedule_is_a_function_of_design_seed_and_number_alone(report, tmp_path) -> None:
    again = make_experiment(tmp_path / "again", "bianchi-2010", 11)
    other = make_experiment(tmp_path / "other", "bianchi-2010", 12)
    digests = [make_schedule(report, n).digest for n in range(1, 16)]
    assert digests == [make_schedule(again, n).digest for n in range(1, 16)]
    assert len(set(digests)) == 15
    assert not set(digests) & {make_schedule(other, n).digest for n in range(1, 16)}
    # Pinned: a participant who began with an earlier version goes on with this one.
    assert digests[0] == "5c0bf2b8fbd2eb8e4cf54618cba7a65a013e626740f61cd31a66bde355175240"


def test_a_judgement_that_is_missing_or_stands_twice_is_refused(report) -> None:
    schedule = make_schedule(report, 1)
    whole = answered(schedule, lambda shown, task: shown if task is Task.RANK else shown[:1])
    assert schedule.next(whole) is None
    with refused("schedule", LabelError):
        schedule.next([*whole[:3], *whole[4:]])
    with pytest.raises(LabelError, match="judgement 5 "):
        schedule.next([*whole[:4], *whole[3:]])
    with pytest.raises(LabelError, match=f"asks for {len(whole)}"):
        schedule.next([*whole, replace(whole[-1], trial=9)])
    turned = replace(whole[0], presented=whole[0].presented[::-1])
    with pytest.raises(LabelError, match="judgement 1 "):
        schedule.next([turned, *whole[1:]])


def test_adaptive_trials_follow_the_answers_and_are_bounded(threshold) -> None:
    schedule = make_schedule(threshold, 1)
    never = answered(
        schedule, lambda shown, task: (max(shown),)
    )  # the hardest is called softer: always wrong
    always = answered(schedule, lambda shown, task: (min(shown),))
    assert len(always) <= schedule.max_trials
    for judgements in (never, always):
        assert schedule.next(judgements) is None
        assert all("F11" in one.presented for one in judgements)
        firsts = [one.presented[0] == "F11" for one in judgements if one.block == 1]
        assert all(sum(firsts[k : k + 2]) == 1 for k in range(0, 40, 2)), "first in each two trials once"
    farthest = Counter(next(n for n in one.presented if n != "F11") for one in never if one.block == 2)
    assert set(farthest) == {"F01", "F21"}, "whoever is always wrong stays at the ends"
    [(block, tracks)] = tracks_of(schedule, always)
    assert [one.place for one in tracks] == [0, 0], "whoever is always right comes to the nearest"
    assert block.sides[0][0] == "F10"
    assert block.sides[1][0] == "F12"


def test_presets_are_read_back_and_their_objects_can_be_rendered(tmp_path) -> None:
    for name in PRESETS:
        design = make_experiment(tmp_path / name, name, 1)
        objects = {one for part in design.file.stimuli for one in part.objects}
        assert len(objects) == {"jelly": 0, "bianchi-2010": 15, "threshold": 21}[name]
        for one in sorted(objects)[::9]:
            assert read_object(design.folder / one).greatest_n == pytest.approx(1.5)
        with pytest.raises(ExistsError):
            make_experiment(tmp_path / name, name, 1)
    with refused("preset-unknown", InputError):
        make_experiment(tmp_path / "x", "jam", 1)
    with refused("moduli-count", InputError):
        make_experiment(tmp_path / "x", "bianchi-2010", 1, (1.0, 2.0))
    for rising in ((100.0, 150.0, 300.0, 500.0, 800.0), (800.0, 500.0, 500.0, 150.0, 100.0)):
        with refused("moduli-order", InputError):
            make_experiment(tmp_path / "x", "bianchi-2010", 1, rising)
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("old", "new", "code", "named"),
    [
        ("repeats = 3", "repeats = 0", "file-field", "repeats"),
        ("repeats = 3", "repeat = 3", "file-field", "repeat"),
        ('method = "rank"', 'method = "sort"', "file-field", "task"),
        ('standard = "cup3"', 'standard = "cup9"', "file-field", "cup9"),
        ('standard = "cup3"', "", "file-field", "standard"),
        ('"cup5"]', '"cup6"]', "stimulus-unknown", "cup6"),
        ('"cup5"]', '"cup1"]', "file-field", "stimuli"),
        ('conditions = ["I"]', 'conditions = ["I", "K"]', "file-field", "condition K"),
        ('conditions = ["I"]', 'conditions = ["V"]', "file-field", "conditions"),
        ('presentation = "direct"', 'presentation = "screen"', "file-field", "presentation"),
        ('standard = "cup3"', 'standard = "cup3"\nobjects = ["a.toml"]', "file-field", "direct"),
        ('age = "no"', 'question = "Is cup3 softer?"', "not-blind", "cup3"),
        ("seed = 5", "seed = -5", "file-field", "seed"),
        ("seed = 5", "seed = ", "toml", "TOML"),
    ],
)
def test_a_design_that_cannot_be_is_refused_with_the_field(
    old: str, new: str, code: str, named: str, tmp_path: Path
) -> None:
    folder = make_experiment(tmp_path / "jelly", "jelly", 5).folder
    text = (folder / EXPERIMENT).read_text()
    assert old in text
    (folder / EXPERIMENT).write_text(text.replace(old, new, 1))
    with refused(code, InputError, match=named):
        read_design(folder)


@pytest.mark.parametrize("words", ["cup3's", "cup3/cup1", "CUP3", "(cup3)", "soft-cup3", "_cup3_", "“cup3”"])
def test_words_that_are_said_name_no_stimulus_whatever_stands_beside_it(words: str, tmp_path: Path) -> None:
    folder = make_experiment(tmp_path / "jelly", "jelly", 5).folder
    text = (folder / EXPERIMENT).read_text()
    for field in ("question", "request"):
        (folder / EXPERIMENT).write_text(
            text.replace('age = "no"', f'age = "no"\n{field} = "Is {words} softer?"'), encoding="utf-8"
        )
        with refused("not-blind", InputError):
            read_design(folder)
        (folder / EXPERIMENT).write_text(
            text.replace('age = "no"', f'age = "no"\n{field} = "Is cup33 or teacup3 softer?"')
        )
        read_design(folder)


@pytest.mark.parametrize("path", ["../a.toml", "/a.toml", "..\\\\a.toml", "objects/none.toml"])
def test_an_object_outside_the_folder_or_not_there_is_refused(path: str, tmp_path: Path) -> None:
    folder = make_experiment(tmp_path / "study", "bianchi-2010", 5).folder
    text = (folder / EXPERIMENT).read_text()
    (folder / EXPERIMENT).write_text(text.replace("objects/SH1-I.toml", path))
    with refused("object-path" if "none" in path else "file-field", InputError):
        read_design(folder)


def test_two_stimuli_of_one_level_are_refused(tmp_path: Path) -> None:
    folder = make_experiment(tmp_path / "jelly", "jelly", 5).folder
    table = folder / "stimuli.csv"
    table.write_text(table.read_text().replace("cup2,3.3", "cup2,2.7"))
    with refused("equal-levels", LabelError):
        read_design(folder)


@pytest.mark.parametrize(
    ("path", "old", "new"), [("stimuli.csv", "F03,94.1", "F03,95"), ("objects/F03.toml", "= 94.1", "= 95")]
)
def test_a_flat_is_as_stiff_as_its_level_says(path: str, old: str, new: str, tmp_path: Path) -> None:
    folder = make_experiment(tmp_path / "study", "threshold", 5).folder
    text = (folder / path).read_text()
    assert old in text
    (folder / path).write_text(text.replace(old, new))
    with refused("object-level", InputError, match=r"stimuli\.csv"):
        read_design(folder)
