"""Prediction sets that cover the true class at the stated rate in each class by itself, and their scores.

Label-conditional conformal prediction: V. Vovk, A. Gammerman and G. Shafer, Algorithmic Learning in a Random
World, Springer 2005, doi:10.1007/b106715; score: M. Sadinle, J. Lei and L. Wasserman, J. Am. Stat. Assoc.
114, 223 (2019), doi:10.1080/01621459.2017.1395341. A class with too few groups is in every set.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
import pandas as pd

from palpate.calibration.classes.class_labels import SEPARATOR, ClassLabels, HeldOutClasses, known_codes
from palpate.calibration.coverage.grouped_rates import (
    grouped_coverage_interval,
    is_distribution_free,
    new_group_quantile,
)
from palpate.calibration.coverage.range_scores import MARGIN, chance_of_so_few, failing
from palpate.core import Bool, Float, Indices, SplitError
from palpate.estimators.class_sets import (
    ClassCard,
    ClassCoverageCard,
    ClassOutputs,
    ClassScoreCard,
    Members,
    class_parts,
    members_of,
)
from palpate.recordings import Split

MAX_PARTS = 50  # leave-out parts of the groups: a fiftieth hardly moves a threshold


def fit_thresholds(
    outputs: ClassOutputs, codes: Indices, groups: np.ndarray, coverage: float
) -> tuple[float | None, ...]:
    """Return the least output of each class with which it is in the set; None with too few groups.

    Args:
        outputs: of models that had not seen the row's group.
        codes: class of each row ``[n]``.
        groups: group of each row ``[n]``.
        coverage: rate at which sets contain the true class, 0 to 1.
    """
    return tuple(
        _threshold(1 - outputs[codes == k, k], groups[codes == k], coverage) for k in range(outputs.shape[1])
    )


def _threshold(scores: Float[np.ndarray, " n"], groups: np.ndarray, coverage: float) -> float | None:
    if not is_distribution_free(len(np.unique(groups)), coverage):
        return None
    return 1 - new_group_quantile(scores, groups, coverage)


def members_without_own_group(
    outputs: ClassOutputs, codes: Indices, groups: np.ndarray, coverage: float
) -> Members:
    """Return the sets of held-out rows by thresholds fitted without the row's own group."""
    from sklearn.model_selection import GroupKFold  # here, since who evaluates needs no scikit-learn

    members = np.empty(outputs.shape, bool)
    parts = min(MAX_PARTS, len(np.unique(groups)))
    for rest, held in GroupKFold(parts).split(outputs, groups=groups):
        thresholds = fit_thresholds(outputs[rest], codes[rest], groups[rest], coverage)
        members[held] = members_of(outputs[held], thresholds)
    return members


def held_out_classes(
    labels: tuple[ClassLabels, ...], outputs: ClassOutputs, groups: np.ndarray, coverage: float
) -> HeldOutClasses:
    """Return sets and scores of class columns.

    Args:
        outputs: held-out outputs for all classes ``[n k]``; NaN where not scored.
        groups: group of each row ``[n]``.
    """
    scored = np.flatnonzero(~np.isnan(outputs).any(axis=1))
    cards, sets = [], []
    for one, part in zip(labels, class_parts([len(one.names) for one in labels]), strict=True):
        given = (outputs[scored, part], one.codes[scored], groups[scored], coverage)
        members = members_without_own_group(*given)
        baseline = given[1] == _most_frequent(one.codes)
        answers = ClassAnswers(given[1], np.argmax(given[0], axis=1), members, given[2], baseline)
        cards.append(_card(one, fit_thresholds(*given), answers, coverage))
        sets.append(members)
    return HeldOutClasses(labels, outputs, tuple(cards), tuple(sets))


def check_learnable(labels: tuple[ClassLabels, ...], parts: Split) -> None:
    """Refuse a split that holds out every class whole."""
    if parts.groups is None:
        return
    for one in labels:
        groups = [len(np.unique(parts.groups[one.codes == k])) for k in range(len(one.values))]
        if max(groups) < 2:
            raise SplitError(
                f"split {parts.kind} holds out each class of {one.column!r} whole, so that none was "
                "learnt when it is asked for; record each class in several groups, or split by what repeats "
                "within a class, as in --split group:press",
                code="class-held-out",
            )


def _most_frequent(codes: Indices) -> int:
    return int(np.argmax(np.bincount(codes)))


def _card(
    one: ClassLabels, thresholds: tuple[float | None, ...], answers: ClassAnswers, coverage: float
) -> ClassCard:
    score = class_score(answers, coverage)
    groups = tuple(part.groups for part in score.coverage)
    card = ClassCard(
        column=one.column,
        values=one.values,
        names=one.names,
        thresholds=thresholds,
        groups=groups,
        most_frequent=one.names[_most_frequent(one.codes)],
        score=score,
        findings=(),
    )
    findings = (*_unpromised(card, coverage), *class_findings(card, score, coverage))
    return card.model_copy(update={"findings": findings})


def _unpromised(card: ClassCard, coverage: float) -> Iterator[str]:
    few = [
        f"{name} ({groups})"
        for name, least, groups in zip(card.names, card.thresholds, card.groups, strict=True)
        if least is None
    ]
    if few:
        needed = next(n for n in count(1) if is_distribution_free(n, coverage))
        yield (
            f"{card.column}: too few held-out groups to rule a class out, {needed} or more are needed to "
            f"promise {100 * coverage:g} %: {', '.join(few)}; "
            f"{'they are' if len(few) > 1 else 'it is'} in every set, whatever the frame shows"
        )


@dataclass(frozen=True, slots=True)
class ClassAnswers:
    """Classes and sets of some rows with their ground truth.

    Attributes:
        true, likeliest: codes ``[n]``.
        members: classes in each set ``[n k]``.
        groups: group of each row ``[n]``.
        baseline: where the most frequent training class is the true one ``[n]``.
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
    """Return sentences on what cannot be relied on."""
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
    """Score a class column of another run.

    Args:
        table: labels, ``estimate:COLUMN`` and ``set:COLUMN``, one row per frame.
        source: name of the labels in messages.
    """
    true = known_codes(table, card.column, card.values, source)
    likeliest = np.array([card.names.index(name) for name in table[f"estimate:{card.column}"]])
    sets = [set(text.split(SEPARATOR)) for text in table[f"set:{card.column}"]]
    members = np.array([[name in one for name in card.names] for one in sets])
    baseline = true == card.names.index(card.most_frequent)
    return class_score(ClassAnswers(true, likeliest, members, groups, baseline), coverage)
