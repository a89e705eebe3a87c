"""Stimuli and judgments of an experiment: the tables that the runner and the analysis share.

``stimuli.csv`` has one row per stimulus; ``responses.csv`` one row per judgment. ``presented`` lists names in
the order of presentation, separated by blanks; ``answer`` is the softer one, or a ranking from the least soft
to the softest. The correct answer follows from the stimuli alone.

Gaussian observer that ranks stimuli or names the softer of two.

Percepts are positions plus independent unit-variance noise; a pair d apart is correct with Phi(d / sqrt 2).
The probability of rank j is an integral of a Poisson binomial law,

    M_ij = E_x [ P(exactly j - 1 of the others lie below x) ],   x ~ N(place_i, 1),

by Gauss-Hermite quadrature. Lapses (random rankings) and reversals (order reversed) can be mixed in.

Reference: L. L. Thurstone, Psychol. Rev. 34 (1927) 273, doi:10.1037/h0070288.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from scipy import special

from palpate.core import Float, InputError, Int, LabelError, RangeError, ndarray, new_file, storage_errors
from palpate.core.parsing import parser

RESPONSES, STIMULI, PARTICIPANT_RECORD = "responses.csv", "stimuli.csv", "participant.json"
RESPONSE_COLUMNS = (
    "participant", "condition", "presentation", "task", "block", "trial", "presented", "answer", "seconds",
    "when",
)  # fmt: skip
STIMULUS_COLUMNS = ("stimulus", "level", "unit", "softer")
CODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}\Z")
CODE_SAID = "letters, digits, - and _, 1 to 32 of them, beginning with a letter or digit"


class Condition(StrEnum):
    """Which cues a participant has: both, the kinesthetic alone, or the cutaneous alone."""

    INTEGRATED = "I"
    KINESTHETIC = "K"
    CUTANEOUS = "C"


CUES = {
    Condition.INTEGRATED: "both cues",
    Condition.KINESTHETIC: "the arm alone",
    Condition.CUTANEOUS: "the skin alone",
}
"""Conditions in words, for whoever has not the letters at hand."""


class Presentation(StrEnum):
    """How a stimulus is presented: a specimen under the finger itself, or rendered by a display."""

    DIRECT = "direct"
    RENDERED = "rendered"


class Task(StrEnum):
    """What is asked: which of two is softer, or the order of all."""

    PAIR = "pair"
    RANK = "rank"


def checked_code(word: str, what: str) -> str:
    """A participant's or stimulus's code; never a name, a path, or anything that would be one."""
    if not CODE.match(word):
        raise InputError(
            f"{what} {word!r}: {CODE_SAID} are allowed, and no person's name; give a code such as P01",
            code="participant-code",
        )
    return word


@dataclass(frozen=True, slots=True)
class Stimulus:
    """One stimulus; `softer` is +1 where a greater level is softer, -1 where it is harder."""

    name: str
    level: float
    softer: int
    unit: str = ""

    def __post_init__(self) -> None:
        checked_code(self.name, "stimulus")
        if not math.isfinite(self.level):
            raise RangeError(f"stimulus {self.name}: a level of {self.level}; give a finite one")
        if self.softer not in (1, -1):
            raise InputError(
                f"stimulus {self.name}: softer is {self.softer}; 1 (with the level) or -1 (against it)"
            )

    @property
    def softness(self) -> float:
        """The level, turned so that it rises with softness."""
        return self.softer * self.level


@dataclass(frozen=True, slots=True)
class Judgement:
    """One answer of one participant.

    Attributes:
        block, trial: counted from 1; unique with participant, condition, presentation, and task.
        presented: stimuli in the order of presentation.
        answer: the softer stimulus; of a ranking all, from the least soft to the softest.
        seconds: response time [s]; NaN if not measured.
        when: ISO 8601 time, or "".
    """

    participant: str
    condition: Condition
    presentation: Presentation
    task: Task
    block: int
    trial: int
    presented: tuple[str, ...]
    answer: tuple[str, ...]
    seconds: float = math.nan
    when: str = ""

    def __post_init__(self) -> None:
        checked_code(self.participant, "participant")
        if self.block < 1 or self.trial < 1:
            raise InputError(f"{self.said}: block and trial count from 1")
        if not (math.isnan(self.seconds) or 0 <= self.seconds < math.inf):
            raise RangeError(
                f"{self.said}: {self.seconds:g} s to the answer; 0 or more, or nothing, is allowed",
                code="response-time",
            )
        if len(set(self.presented)) != len(self.presented) or len(self.presented) < 2:
            raise InputError(
                f"{self.said}: presented {' '.join(self.presented)!r}; two or more different stimuli are "
                "needed"
            )
        if self.task is Task.PAIR and (
            len(self.presented) != 2 or len(self.answer) != 1 or self.answer[0] not in self.presented
        ):
            raise InputError(
                f"{self.said}: answer {' '.join(self.answer)!r} to the pair {' '.join(self.presented)!r}; "
                "one of the two is needed",
                code="answer-unknown",
            )
        if self.task is Task.RANK and sorted(self.answer) != sorted(self.presented):
            raise InputError(
                f"{self.said}: answer {' '.join(self.answer)!r} is no order of {' '.join(self.presented)!r}; "
                "each has to stand in it once",
                code="not-a-permutation",
            )

    @property
    def key(self) -> tuple[str, str, str, str, int, int]:
        """What no second judgement may have."""
        return (self.participant, self.condition, self.presentation, self.task, self.block, self.trial)

    @property
    def said(self) -> str:
        """The judgement's place in words, for messages."""
        given = f"{self.condition} {self.presentation} {self.task}"
        return f"participant {self.participant}, {given}, block {self.block}, trial {self.trial}"

    def right(self, stimuli: Mapping[str, Stimulus]) -> bool:
        """Whether the softer of a pair was named; of a ranking, whether all of it is right."""
        return self.answer == self.truth(stimuli)

    def truth(self, stimuli: Mapping[str, Stimulus]) -> tuple[str, ...]:
        """The right answer, from the stimuli alone."""
        unknown = [one for one in self.presented if one not in stimuli]
        if unknown:
            raise InputError(
                f"{self.said}: {', '.join(unknown)} not among the stimuli {', '.join(stimuli)}",
                code="stimulus-unknown",
            )
        order = sorted(self.presented, key=lambda one: stimuli[one].softness)
        softness = [stimuli[one].softness for one in order]
        if len(set(softness)) < len(softness):
            raise InputError(
                f"{self.said}: two stimuli of one softness have no right answer", code="equal-levels"
            )
        return (order[-1],) if self.task is Task.PAIR else tuple(order)


