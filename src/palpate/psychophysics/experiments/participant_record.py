"""What is kept of a participant: a code, a number, and what they agreed to tell; nothing that names a person.

Of the Edinburgh Handedness Inventory the ten activities are named and the laterality quotient is formed, LQ =
100 (R - L) / (R + L), with two marks for a hand that alone is used, one mark for one that is preferred, and
one for each where either will do. Reference: R. C. Oldfield, Neuropsychologia 9 (1971) 97,
doi:10.1016/0028-3932(71)90067-4.

The table of a participant's judgements as it grows: a row at a time, on disk before the next trial.

Whoever holds it holds its lock. A row that a kill or a full disk cut short has no end of line. When the table
is opened again it is taken off, so that at most the judgement that was being given is lost; if nothing but
the end of line is missing, that is put there, and the judgement stays.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field, NonNegativeInt, TypeAdapter, ValidationError

from palpate.core import (
    Closing,
    InputError,
    LabelError,
    RangeError,
    RecordingError,
    lock,
    new_file,
    storage_errors,
)
from palpate.core.parsing import parser
from palpate.psychophysics.experiments.experiment_file import ExperimentDesign, StimuliPart
from palpate.psychophysics.experiments.trial_schedule import draw_of, drawn_order
from palpate.psychophysics.judgements import (
    RESPONSE_COLUMNS,
    RESPONSES,
    Condition,
    Judgement,
    Presentation,
    checked_code,
    judgement_row,
    read_judgements,
)

PARTICIPANT = "participant.json"
ACTIVITIES = (
    "writing", "drawing", "throwing", "scissors", "toothbrush", "knife (without fork)", "spoon",
    "broom (upper hand)", "striking a match", "opening a box (lid)",
)  # fmt: skip
MARKS = {"LL": (2, 0), "L": (1, 0), "B": (1, 1), "R": (0, 1), "RR": (0, 2), "": (0, 0)}
"""Marks of the left and of the right hand by what is typed; nothing where there is no experience."""

BAND = re.compile(r"(\d{1,3})(?:-(\d{1,3})|\+)\Z")
MAX_AGE = 120
LETTERS = "ABCDEFGHJKLMNPRTUVWXYZ"  # no I and O, which look like digits; no Q and S, which are keys


def laterality_quotient(marks: Sequence[str]) -> float:
    """Return the laterality quotient, -100 left to 100 right, of the `MARKS` of ten `ACTIVITIES`; NaN without
    any.
    """
    if len(marks) != len(ACTIVITIES) or not set(marks) <= set(MARKS):
        allowed = ", ".join(one for one in MARKS if one)
        raise InputError(f"marks {' '.join(marks)!r}; ten of {allowed} or nothing are needed")
    left, right = (sum(MARKS[mark][hand] for mark in marks) for hand in (0, 1))
    return math.nan if left + right == 0 else 100 * (right - left) / (right + left)


def checked_age(text: str, asked: str) -> str:
    """An age as it may be kept: nothing, a number of years, or a band such as 20-29 or 60+."""
    if not text:
        return ""
    if asked == "years" and text.isascii() and text.isdigit():
        years = [int(text)]
    elif asked == "band" and (match := BAND.match(text)):
        years = [int(one) for one in match.groups() if one]
    else:
        raise InputError(f"age {text!r}; " + ("whole years" if asked == "years" else "a band such as 20-29"))
    if years != sorted(years) or years[-1] > MAX_AGE:
        raise RangeError(
            f"age {text!r}; 0 to {MAX_AGE} years are allowed, a band from the lower to the upper", code="age"
        )
    return text


def checked_participant(code: str) -> str:
    """A code that a new participant may have: one of `checked_code` with a digit, so that it is no name."""
    checked_code(code, "participant")
    if code.lower().startswith("sub-"):
        raise InputError(
            f"participant {code!r}: the folder's sub- comes by itself; give {code[4:] or 'P01'}",
            code="participant-code",
        )
    if not any(one.isdigit() for one in code):
        raise InputError(
            f"participant {code!r}: a code has a digit, and no name has; give a code such as P01",
            code="participant-code",
        )
    return code


def label_of(participant: str) -> str:
    """A code as BIDS allows it: letters and digits alone."""
    return "".join(one for one in participant if one.isalnum())


@dataclass(frozen=True, slots=True)
class ParticipantRecord:
    """Record of a participant.

    Attributes:
        consent: "yes", "no", or "simulated".
        number: order of enrollment, from 1; 0 without consent.
        laterality_quotient: -100 left to 100 right, or None.
        design: digest of each file of the design.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True)

    participant: str
    consent: Literal["yes", "no", "simulated"]
    number: NonNegativeInt = 0
    group: str = ""
    laterality_quotient: Annotated[float, Field(ge=-100, le=100, allow_inf_nan=False)] | None = None
    age: str = ""
    simulated: bool = False
    seed: NonNegativeInt = 0
    design: dict[str, str] | None = None
    schedule: str = ""
    version: str = ""

    def write(self, folder: Path) -> None:
        """Write it into a participant's folder, which has none."""
        with new_file(folder / PARTICIPANT) as part:
            part.write_text(json.dumps(asdict(self), indent=1, allow_nan=False) + "\n", encoding="utf-8")

    @classmethod
    @parser("participant record", InputError)
    def read(cls, folder: Path) -> ParticipantRecord:
        """Read it from a participant's folder."""
        path = folder / PARTICIPANT
        with storage_errors(path):
            if folder.is_dir() and not path.exists():
                raise LabelError(
                    f"{path} is missing, which says who was asked what; put it back", code="record-missing"
                )
            data = path.read_bytes()
        try:
            record = TypeAdapter(cls).validate_json(data)
            checked_code(record.participant, "participant")
        except ValidationError as e:
            said = ", ".join(f"{'.'.join(map(str, one['loc']))} {one['input']!r:.40}" for one in e.errors())
            raise LabelError(
                f"{path} is damaged: {said}; put it back as it was written", code="record-damaged"
            ) from e
        return record


