"""Classes: their part of a card, and the prediction set of one frame.

The model has one output for each class, trained to 1 for its rows and 0 for others. A class is in the set if
its output reaches the class's own threshold.

Targets and the model's outputs: one output for a plain target, cosine and sine for a circular one.

A periodic quantity jumps as a number, which a model cannot learn, but not as a point on the unit circle (C.
M. Bishop, Mixture density networks, 1994; K. V. Mardia and P. E. Jupp, Directional Statistics, 2000,
doi:10.1002/9780470316979).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from palpate.core import Bool, ClassReading, Float, UnitError, Values, split_column, unit
from palpate.core.reading import NONE, ReasonCode, Refusal
from palpate.estimators.card_ground import CardPart

ClassOutputs = Float[np.ndarray, "n k"]
Members = Bool[np.ndarray, "n k"]


class ClassCoverageCard(CardPart):
    """Coverage of the prediction sets in held-out rows of one class.

    Attributes:
        low, high: 95 % interval of the covered ratio, by groups.
        p: Probability of so few covered rows if the true coverage is 5 % below nominal, by groups.
    """

    rows: int
    groups: int
    covered: int
    low: float
    high: float
    p: float


class ClassScoreCard(CardPart):
    """Scores of a class label on held-out rows.

    Attributes:
        accuracy_low, accuracy_high: 95 % interval of the accuracy, by groups.
        baseline: Accuracy of always predicting the most frequent class.
        confusion: Rows by the true and then by the predicted class.
        set_size: Mean number of classes in the set.
        empty, whole: Ratios of rows whose set is empty or holds all classes.
    """

    n: int
    accuracy: float
    accuracy_low: float
    accuracy_high: float
    baseline: float
    confusion: tuple[tuple[int, ...], ...]
    coverage: tuple[ClassCoverageCard, ...]
    set_size: float
    empty: float
    whole: float

    @property
    def says_nothing(self) -> bool:
        """True if the accuracy is not significantly above the baseline."""
        return self.accuracy_low <= self.baseline


class ClassCard(CardPart):
    """Label of classes: names, thresholds of the sets, and scores.

    Attributes:
        column: Label column; the readings' key.
        values: Classes as the labels have them, in the order of the model's outputs.
        thresholds: Least output with which each class is in the set; None if it always is (too few groups).
        groups: Held-out groups of each class.
        findings: What cannot be promised, in sentences.
    """

    column: str
    values: tuple[str, ...] = Field(min_length=2)
    names: tuple[str, ...]
    thresholds: tuple[float | None, ...]
    groups: tuple[int, ...]
    most_frequent: str
    score: ClassScoreCard
    findings: tuple[str, ...]

    @model_validator(mode="after")
    def _parts_fit(self) -> ClassCard:
        k = len(self.values)
        if {len(self.names), len(self.thresholds), len(self.groups), len(self.score.confusion)} != {k}:
            raise ValueError(f"the {k} classes of {self.column} have parts of other lengths")
        if len(set(self.names)) < k or len(set(self.values)) < k or self.most_frequent not in self.names:
            raise ValueError(f"classes of {self.column} are called alike, or the most frequent is none")
        return self


def class_count(cards: Sequence[ClassCard] | None) -> int:
    """Return the number of class outputs, which follow the targets' outputs."""
    return sum(len(card.names) for card in cards or ())


def class_parts(sizes: Sequence[int]) -> Iterator[slice]:
    """Return the slice of the class outputs of each label, from its number of classes.

    Example:
        >>> list(class_parts([2, 3]))
        [slice(0, 2, None), slice(2, 5, None)]
    """
    start = 0
    for size in sizes:
        yield slice(start, start + size)
        start += size


def members_of(outputs: ClassOutputs, thresholds: Sequence[float | None]) -> Members:
    """Return which classes are in each row's prediction set."""
    return np.stack(
        [
            np.ones(len(outputs), bool) if least is None else column >= least
            for column, least in zip(outputs.T, thresholds, strict=True)
        ],
        axis=1,
    )