def checked_judgements(judgements: Iterable[Judgement]) -> tuple[Judgement, ...]:
    """Judgements, none of them twice."""
    seen: dict[tuple[str, str, str, str, int, int], Judgement] = {}
    for one in judgements:
        if one.key in seen:
            raise LabelError(f"{one.said} stands twice in the table; leave the wrong one out")
        seen[one.key] = one
    return tuple(seen.values())


@parser("table of judgments", InputError)
def read_judgements(path: Path, unanswered: list[str] | None = None) -> tuple[Judgement, ...]:
    """Read a table, or all ``*/responses.csv`` in a folder.

    Args:
        unanswered: receives a line per row without an answer; without the list such a row is rejected.
    """
    if path.is_dir():
        tables = [path / RESPONSES] if (path / RESPONSES).is_file() else sorted(path.glob(f"*/{RESPONSES}"))
        if not tables:
            raise LabelError(f"{path} holds no {RESPONSES}, nor do the folders in it", code="file-missing")
        return checked_judgements(one for table in tables for one in read_judgements(table, unanswered))
    judgements = []
    for i, row in enumerate(_rows(path, RESPONSE_COLUMNS), start=1):
        if unanswered is not None and not row["answer"].strip():
            unanswered.append(f"{path}, row {i}: participant {row['participant']} gave no answer")
            continue
        try:
            judgements.append(_judgement(row))
        except (ValueError, InputError) as e:
            raise LabelError(f"{path}, row {i}: {e}", code="table-row") from e
    return checked_judgements(judgements)


