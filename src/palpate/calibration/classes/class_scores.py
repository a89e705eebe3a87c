"""Scores of classes: how many are right beside the most frequent class, and how often sets hold each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from palpate.calibration.classes.class_labels import SEPARATOR, known_codes
from palpate.calibration.coverage.grouped_rates import grouped_coverage_interval
from palpate.calibration.coverage.range_scores import MARGIN, chance_of_so_few, failing
from palpate.core import Bool, Indices
from palpate.estimators.class_sets import ClassCard, ClassCoverageCard, ClassScoreCard, Members


@dataclass(frozen=True, slots=True)
class ClassAnswers:
    """Classes and sets of some rows, beside the truth.

    Attributes:
        true, likeliest: codes ``[n]``.
        members: which classes are in each set ``[n k]``.
        groups: label of each row's group ``[n]``; rows of one group are not independent.
        baseline: where the most frequent class of the rows learnt from is the true one ``[n]``.
    """

    true: Indices
    likeliest: Indices
    members: Members
    groups: np.ndarray
    baseline: Bool[np.ndarray, " n"]


def class_score(answers: ClassAnswers, coverage: float) -> ClassScoreCard:
    """Score one column of classes, whose sets promise this coverage."""
    right, (_, k) = answers.likeliest == answers.true, answers.members.shape
    low, high = grouped_coverage_interval(right, answers.groups)
    confusion = np.zeros((k, k), np.int64)
    np.add.at(confusion, (answers.true, answers.likeliest), 1)
    sizes = answers.members.sum(axis=1)
    return ClassScoreCard(
        n=len(right),
        accuracy=float(right.mean()),
        accuracy_low=low,
        accuracy_high=high,
        baseline=float(answers.baseline.mean()),
        confusion=tuple(tuple(map(int, row)) for row in confusion),
        coverage=tuple(_coverage(answers, one, coverage) for one in range(k)),
        set_size=float(sizes.mean()),
        empty=float(np.mean(sizes == 0)),
        whole=float(np.mean(sizes == k)),
    )


def _coverage(answers: ClassAnswers, one: int, coverage: float) -> ClassCoverageCard:
    rows = answers.true == one
    inside, groups = answers.members[rows, one], answers.groups[rows]
    low, high = grouped_coverage_interval(inside, groups) if rows.any() else (0.0, 1.0)
    return ClassCoverageCard(
        rows=int(rows.sum()),
        groups=len(np.unique(groups)),
        covered=int(inside.sum()),
        low=low,
        high=high,
        p=chance_of_so_few(inside, groups, coverage - MARGIN) if rows.any() else 1.0,
    )


def class_findings(card: ClassCard, score: ClassScoreCard, coverage: float) -> tuple[str, ...]:
    """Sentences on what cannot be relied on.

    Args:
        card: of the column.
        score: its own, or that of another run.
        coverage: that the sets promise.
    """
    found = []
    if score.says_nothing:
        found.append(
            f"{card.column}: {100 * score.accuracy:.1f} % right (95 % interval "
            f"{100 * score.accuracy_low:.1f} to {100 * score.accuracy_high:.1f} %), which these rows do not "
            f"tell from the {100 * score.baseline:.1f} % of always saying {card.most_frequent}"
        )
    failed = failing(score.coverage)
    for name, one in zip(card.names, score.coverage, strict=True):
        if one in failed:
            found.append(
                f"{card.column}: sets held {name} in {one.covered} of {one.rows} of its rows, where "
                f"{100 * coverage:g} % was promised"
            )
    return tuple(found)


def score_of_run(
    card: ClassCard, table: pd.DataFrame, groups: np.ndarray, coverage: float, source: str
) -> ClassScoreCard:
    """Score a column of classes of another run.

    Args:
        card: of the column.
        table: its labels, ``estimate:COLUMN`` and ``set:COLUMN``, a row a frame that was read.
        groups: label of each row's group.
        coverage: that the sets promise.
        source: what the labels came from, for messages.

    Raises:
        LabelError: a row is of a class that was not calibrated.
    """
    true = known_codes(table, card.column, card.values, source)
    likeliest = np.array([card.names.index(name) for name in table[f"estimate:{card.column}"]])
    sets = [set(text.split(SEPARATOR)) for text in table[f"set:{card.column}"]]
    members = np.array([[name in one for name in card.names] for one in sets])
    baseline = true == card.names.index(card.most_frequent)
    return class_score(ClassAnswers(true, likeliest, members, groups, baseline), coverage)
