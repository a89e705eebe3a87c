"""A participant's sitting: enrolled once, gone on with as often as needed, in one order, by one design.

In the experiment's folder each participant has a folder of their own, ``sub-P01``, which appears whole:

* ``participant.json``, as `ParticipantRecord` says, with digests of design and schedule;
* ``responses.csv``, the judgements;
* ``schedule.jsonl``, what is asked, for the archive, and ``key.csv``, the letter of each stimulus, for
  whoever labels the specimens; neither is shown to anybody who meets the participant;
* ``sittings.csv``, when sittings began, paused and why.

Whoever is simulated has a folder in ``rehearsal``, is counted there alone, and so never comes among what was
measured.

Recorded answers of an experiment, read for analysis.

Answers of participants with records count only under the design that they began with and with valid consent.
"""

from __future__ import annotations

import csv
import io
import math
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from palpate.core import (
    Closing,
    ExistsError,
    InputError,
    LabelError,
    RecordingError,
    lock,
    new_folder,
    storage_errors,
)
from palpate.psychophysics.experiments.experiment_file import (
    EXPERIMENT,
    ExperimentDesign,
    read_design,
    stimuli_digest,
)
from palpate.psychophysics.experiments.participant_record import (
    HEADER,
    PARTICIPANT,
    ParticipantRecord,
    Place,
    ResponseLog,
    checked_participant,
    key_text,
    label_of,
    letter_codes,
)
from palpate.psychophysics.experiments.trial_schedule import PlannedTrial, Schedule, make_schedule
from palpate.psychophysics.judgements import (
    RESPONSES,
    STIMULI,
    Judgement,
    Stimulus,
    checked_code,
    checked_judgements,
    is_rehearsal,
    read_judgements,
    read_stimuli,
)
from palpate.version import __version__

SITTINGS, SCHEDULE, KEY = "sittings.csv", "schedule.jsonl", "key.csv"
REHEARSAL = "rehearsal"
PREFIX = "sub-"
WAIT_S = 5.0  # for another participant's enrolment
Now = Callable[[], str]


@dataclass(frozen=True, slots=True)
class Enrolment:
    """Information of a participant before the first trial; `laterality_quotient` is -100 left to 100 right or
    NaN.
    """

    consent: bool
    laterality_quotient: float = math.nan
    age: str = ""
    simulated: bool = False


def home_of(design: ExperimentDesign, simulated: bool) -> Path:
    """The folder in which folders of participants lie, or of those who are simulated."""
    return design.folder / REHEARSAL if simulated else design.folder


def participant_folder(design: ExperimentDesign, participant: str, simulated: bool = False) -> Path:
    """The folder of a participant, whether there is one yet or not."""
    checked_code(participant, "participant")
    folder = home_of(design, simulated) / f"{PREFIX}{participant}"
    with storage_errors(folder.parent):
        names = [path.name for path in folder.parent.glob(f"{PREFIX}*")]
    if folder.name not in names:
        checked_participant(participant)
        label = label_of(participant).lower()
        others = [one for one in names if label_of(one.removeprefix(PREFIX)).lower() == label]
        if others:
            raise InputError(
                f"participant {participant!r}; there is {others[0]!r} already, which differs by capitals, - "
                "or _ alone: give another code",
                code="participant-exists",
            )
    return folder


def enrol(design: ExperimentDesign, participant: str, told: Enrolment) -> ParticipantRecord:
    """Enroll a participant: number and folder; without consent, a record alone."""
    folder = participant_folder(design, participant, told.simulated)
    quotient = None if math.isnan(told.laterality_quotient) else told.laterality_quotient
    with _enrolling(design):
        if folder.exists():
            raise ExistsError(f"participant {participant} was enrolled before; give another code")
        if not told.consent:
            record = ParticipantRecord(participant, "no", version=__version__)
            with new_folder(folder) as part:
                record.write(part)
            return record
        number = 1 + max((one.number for one in records(design, told.simulated)), default=0)
        schedule = make_schedule(design, number, told.simulated)
        record = ParticipantRecord(
            participant, "simulated" if told.simulated else "yes", number, schedule.group.name, quotient,
            told.age, told.simulated, design.file.seed, dict(design.digests), schedule.digest, __version__,
        )  # fmt: skip
        with new_folder(folder) as part:
            record.write(part)
            (part / RESPONSES).write_text(HEADER, encoding="utf-8", newline="")
            (part / SCHEDULE).write_text(schedule.text, encoding="utf-8", newline="")
            key = key_text(letter_codes(design, number, told.simulated))
            (part / KEY).write_text(key, encoding="utf-8", newline="")
            (part / SITTINGS).write_text("when,event,why\n", encoding="utf-8", newline="")
    return record


def records(design: ExperimentDesign, simulated: bool = False) -> list[ParticipantRecord]:
    """Return the records of all measured (or all simulated) participants, sorted by code."""
    home = home_of(design, simulated)
    with storage_errors(home):
        kept = [path for name in (PARTICIPANT, RESPONSES) for path in home.glob(f"{PREFIX}*/{name}")]
    folders = sorted({path.parent for path in kept})
    found = [ParticipantRecord.read(folder) for folder in folders]
    for folder, one in zip(folders, found, strict=True):
        check_owner(folder, one, ())
        if one.simulated != simulated:
            raise LabelError(
                f"{folder / PARTICIPANT} is of {one.participant}, simulated: {one.simulated}; put it back"
            )
    return found


