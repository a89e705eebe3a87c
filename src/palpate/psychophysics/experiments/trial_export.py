"""An experiment's judgements in the layout of BIDS, a folder a participant, each table beside a JSON of its
columns.

Behaviour without neural recordings is ``sub-P01/beh/sub-P01_task-pair_beh.tsv``, by the Brain Imaging Data
Structure (https://bids-specification.readthedocs.io, Behavioral experiments). ``onset`` and ``response_time``
are in seconds, as there and in PsychoPy; jsPsych has milliseconds. Times of day are left out, of the source's
table too: onsets count from a participant's first stimulus. The key of letters stays where it is.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import InputError, new_folder
from palpate.psychophysics.experiments.experiment_file import ExperimentDesign
from palpate.psychophysics.experiments.participant_record import (
    HEADER,
    ParticipantRecord,
    label_of,
    response_lines,
)
from palpate.psychophysics.experiments.sitting import (
    check_owner,
    home_of,
    participant_folder,
    records,
    schedule_of,
)
from palpate.psychophysics.experiments.trial_schedule import Schedule, tracks_of
from palpate.psychophysics.judgements import (
    RESPONSES,
    STIMULI,
    Judgement,
    Task,
    read_judgements,
    write_stimuli,
)
from palpate.version import __version__

BIDS_VERSION = "1.10.0"
NONE = "n/a"
Row = dict[str, str]
Columns = Mapping[str, Mapping[str, Any]]

PARTICIPANT_COLUMNS: Columns = {
    "participant_id": {"Description": "code of the participant, without - and _"},
    "group": {"Description": "of the design, which says the presentations that were met"},
    "laterality_quotient": {
        "Description": "Edinburgh Handedness Inventory, 100 (R - L) / (R + L); -100 left, 100 right",
        "TermURL": "https://doi.org/10.1016/0028-3932(71)90067-4",
    },
    "age": {"Description": "whole years or a band, as far as it was told", "Units": "year"},
    "judgements": {"Description": "how many were given"},
    "complete": {"Description": "whether all that was planned was asked", "Levels": {"yes": "", "no": ""}},
    "simulated": {
        "Description": "whether there was no person, or a display that no finger can feel",
        "Levels": {"yes": "nothing here is a measurement", "no": "a person touched"},
    },
}
SHARED: Columns = {
    "onset": {"Description": "first stimulus shown, since the participant's first trial", "Units": "s"},
    "duration": {"Description": "from the first stimulus to the answer", "Units": "s"},
    "condition": {
        "Description": "cues that were available",
        "Levels": {"I": "kinesthetic and cutaneous", "K": "kinesthetic alone", "C": "cutaneous alone"},
    },
    "presentation": {
        "Description": "how stimuli were met",
        "Levels": {"direct": "a specimen under the finger", "rendered": "by a softness display"},
    },
    "block": {"Description": "counted from 1 in each presentation, condition and task"},
    "trial": {"Description": "counted from 1 in the block"},
    "presented": {"Description": "stimuli in the order of presentation, separated by blanks"},
}
LAST: Columns = {
    "response_time": {"Description": "as duration", "Units": "s"},
    "simulated": PARTICIPANT_COLUMNS["simulated"],
}
PAIR_COLUMNS: Columns = {
    **SHARED,
    "response": {"Description": "the stimulus that was called softer"},
    "comparison": {"Description": "the stimulus beside the standard"},
    "standard_position": {"Description": "of the standard", "Levels": {"1": "first", "2": "second"}},
    "softness_difference": {
        "Description": "softness of the comparison minus the standard's, by their levels"
    },
    "comparison_softer": {
        "Description": "whether the comparison was called softer",
        "Levels": {"0": "", "1": ""},
    },
    "correct": {"Description": "whether the softer one was named", "Levels": {"0": "no", "1": "yes"}},
    **LAST,
}
RANK_COLUMNS: Columns = {
    **SHARED,
    "response": {"Description": "stimuli from the hardest to the softest, separated by blanks"},
    "places_right": {"Description": "how many stimuli stand where they belong"},
    "correct": {"Description": "whether all of them do", "Levels": {"0": "no", "1": "yes"}},
    **LAST,
}


@dataclass(frozen=True, slots=True)
class ExportSummary:
    """Summary of an export."""

    participants: tuple[str, ...]
    complete: tuple[str, ...]
    judgements: int
    simulated: bool


def export_trials(design: ExperimentDesign, out: Path, simulated: bool = False) -> ExportSummary:
    """Write all participants with consent (or all rehearsals) into a new folder."""
    enrolled = [one for one in records(design, simulated) if one.consent in ("yes", "simulated")]
    if not enrolled:
        where = home_of(design, simulated)
        raise InputError(
            f"{where} has no participant yet; `palpate experiment run` enrols one", code="no-participants"
        )
    labels = [label_of(one.participant) for one in enrolled]
    twice = [one.participant for one, label in zip(enrolled, labels, strict=True) if labels.count(label) > 1]
    if twice:
        raise InputError(
            f"participants {', '.join(twice)} have one label in BIDS, which knows no - and _",
            code="equal-labels",
        )
    everybody: list[Judgement] = []
    people: list[Row] = []
    with new_folder(out) as part:
        source = part / "sourcedata"
        for record, label in zip(enrolled, labels, strict=True):
            home = participant_folder(design, record.participant, simulated)
            judgements = read_judgements(home / RESPONSES)
            check_owner(home, record, judgements)
            schedule = schedule_of(design, record)
            complete = schedule.next(judgements) is None
            people.append(_person(record, label, len(judgements), complete))
            everybody += judgements
            _write_participant(part, design, record, label, schedule, judgements)
        _write_table(part / "participants.tsv", PARTICIPANT_COLUMNS, people)
        _write_json(part / "participants.json", PARTICIPANT_COLUMNS)
        _write_json(part / "dataset_description.json", _description(design))
        (part / "README").write_text(_readme(design), encoding="utf-8")
        source.mkdir()
        rows = HEADER + response_lines((replace(one, when="") for one in everybody), simulated)
        (source / RESPONSES).write_text(rows, encoding="utf-8", newline="")
        write_stimuli(source / STIMULI, design.stimuli.values())
    return ExportSummary(
        tuple(labels), tuple(one["participant_id"][4:] for one in people if one["complete"] == "yes"),
        len(everybody), simulated,
    )  # fmt: skip


def _person(record: ParticipantRecord, label: str, judgements: int, complete: bool) -> Row:
    quotient = record.laterality_quotient
    return {
        "participant_id": f"sub-{label}", "group": record.group,
        "laterality_quotient": NONE if quotient is None else f"{quotient:.6g}", "age": record.age or NONE,
        "judgements": str(judgements), "complete": _yes(complete), "simulated": _yes(record.simulated),
    }  # fmt: skip


def _write_participant(
    part: Path,
    design: ExperimentDesign,
    record: ParticipantRecord,
    label: str,
    schedule: Schedule,
    judgements: Sequence[Judgement],
) -> None:
    folder = part / f"sub-{label}" / "beh"
    folder.mkdir(parents=True)
    begins_s = _onsets(judgements)
    for task, columns in ((Task.PAIR, PAIR_COLUMNS), (Task.RANK, RANK_COLUMNS)):
        rows = [
            _row(design, one, begin_s, record.simulated)
            for one, begin_s in zip(judgements, begins_s, strict=True)
            if one.task is task
        ]
        if rows:
            stem = folder / f"sub-{label}_task-{task.value}_beh"
            _write_table(stem.with_suffix(".tsv"), columns, rows)
            _write_json(stem.with_suffix(".json"), _sidecar(design, task, columns, schedule, judgements))


def _onsets(judgements: Sequence[Judgement]) -> list[float]:
    """When each first stimulus was shown, after the first of all [s]; NaN where times were not kept."""
    ends = [_epoch_s(one.when) for one in judgements]
    begins = [
        end - (0.0 if math.isnan(one.seconds) else one.seconds)
        for end, one in zip(ends, judgements, strict=True)
    ]
    known = [one for one in begins if not math.isnan(one)]
    return [one - min(known) if known else math.nan for one in begins]


def _epoch_s(when: str) -> float:
    try:
        return datetime.fromisoformat(when).timestamp()
    except ValueError:
        return math.nan


def _row(design: ExperimentDesign, one: Judgement, onset_s: float, simulated: bool) -> Row:
    seconds = _number(one.seconds, 3)
    row = {
        "onset": _number(onset_s, 3), "duration": seconds, "condition": one.condition.value,
        "presentation": one.presentation.value, "block": str(one.block), "trial": str(one.trial),
        "presented": " ".join(one.presented), "response": " ".join(one.answer), "response_time": seconds,
        "correct": str(int(one.right(design.stimuli))), "simulated": _yes(simulated),
    }  # fmt: skip
    if one.task is Task.RANK:
        truth = one.truth(design.stimuli)
        return row | {"places_right": str(sum(a == b for a, b in zip(one.answer, truth, strict=True)))}
    standard = design.file.set_of(one.presentation, one.condition).standard
    comparison = next(name for name in one.presented if name != standard)
    return row | {
        "comparison": comparison,
        "standard_position": str(1 + one.presented.index(standard)),
        "softness_difference": _number(design.softness(comparison) - design.softness(standard), 9),
        "comparison_softer": str(int(one.answer == (comparison,))),
    }


def _sidecar(
    design: ExperimentDesign,
    task: Task,
    columns: Columns,
    schedule: Schedule,
    judgements: Sequence[Judgement],
) -> dict[str, Any]:
    named = {one.name: f"level {one.level:g} {one.unit}".strip() for one in design.stimuli.values()}
    unit = next(iter(design.stimuli.values())).unit
    described = {name: dict(column) for name, column in columns.items()}
    described["presented"]["Levels"] = named
    if task is Task.RANK:
        return {"TaskName": "rank", "TaskDescription": design.file.request, **described}
    described["softness_difference"]["Units"] = unit
    tracks = list(_tracks(design, schedule, judgements))
    more = {"Staircases": tracks} if tracks else {}
    return {"TaskName": "pair", "TaskDescription": design.file.question, **described, **more}


def _tracks(
    design: ExperimentDesign, schedule: Schedule, judgements: Sequence[Judgement]
) -> Iterator[dict[str, Any]]:
    """Each staircase: where its rule settles, where it turned, and the mean of that."""
    for block, states in tracks_of(schedule, judgements):
        base = design.softness(block.standard)
        for side, softer, state in zip(block.sides, block.softer, states, strict=True):
            x = [round(abs(design.softness(one) - base), 9) for one in side]
            mean = state.threshold
            yield {
                "presentation": block.presentation.value, "condition": block.condition.value,
                "block": block.block, "side": "softer" if softer else "harder",
                "settles_at_share_right": block.rule.converges_to,
                "trials": state.trials, "ended": state.ended,
                "reversals_softness_difference": [x[place] for place in state.reversals],
                "threshold_softness_difference":
                    None if math.isnan(mean) else float(np.interp(mean, range(len(x)), x)),
            }  # fmt: skip


def _description(design: ExperimentDesign) -> dict[str, Any]:
    return {
        "Name": design.file.name,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "palpate", "Version": __version__}],
    }


def _readme(design: ExperimentDesign) -> str:
    return (
        f"{design.file.name}\n\nJudgements of softness, exported by palpate {__version__}. Each table has "
        "its columns described in the JSON file beside it. sourcedata has the judgements of all in one "
        f"table, and the stimuli with their levels. Seed {design.file.seed}. Participants have codes alone; "
        "rows marked as simulated are no measurement.\n"
    )


def _number(value: float, digits: int) -> str:
    return NONE if math.isnan(value) else f"{round(value, digits):.12g}"


def _yes(whether: bool) -> str:
    return "yes" if whether else "no"


def _write_table(path: Path, columns: Columns, rows: Sequence[Row]) -> None:
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, list(columns), delimiter="\t", lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    path.write_text(text.getvalue(), encoding="utf-8", newline="")


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    path.write_text(text, encoding="utf-8")
