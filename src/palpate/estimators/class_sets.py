"""Classes: their part of a card, and the prediction set of one frame.

The model gives an output for each class, which was 1 in rows of that class and 0 in others when it learnt. A
class is in the set where its output reaches the class's own threshold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from palpate.core import Bool, ClassReading, Float
from palpate.core.refusal import NONE, ReasonCode, Refusal
from palpate.estimators.card_ground import CardPart

ClassOutputs = Float[np.ndarray, "n k"]
Members = Bool[np.ndarray, "n k"]


class ClassCoverageCard(CardPart):
    """How often sets held the true class in held-out rows of one class.

    Attributes:
        rows, groups: of the class.
        covered: rows whose set held it; thresholds were set without the row's own group.
        low, high: 95 % interval of the share covered, groups counted as groups.
        p: probability of so few, or fewer, where 5 % less than was promised is covered, groups counted.
    """

    rows: int
    groups: int
    covered: int
    low: float
    high: float
    p: float


class ClassScoreCard(CardPart):
    """Scores of a label of classes on held-out rows.

    Attributes:
        n: rows scored.
        accuracy: share of rows whose likeliest class was the true one.
        accuracy_low, accuracy_high: 95 % interval of that share, groups counted as groups.
        baseline: the same share if the most frequent class of all rows learnt from is always said.
        confusion: rows, by the true class and then by the likeliest one.
        coverage: of each class.
        set_size: mean number of classes in the set.
        empty, whole: share of rows whose set was empty, and held all classes.
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
        """True if no more is right than by always saying the most frequent class, as far as rows tell."""
        return self.accuracy_low <= self.baseline


class ClassCard(CardPart):
    """A label of classes: what they are called, how sets are made, how they scored.

    Attributes:
        column: the label column; the readings' key.
        values: the classes as the labels have them, in the order of the model's outputs.
        names: what they are called.
        thresholds: least output with which each class is in the set; None where its groups are too few to set
            one, so that it is in every set.
        groups: held-out groups of each class.
        most_frequent: the class that the baseline says.
        score: on held-out folds.
        findings: what cannot be promised, in sentences.
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
    """Number of outputs that a model has for classes, behind those for its targets."""
    return sum(len(card.names) for card in cards or ())


def class_parts(sizes: Sequence[int]) -> Iterator[slice]:
    """Which of the outputs for classes belong to each label, from the number of its classes.

    Example:
        >>> list(class_parts([2, 3]))
        [slice(0, 2, None), slice(2, 5, None)]
    """
    start = 0
    for size in sizes:
        yield slice(start, start + size)
        start += size


def members_of(outputs: ClassOutputs, thresholds: Sequence[float | None]) -> Members:
    """Tell which classes are in each row's set."""
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
    """Readings of one frame by the label columns.

    Args:
        cards: of the labels.
        outputs: the model's for all classes, of one row; None where nothing was read.
        why: reason not to use anything of this frame; false where there is none.
        common: what every reading of the frame carries.
    """
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
    """Reason not to trust a class; false where there is none."""
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