def class_readings(
    cards: Sequence[ClassCard], outputs: ClassOutputs | None, why: Refusal, **common: Any
) -> dict[str, ClassReading]:
    """Return readings of one frame by label column; `common` holds the fields that all share."""
    read = {}
    for card, part in zip(cards, class_parts([len(card.names) for card in cards]), strict=True):
        value, members = "", np.zeros(len(card.names), bool)
        one = None if outputs is None else outputs[:, part]
        if one is not None and np.isfinite(one).all():
            value, members = card.names[int(np.argmax(one))], members_of(one, card.thresholds)[0]
        named = tuple(name for name, inside in zip(card.names, members, strict=True) if inside)
        doubt = why or _doubt(card, value, named)
        read[card.column] = ClassReading(
            quantity=card.column, unit="", value=value, members=named, classes=card.names,
            valid=not doubt, why=doubt.why, code=doubt.code, **common,
        )  # fmt: skip
    return read


def _doubt(card: ClassCard, value: str, members: tuple[str, ...]) -> Refusal:
    if not members:
        why = f"not told: this frame is like no class of {card.column}, their set is empty"
        return Refusal(ReasonCode.NO_CLASS, why)
    if len(members) == len(card.names):
        why = f"not told: this frame leaves all classes of {card.column} open ({', '.join(members)})"
        return Refusal(ReasonCode.ALL_CLASSES, why)
    if value not in members:
        why = (
            f"not told: the likeliest class of {card.column}, {value}, is not in the set of those that "
            f"cannot be ruled out ({', '.join(members)})"
        )
        return Refusal(ReasonCode.CLASS_NOT_IN_SET, why)
    return NONE


Outputs = Float[np.ndarray, "n o"]
FULL_TURN = {"deg": 360.0, "rad": 2 * math.pi}


@dataclass(frozen=True, slots=True)
class TargetLayout:
    """Order of a model's outputs; periods are in the target's unit, None if not circular."""

    periods: tuple[float | None, ...]

    @property
    def plain(self) -> bool:
        return all(period is None for period in self.periods)

    @property
    def outputs(self) -> int:
        return sum(1 if period is None else 2 for period in self.periods)

    def outputs_of(self, j: int) -> slice:
        """Return the outputs of a target."""
        start = TargetLayout(self.periods[:j]).outputs
        return slice(start, start + (1 if self.periods[j] is None else 2))

    def names(self, columns: Sequence[str]) -> tuple[str, ...]:
        """Return the outputs' names: a plain column, or ``QUANTITY_cos_ratio`` and ``…_sin_ratio``."""
        named = zip(columns, self.periods, strict=True)
        return tuple(
            name for column, period in named for name in ((column,) if period is None else _point(column))
        )

    def encoded(self, values: Values) -> Outputs:
        """Return the outputs of a perfect model for these values."""
        if self.plain:
            return values
        columns = []
        for column, period in zip(values.T, self.periods, strict=True):
            if period is None:
                columns.append(column)
            else:
                angle = 2 * np.pi * column / period
                columns += [np.cos(angle), np.sin(angle)]
        return np.stack(columns, axis=1)

    def decoded(self, outputs: Outputs) -> Values:
        """Return the estimates; circular ones are above -period/2 and up to period/2."""
        if self.plain:
            return outputs
        columns = []
        for j, period in enumerate(self.periods):
            one = outputs[:, self.outputs_of(j)]
            turn = None if period is None else period / (2 * np.pi)
            columns.append(one[:, 0] if turn is None else np.arctan2(one[:, 1], one[:, 0]) * turn)
        return np.stack(columns, axis=1)

    def differences(self, estimates: Values, true: Values) -> Values:
        """Return estimates less truths, by the shortest way for circular targets."""
        difference = estimates - true
        for j, period in enumerate(self.periods):
            if period is not None:
                difference[:, j] = (difference[:, j] + period / 2) % period - period / 2
        return difference

    def spans(self, values: Values) -> Float[np.ndarray, " o"]:
        """Return the length of each output's range, 2 for a cosine or sine."""
        spans = np.ptp(self.encoded(values), axis=0)
        for j, period in enumerate(self.periods):
            if period is not None:
                spans[self.outputs_of(j)] = 2.0
        return spans


def _point(column: str) -> tuple[str, str]:
    quantity = split_column(column)[0]
    return f"{quantity}_cos_ratio", f"{quantity}_sin_ratio"


def default_period(symbol: str) -> float:
    """Return a full turn in a unit of angle."""
    unit(symbol)
    if symbol not in FULL_TURN:
        raise UnitError(
            f"a quantity in {symbol} has no default period; give --circular phase_{symbol}=PERIOD"
        )
    return FULL_TURN[symbol]
