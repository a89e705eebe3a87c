"""Recorded answers of an experiment, read for analysis.

Answers of participants with records count only under the design that they began with and with valid consent.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from palpate.core import LabelError, storage_errors
from palpate.psychophysics.experiments.experiment_file import EXPERIMENT, read_design, stimuli_digest
from palpate.psychophysics.experiments.participant_record import PARTICIPANT, ParticipantRecord
from palpate.psychophysics.experiments.sitting import check_begun_by, check_owner
from palpate.psychophysics.judgements import (
    RESPONSES,
    STIMULI,
    Judgement,
    Stimulus,
    checked_judgements,
    is_rehearsal,
    read_judgements,
    read_stimuli,
)

SOURCE = "sourcedata"


@dataclass(frozen=True, slots=True)
class KeptAnswers:
    """Answers in a folder.

    Attributes:
        unanswered: one line per row without an answer.
        withdrawn: codes of participants without valid consent, who are left out.
        simulated: whether any answer or display was simulated.
    """

    judgements: tuple[Judgement, ...]
    stimuli: Mapping[str, Stimulus]
    unanswered: tuple[str, ...]
    withdrawn: tuple[str, ...]
    simulated: bool


def read_kept_answers(folder: Path) -> KeptAnswers:
    """Read answers and stimuli from the folder of an experiment, rehearsal, participant, export, or two
    tables.
    """
    if not folder.is_dir():
        raise LabelError(f"{folder} is no folder; give the one of {STIMULI} and the participants' answers")
    if (folder / SOURCE / RESPONSES).is_file():
        folder = folder / SOURCE
    stimuli, digests, where = _stimuli_of(folder)
    unanswered: list[str] = []
    judgements: list[Judgement] = []
    withdrawn: list[str] = []
    for table in _tables(folder):
        record = _record_of(table.parent, required=EXPERIMENT in digests)
        if record is not None and record.consent == "no":
            withdrawn.append(record.participant)
            continue
        own = read_judgements(table, unanswered)
        if record is not None:
            check_owner(table.parent, record, own)
            begun = record.design or {}
            if EXPERIMENT in digests:
                check_begun_by(record, digests, where)
            elif STIMULI in begun:  # the tables alone were brought here
                check_begun_by(record, {**begun, **digests}, where)
        judgements += own
    return KeptAnswers(
        checked_judgements(judgements), stimuli, tuple(unanswered), tuple(withdrawn), is_rehearsal(folder)
    )


def _tables(folder: Path) -> Iterable[Path]:
    with storage_errors(folder):
        own = folder / RESPONSES
        tables = [own] if own.is_file() else sorted(folder.glob(f"*/{RESPONSES}"))
    if not tables:
        raise LabelError(f"{folder} holds no {RESPONSES}, nor do the folders in it")
    return tables


def _stimuli_of(folder: Path) -> tuple[Mapping[str, Stimulus], Mapping[str, str], Path]:
    """Stimuli, digests of what says them, and where: the design, of a rehearsal too, or a table alone."""
    above = [folder, folder.resolve().parent, folder.resolve().parent.parent]
    for home in above:
        if (home / EXPERIMENT).is_file():
            design = read_design(home)
            return design.stimuli, design.digests, home
    home = next((one for one in above[:2] if (one / STIMULI).is_file()), folder)
    stimuli = read_stimuli(home)
    return stimuli, {STIMULI: stimuli_digest(stimuli)}, home


def _record_of(folder: Path, *, required: bool) -> ParticipantRecord | None:
    """A participant's record; None in a folder that was made elsewhere."""
    return ParticipantRecord.read(folder) if required or (folder / PARTICIPANT).is_file() else None
