"""Answers are analysed by the design that they belong to, with consent, and as what they are."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from tests.psychophysics.sitting_desks import NOW
from tests.refusals import refused
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import InputError, LabelError
from palpate.psychophysics import is_rehearsal
from palpate.psychophysics.experiments import (
    Enrolment,
    ExperimentDesign,
    ParticipantRecord,
    Sitting,
    enrol,
    export_trials,
    make_experiment,
    noisy_answers,
    participant_folder,
    read_design,
    read_kept_answers,
    records,
)


def answered(design: ExperimentDesign, participant: str, simulated: bool = False) -> Path:
    """The folder of a participant who has answered all."""
    enrol(design, participant, Enrolment(True, simulated=simulated))
    answer = noisy_answers(design, participant, 0.5)
    with Sitting(design, participant, lambda: NOW, simulated) as sitting:
        while sitting.next is not None:
            sitting.take(answer(sitting.next), 1.0)
    return participant_folder(design, participant, simulated)


def changed(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def told(*words: object, status: int = 0) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == status, result.output
    return result.output


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    design = make_experiment(tmp_path_factory.mktemp("made") / "jelly", "jelly", 5)
    for code in ("P01", "P02"):
        answered(design, code)
    return design.folder


@pytest.fixture
def study(made: Path, tmp_path: Path) -> ExperimentDesign:
    return read_design(Path(shutil.copytree(made, tmp_path / "jelly")))


@pytest.mark.parametrize(
    ("name", "old", "new"), [("stimuli.csv", "3.3", "1.3"), ("experiment.toml", "repeats = 3", "repeats = 2")]
)
def test_a_design_that_was_edited_since_is_not_what_answers_are_scored_by(
    study: ExperimentDesign, name: str, old: str, new: str
) -> None:
    assert len(read_kept_answers(study.folder).judgements) == 26
    changed(study.folder / name, old, new)
    for folder in (study.folder, study.folder / "sub-P02"):
        with refused("design-changed", InputError, match=str(name)):
            read_kept_answers(folder)
    assert "since P01" in told("experiment", "analyze", study.folder, status=2)


def test_an_exported_rehearsal_is_said_to_be_simulated_before_anything_else(
    study: ExperimentDesign, tmp_path: Path
) -> None:
    answered(study, "R01", simulated=True)
    export_trials(study, tmp_path / "real")
    export_trials(study, tmp_path / "rehearsed", simulated=True)
    for folder, simulated in (("real", False), ("rehearsed", True)):
        at = tmp_path / folder
        assert is_rehearsal(at / "sourcedata") is simulated
        assert read_kept_answers(at).simulated is simulated
        assert told("experiment", "analyze", at).startswith("Simulated: ") is simulated
    assert read_kept_answers(tmp_path / "real").stimuli == study.stimuli
    assert len(read_kept_answers(tmp_path / "real").judgements) == 26


def test_whose_consent_does_not_stand_is_left_out_and_counted(
    study: ExperimentDesign, tmp_path: Path
) -> None:
    changed(study.folder / "sub-P01" / "participant.json", '"consent": "yes"', '"consent": "no"')
    kept = read_kept_answers(study.folder)
    assert {one.participant for one in kept.judgements} == {"P02"}
    assert kept.withdrawn == ("P01",)
    assert "answers whose" in told("experiment", "analyze", study.folder)
    assert export_trials(study, tmp_path / "bids").participants == ("P02",)
    changed(study.folder / "sub-P01" / "participant.json", '"consent": "no"', '"consent": "withdrawn"')
    for read in (read_kept_answers, lambda folder: export_trials(study, tmp_path / "again")):
        with pytest.raises(LabelError, match="consent 'withdrawn'"):
            read(study.folder)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("laterality_quotient", "x"), ("laterality_quotient", float("nan")), ("laterality_quotient", 101),
        ("laterality_quotient", True), ("number", "1"), ("number", True), ("number", -1), ("age", 27),
        ("group", None), ("simulated", "no"), ("seed", 1.5), ("design", []),
        ("design", {"experiment.toml": 1}),
        ("schedule", None), ("version", 1), ("consent", "maybe"), ("consent", ["yes"]), ("participant", 1),
        ("group", "rendered"),
    ],
)  # fmt: skip
def test_a_record_of_wrong_types_is_one_line_that_names_the_field(
    field: str, value: Any, study: ExperimentDesign, tmp_path: Path
) -> None:
    path = study.folder / "sub-P01" / "participant.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {field: value}))
    said = told("experiment", "run", study.folder, "--participant", "P01", status=2)
    assert said.count("\n") == 1
    assert field in said
    with pytest.raises(LabelError if field != "group" or value is None else InputError, match=field):
        read_kept_answers(study.folder) if value != "rendered" else export_trials(study, tmp_path / "bids")


def test_a_folder_that_was_copied_or_has_another_s_answers_goes_nowhere(
    study: ExperimentDesign, tmp_path: Path
) -> None:
    shutil.copytree(study.folder / "sub-P01", study.folder / "sub-P03")
    for work in (
        lambda: Sitting(study, "P03", lambda: NOW),
        lambda: records(study),
        lambda: read_kept_answers(study.folder),
        lambda: read_kept_answers(study.folder / "sub-P03"),
    ):
        with refused("folder-of-another", LabelError, match="P01"):
            work()
    shutil.rmtree(study.folder / "sub-P03")
    changed(study.folder / "sub-P02" / "responses.csv", "P02,", "P01,")
    for work in (
        lambda: Sitting(study, "P02", lambda: NOW),
        lambda: export_trials(study, tmp_path / "bids"),
        lambda: read_kept_answers(study.folder),
    ):
        with refused("answers-of-another", LabelError, match="P02"):
            work()


def test_a_record_that_is_gone_is_to_be_put_back_and_gives_no_number_again(
    study: ExperimentDesign, tmp_path: Path
) -> None:
    (study.folder / "sub-P02" / "participant.json").unlink()
    for work in (
        lambda: ParticipantRecord.read(study.folder / "sub-P02"),
        lambda: Sitting(study, "P02", lambda: NOW),
        lambda: enrol(study, "P03", Enrolment(True)),
        lambda: export_trials(study, tmp_path / "bids"),
        lambda: read_kept_answers(study.folder),
    ):
        with refused("record-missing", match=r"participant\.json"):
            work()