@parser("rehearsal record", InputError)
def is_rehearsal(folder: Path) -> bool:
    """Whether answers in a folder are simulated: it is called so, or a record or a row of a table says it."""
    records = [folder / PARTICIPANT_RECORD, *sorted(folder.glob(f"*/{PARTICIPANT_RECORD}"))]
    try:
        told = [json.loads(path.read_text(encoding="utf-8")) for path in records if path.is_file()]
    except (OSError, ValueError) as e:
        raise LabelError(f"{folder} holds a {PARTICIPANT_RECORD} that cannot be read: {e}") from e
    recorded = any(isinstance(one, dict) and one.get("simulated") is True for one in told)
    tables = [path for path in (folder / RESPONSES, *folder.glob(f"*/{RESPONSES}")) if path.is_file()]
    return (
        folder.resolve().name == "rehearsal"
        or recorded
        or any(row.get("simulated") == "yes" for path in tables for row in _rows(path, RESPONSE_COLUMNS))
    )


def _judgement(row: Mapping[str, str]) -> Judgement:
    return Judgement(
        row["participant"], Condition(row["condition"]), Presentation(row["presentation"]), Task(row["task"]),
        int(row["block"]), int(row["trial"]), tuple(row["presented"].split()), tuple(row["answer"].split()),
        float(row["seconds"]) if row["seconds"] else math.nan, row["when"],
    )  # fmt: skip


def judgement_row(one: Judgement) -> dict[str, str]:
    """A judgement as the table has it."""
    return {
        "participant": one.participant, "condition": one.condition.value,
        "presentation": one.presentation.value, "task": one.task.value,
        "block": str(one.block), "trial": str(one.trial),
        "presented": " ".join(one.presented), "answer": " ".join(one.answer),
        "seconds": "" if math.isnan(one.seconds) else f"{one.seconds:.3f}", "when": one.when,
    }  # fmt: skip


@parser("table of stimuli", InputError)
def read_stimuli(path: Path) -> dict[str, Stimulus]:
    """The stimuli of a table, or of ``stimuli.csv`` in a folder, by name."""
    table = path / STIMULI if path.is_dir() else path
    stimuli: dict[str, Stimulus] = {}
    for i, row in enumerate(_rows(table, STIMULUS_COLUMNS), start=1):
        try:
            one = Stimulus(row["stimulus"], _with_point(row["level"]), int(row["softer"]), row["unit"])
        except (ValueError, InputError) as e:
            raise LabelError(f"{table}, row {i}: {e}", code="table-number") from e
        if one.name in stimuli:
            raise LabelError(f"{table}, row {i}: {one.name} stands twice")
        stimuli[one.name] = one
    if len({one.softer for one in stimuli.values()}) > 1:
        raise LabelError(f"{table}: softer has to be the same in all rows")
    if len({one.unit for one in stimuli.values()}) > 1:
        raise LabelError(f"{table}: levels have several units; give one")
    return stimuli


def write_stimuli(path: Path, stimuli: Iterable[Stimulus]) -> None:
    """Write a new table, whole or not at all."""
    rows = (
        {"stimulus": one.name, "level": f"{one.level:.12g}", "unit": one.unit, "softer": str(one.softer)}
        for one in stimuli
    )
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, STIMULUS_COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    with new_file(path) as part:
        part.write_text(text.getvalue(), encoding="utf-8")


def _with_point(word: str) -> float:
    if "," in word:
        raise InputError(f"level {word!r}; a number has a point, as 3.3, and no comma")
    return float(word)