def _enrolling(design: ExperimentDesign) -> BinaryIO:
    """A lock, so that two participants who come at once have two numbers."""
    end_s = time.monotonic() + WAIT_S
    while True:
        try:
            return lock(design.folder / EXPERIMENT)
        except RecordingError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.05)


class Sitting(Closing):
    """Session state of a participant; `next` is None when all is answered, `now` gives ISO 8601 times."""

    def __init__(self, design: ExperimentDesign, participant: str, now: Now, simulated: bool = False) -> None:
        folder = participant_folder(design, participant, simulated)
        self.design, self._folder, self._now = design, folder, now
        self.record = ParticipantRecord.read(folder)
        check_owner(folder, self.record, ())
        if self.record.simulated != simulated:
            raise InputError(f"{folder / PARTICIPANT} was changed: simulated; put it back as it was written")
        if self.record.consent not in ("yes", "simulated"):
            raise InputError(
                f"participant {participant} has not consented, so that there is no trial", code="no-consent"
            )
        self.schedule: Schedule = schedule_of(design, self.record)
        self.codes: Mapping[Place, str] = letter_codes(design, self.record.number, simulated)
        self._check_schedule()
        self._log = ResponseLog(folder, self.record.simulated)
        try:
            check_owner(folder, self.record, self._log.judgements)
            self._course = self.schedule.follow(self._log.judgements)
            self.torn = self._log.torn
            if self.torn:
                self.note("cut", f"{self.torn} bytes of a row that was not finished; it is asked again")
        except BaseException:
            self._log.close()
            raise

    @property
    def next(self) -> PlannedTrial | None:
        """The trial that is asked next."""
        return self._course.next

    @property
    def key(self) -> Path:
        """The file that says which letter is which stimulus, for whoever labels the specimens."""
        return self._folder / KEY

    @property
    def judgements(self) -> tuple[Judgement, ...]:
        """What was answered so far."""
        return tuple(self._log.judgements)

    def take(self, answer: tuple[str, ...], seconds: float) -> Judgement:
        """Store the answer (names of stimuli) to the next trial on disk, and advance."""
        if self.next is None:
            raise InputError(
                f"participant {self.record.participant} has answered all; there is no next trial"
            )
        one = self.next
        judgement = Judgement(
            self.record.participant, one.condition, one.presentation, one.task, one.block, one.trial,
            one.presented, answer, seconds, self._now(),
        )  # fmt: skip
        self._log.append(judgement)
        self._course.take(judgement)
        return judgement

    def note(self, event: str, why: str = "") -> None:
        """Note what became of the sitting; it goes on without, where the disk refuses."""
        text = io.StringIO(newline="")
        csv.writer(text, lineterminator="\n").writerow([self._now(), event, " ".join(why.split())])
        with suppress(OSError), (self._folder / SITTINGS).open("ab") as file:
            file.write(text.getvalue().encode())
            file.flush()
            os.fsync(file.fileno())

    def close(self) -> None:
        self._log.close()

    def _check_schedule(self) -> None:
        for name, text in ((SCHEDULE, self.schedule.text), (KEY, key_text(self.codes))):
            path = self._folder / name
            with storage_errors(path):
                same = path.read_bytes() == text.encode()
            if not same:
                whose = self.record.participant
                raise InputError(f"{path} was changed since {whose} began; put it back as it was written")


def check_begun_by(record: ParticipantRecord, digests: Mapping[str, str], where: Path) -> None:
    """Reject a design whose file digests differ from those with which the participant began."""
    begun = record.design or {}
    changed = [one for one in sorted({*begun, *digests}) if begun.get(one) != digests.get(one)]
    if changed:
        mend = "put it back as it was, or begin another experiment by `palpate experiment new`"
        if record.simulated:
            mend = f"delete the folder {REHEARSAL}, and rehearse again; or put it back as it was"
        raise InputError(
            f"{', '.join(changed)} of {where} changed since {record.participant} began, and a participant's "
            f"answers belong to one design alone; {mend}",
            code="design-changed",
        )


def check_owner(folder: Path, record: ParticipantRecord, judgements: Sequence[Judgement]) -> None:
    """Refuse a folder in which another participant's record or answers lie."""
    named = folder.resolve().name
    if named.startswith(PREFIX) and named != f"{PREFIX}{record.participant}":
        raise LabelError(
            f"{folder / PARTICIPANT} is of {record.participant}: the folder was copied or renamed; put it "
            "back, and enrol whoever is new by a code that has no folder yet",
            code="folder-of-another",
        )
    others = sorted({one.participant for one in judgements} - {record.participant})
    if others:
        raise LabelError(
            f"{folder / RESPONSES} has answers of {', '.join(others)}, and the folder is of "
            f"{record.participant}; put the table back as it was written",
            code="answers-of-another",
        )


def schedule_of(design: ExperimentDesign, record: ParticipantRecord) -> Schedule:
    """The schedule that a participant began with."""
    check_begun_by(record, design.digests, design.folder)
    schedule = make_schedule(design, record.number, record.simulated)
    if schedule.digest != record.schedule:
        raise InputError(
            f"the schedule of {record.participant} is not the one that was begun: {PARTICIPANT} was changed, "
            f"or palpate {record.version} made another one than {__version__}; put back the file, or that "
            "version"
        )
    if record.group != schedule.group.name:
        raise InputError(
            f"{PARTICIPANT} of {record.participant} was changed: group {record.group!r}, where the schedule "
            f"has {schedule.group.name!r}; put it back as it was written",
            code="participant-changed",
        )
    return schedule


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
