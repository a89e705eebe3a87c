"""Exported tables say what was judged, in the layout of BIDS, and no more."""

import json
import re

import pandas as pd
import pytest
from tests.refusals import refused

from palpate.core import ExistsError, InputError, LabelError
from palpate.psychophysics import read_judgements
from palpate.psychophysics.experiments import (
    Enrolment,
    Sitting,
    enrol,
    export_trials,
    make_experiment,
    noisy_answers,
    participant_folder,
)
from palpate.psychophysics.experiments.participant_record import label_of


def filled(design, participant: str, noise: float, trials: int = 10_000, simulated: bool = False) -> None:
    enrol(design, participant, Enrolment(True, 80.0, "27", simulated))
    answer = noisy_answers(design, participant, noise)
    times = (f"2026-01-01T10:{k // 60:02d}:{k % 60:02d}+00:00" for k in range(2, 3600, 4))
    with Sitting(design, participant, lambda: next(times), simulated) as sitting:
        while sitting.next is not None and trials:
            sitting.take(answer(sitting.next), 1.5)
            trials -= 1


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export")
    design = make_experiment(folder / "jelly", "jelly", 5)
    filled(design, "P-01", 0.0)
    filled(design, "P_02", 1.0, 7)
    enrol(design, "P03", Enrolment(False))
    filled(design, "R01", 1.0, simulated=True)
    return design, folder / "bids", export_trials(design, folder / "bids")


def test_an_export_has_who_consented_and_was_measured(exported) -> None:
    _, out, summary = exported
    assert (summary.participants, summary.complete, summary.judgements) == (("P01", "P02"), ("P01",), 20)
    assert not summary.simulated
    people = pd.read_csv(out / "participants.tsv", sep="\t")
    assert people.participant_id.tolist() == ["sub-P01", "sub-P02"]
    assert people.complete.tolist() == ["yes", "no"]
    assert people.laterality_quotient.tolist() == [80.0, 80.0]
    assert set(people.simulated) == {"no"}
    described = json.loads((out / "participants.json").read_text())
    assert list(described) == list(people)
    assert json.loads((out / "dataset_description.json").read_text())["BIDSVersion"] == "1.10.0"
    everything = "".join(path.read_text() for path in out.rglob("*") if path.is_file())
    assert "R01" not in everything
    assert "2026-01-01" not in everything, "no date"
    assert not re.search(r"\d\d:\d\d", everything), "no time of day"
    assert "letter" not in everything


def test_rows_say_what_was_presented_answered_and_right(exported) -> None:
    design, out, _ = exported
    beh = out / "sub-P01" / "beh"
    judgements = read_judgements(participant_folder(design, "P-01") / "responses.csv")
    pairs = pd.read_csv(beh / "sub-P01_task-pair_beh.tsv", sep="\t")
    assert list(pairs.presented) == [" ".join(one.presented) for one in judgements[:-1]]
    assert list(pairs.response) == [one.answer[0] for one in judgements[:-1]]
    assert set(pairs.correct) == {1}
    level = {name: one.level for name, one in design.stimuli.items()}
    for row in pairs.itertuples():
        # levels are of gelatine, and more of it is harder
        assert row.softness_difference == pytest.approx(level["cup3"] - level[row.comparison])
        assert row.comparison_softer == (row.softness_difference > 0)
        assert row.presented.split()[row.standard_position - 1] == "cup3"
    assert list(pairs.onset) == [4.0 * k for k in range(12)]
    assert set(pairs.duration) == set(pairs.response_time) == {1.5}
    [rank] = pd.read_csv(beh / "sub-P01_task-rank_beh.tsv", sep="\t").itertuples()
    assert (rank.response.split(), rank.places_right, rank.correct) == (
        [f"cup{k}" for k in range(1, 6)],
        5,
        1,
    )
    for task, table in (("pair", pairs),):
        described = json.loads((beh / f"sub-P01_task-{task}_beh.json").read_text())
        assert set(table) <= set(described)
        assert described["softness_difference"]["Units"] == "g/100ml"
        assert "4 g/100ml" in described["presented"]["Levels"]["cup1"]
    assert not (out / "sub-P02" / "beh" / "sub-P02_task-rank_beh.tsv").exists()


def test_a_rehearsal_is_exported_alone_and_says_so(exported, tmp_path) -> None:
    design, _, _ = exported
    summary = export_trials(design, tmp_path / "bids", simulated=True)
    assert summary.simulated
    assert summary.participants == ("R01",)
    assert set(pd.read_csv(tmp_path / "bids" / "participants.tsv", sep="\t").simulated) == {"yes"}
    rows = (tmp_path / "bids" / "sourcedata" / "responses.csv").read_text().splitlines()[1:]
    assert all(row.endswith(",yes") for row in rows)


def test_nothing_is_overwritten_and_what_cannot_be_is_refused_whole(exported, tmp_path) -> None:
    design, out, _ = exported
    with pytest.raises(ExistsError):
        export_trials(design, out)
    empty = make_experiment(tmp_path / "jelly", "jelly", 5)
    with refused("no-participants", InputError):
        export_trials(empty, tmp_path / "bids")
    filled(empty, "P1", 0.0, 2)
    for code in ("P-1", "P_1", "p1"):
        with refused("participant-exists", InputError, match="'sub-P1'"):
            enrol(empty, code, Enrolment(True))
    filled(empty, "P-2", 0.0, 2)
    other = participant_folder(empty, "P-2")
    record = (other / "participant.json").read_text()
    (other / "participant.json").write_text(record.replace('"P-2"', '"P-1"'))
    table = other / "responses.csv"
    table.write_text(table.read_text().replace("P-2,", "P-1,"))
    renamed = other.rename(other.with_name("sub-P-1"))
    with refused("equal-labels", InputError, match="P1"):
        export_trials(empty, tmp_path / "bids")
    renamed.rename(tmp_path / "gone")
    table = participant_folder(empty, "P1") / "responses.csv"
    table.rename(tmp_path / "responses.csv")
    table.write_text("".join((tmp_path / "responses.csv").read_text().splitlines(keepends=True)[::2]))
    with refused("schedule", LabelError):
        export_trials(empty, tmp_path / "bids")
    assert not (tmp_path / "bids").exists()
    assert label_of("P_0-1") == "P01"