def _rows(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    with storage_errors(path):
        data = path.read_bytes()
    try:
        reader = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
        rows = list(reader)
    except (UnicodeDecodeError, csv.Error) as e:
        raise LabelError(f"{path} is no table: {e}") from e
    missing = [name for name in columns if name not in (reader.fieldnames or ())]
    if missing and any(";" in name for name in reader.fieldnames or ()):
        raise LabelError(
            f"{path} has semicolons between its columns; save it with commas there, and points in numbers",
            code="table-separator",
        )
    if missing:
        raise LabelError(f"{path} has no column {', '.join(missing)}; it needs {', '.join(columns)}")
    for i, row in enumerate(rows, start=1):
        if None in row or any(row[name] is None for name in columns):
            raise LabelError(
                f"{path}, row {i}: {len(columns)} columns are needed; a number has a point, as 3.3, no comma",
                code="table-columns",
            )
    return rows


NODES_OF_PERCEPT = 80
MATRIX_ERROR = 1e-6  # of an element, for stimuli up to 4 standard deviations apart; tested

RankMatrix = Float[ndarray, "m m"]


@dataclass(frozen=True)
class RankObserver:
    """Observer of stimuli at `places` (least soft first, in noise SD) with rates of lapses and reversals."""

    places: tuple[float, ...]
    lapse: float = 0.0
    reversal: float = 0.0

    def __post_init__(self) -> None:
        if len(self.places) < 2:
            raise InputError(
                f"{len(self.places)} places; an observer ranks two stimuli or more", code="too-few-stimuli"
            )
        if not np.isfinite(self.places).all():
            raise RangeError("a place that is not finite; places are in standard deviations of the noise")
        if min(self.lapse, self.reversal) < 0 or self.lapse + self.reversal > 1:
            raise RangeError(
                f"lapses of {self.lapse:g} and reversals of {self.reversal:g}; each is 0 or more, and "
                "together they are 1 at most",
                code="lapse-and-reversal",
            )

    @classmethod
    def evenly(
        cls, sensitivity: float, stimuli: int = 5, lapse: float = 0.0, reversal: float = 0.0
    ) -> RankObserver:
        """Return an observer of equidistant stimuli, `sensitivity` (d') apart."""
        return cls(tuple(sensitivity * i for i in range(stimuli)), lapse, reversal)

    def rank_matrix(self) -> RankMatrix:
        """Probability of each rank (column) for each stimulus (row), to `MATRIX_ERROR`."""
        return mixed_matrix(gaussian_matrix(self.places), self.lapse, self.reversal)

    def total_accuracy(self) -> float:
        """Expected share of right places in rankings."""
        return float(np.trace(self.rank_matrix()) / len(self.places))

    def pair_accuracy(self, one: int, other: int) -> float:
        """Probability of naming the softer of two stimuli, by their numbers from 0."""
        low, high = sorted((one, other))
        p = float(special.ndtr((self.places[high] - self.places[low]) / math.sqrt(2)))
        return (1 - self.lapse - self.reversal) * p + self.reversal * (1 - p) + self.lapse / 2

    def drawn_places(self, rankings: int, rng: np.random.Generator) -> Int[ndarray, "n m"]:
        """Places given to the stimuli in so many simulated rankings, from 0."""
        m = len(self.places)
        percept = np.array(self.places) + rng.standard_normal((rankings, m))
        u = rng.random((rankings, 1))
        percept = np.where(u < self.reversal, -percept, percept)
        percept = np.where(u >= 1 - self.lapse, rng.standard_normal((rankings, m)), percept)
        return np.argsort(np.argsort(percept, axis=1), axis=1)


def gaussian_matrix(places: Sequence[float] | ndarray) -> Float[ndarray, "*sets m m"]:
    """Rank matrix of Gaussian percepts, without faults; of many rows of places at once, one each."""
    at = np.asarray(places, np.float64)
    m = at.shape[-1]
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES_OF_PERCEPT)
    below = special.ndtr(
        at[..., None, None] + nodes[:, None] - at[..., None, None, :]
    )  # stimulus, node, other
    count = np.zeros((*at.shape, m, len(nodes)))
    count[..., 0, :] = 1.0
    for k in range(m):
        p = below[..., k].copy()
        p[..., k, :] = 0.0  # a stimulus is none of its others
        p = p[..., None, :]
        count[..., 1:, :] = count[..., 1:, :] * (1 - p) + count[..., :-1, :] * p
        count[..., :1, :] *= 1 - p
    return np.asarray(count @ (weights / weights.sum()))


def mixed_matrix(
    matrix: Float[ndarray, "*sets m m"], lapse: float | ndarray, reversal: float | ndarray
) -> Float[ndarray, "*sets m m"]:
    """A rank matrix with lapses and reversals mixed in."""
    return (1 - lapse - reversal) * matrix + reversal * matrix[..., ::-1] + lapse / matrix.shape[-1]