Place = tuple[Presentation, Condition, str]


def letter_codes(design: ExperimentDesign, number: int, simulated: bool = False) -> dict[Place, str]:
    """Draw a letter for each stimulus and condition, unique for a participant and different in rehearsals."""
    names = {name.upper() for name in design.stimuli}
    sets: list[StimuliPart] = [design.file.set_of(*place) for place in design.file.places()]
    places = [(one.presentation, one.condition, name) for one in sets for name in one.names]
    codes = [one for one in LETTERS if one not in names]
    if len(codes) < len(places):
        codes = [a + b for a in LETTERS for b in LETTERS if a + b not in names]
    if len(codes) < len(places):
        raise InputError(f"{len(places)} stimuli in all conditions; {len(codes)} have letters of their own")
    drawn = drawn_order(codes, *draw_of(design.file.seed, number, simulated), "letters")
    return dict(zip(places, drawn, strict=False))


def key_text(codes: Mapping[Place, str]) -> str:
    """The key as a table, for whoever labels the specimens: letter, presentation, condition, stimulus."""
    rows = sorted((code, *place) for place, code in codes.items())
    lines = ["letter,presentation,condition,stimulus"]
    lines += [
        f"{code},{presentation.value},{condition.value},{name}"
        for code, presentation, condition, name in rows
    ]
    return "\n".join(lines) + "\n"


COLUMNS = (*RESPONSE_COLUMNS, "simulated")
HEADER = ",".join(COLUMNS) + "\n"


def response_lines(judgements: Iterable[Judgement], simulated: bool) -> str:
    """Rows of a table that has `HEADER` above them."""
    text = io.StringIO(newline="")
    marked = {"simulated": "yes" if simulated else "no"}
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    table.writerows(judgement_row(one) | marked for one in judgements)
    return text.getvalue()


class ResponseLog(Closing):
    """A participant's response table, open for one writer; `torn` bytes of an incomplete row were removed."""

    def __init__(self, folder: Path, simulated: bool, fsync: Callable[[int], None] = os.fsync) -> None:
        self._path, self._simulated, self._fsync = folder / RESPONSES, simulated, fsync
        try:
            self._file = lock(self._path)
        except RecordingError as e:
            raise RecordingError(
                f"{folder.name} is being run in another terminal; end that sitting first, by q or Ctrl-C",
                code="session-in-use",
            ) from e
        try:
            self.torn = self._mend_tail()
            self.judgements = list(read_judgements(self._path))
            self._size = self._path.stat().st_size
        except BaseException:
            self._file.close()
            raise

    def append(self, judgement: Judgement) -> None:
        """Put a judgement on disk; when this returns no kill can take it away."""
        line, handle = response_lines([judgement], self._simulated).encode(), self._file.fileno()
        with storage_errors(self._path):
            if os.fstat(handle).st_size != self._size:
                raise LabelError(f"{self._path} was changed while it was being written; put it back")
            try:
                os.lseek(handle, self._size, os.SEEK_SET)
                written = 0
                while written < len(line):
                    written += os.write(handle, line[written:])
                self._fsync(handle)
            except OSError:
                with suppress(OSError):
                    os.ftruncate(handle, self._size)
                raise
        self._size += len(line)
        self.judgements.append(judgement)

    def close(self) -> None:
        self._file.close()

    def _mend_tail(self) -> int:
        """Complete or take off a row without an end of line; bytes that were taken off."""
        with storage_errors(self._path):
            data = self._path.read_bytes()
            whole = data.rfind(b"\n") + 1
            if not whole or whole == len(data):
                return len(data) - whole
            handle = self._file.fileno()
            if complete := _is_row(data[whole:]):
                os.lseek(handle, len(data), os.SEEK_SET)
                os.write(handle, b"\n")
            else:
                os.ftruncate(handle, whole)
            os.fsync(handle)
        return 0 if complete else len(data) - whole


def _is_row(tail: bytes) -> bool:
    """Whether a row has all its columns, the last of them whole."""
    fields = tail.decode("ascii", "replace").split(",")
    return len(fields) == len(COLUMNS) and fields[-1] in ("yes", "no")
