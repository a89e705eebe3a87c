"""Label columns of classes or counts, and the outputs that a model learns of them.

Each class is an output, 1 in its rows and 0 in others; its least squares estimate is the class probability
(C. M. Bishop, Pattern Recognition and Machine Learning, Springer 2006, section 4.1.3).

Prediction sets that cover the true class at the stated rate in each class by itself, and their scores.

Label-conditional conformal prediction: V. Vovk, A. Gammerman and G. Shafer, Algorithmic Learning in a Random
World, Springer 2005, doi:10.1007/b106715; score: M. Sadinle, J. Lei and L. Wasserman, J. Am. Stat. Assoc.
114, 223 (2019), doi:10.1080/01621459.2017.1395341. A class with too few groups is in every set.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
import pandas as pd

from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.coverage.grouped_rates import (
    grouped_coverage_interval,
    is_distribution_free,
    new_group_quantile,
)
from palpate.calibration.coverage.range_scores import MARGIN, chance_of_so_few, failing
from palpate.core import Bool, Float, Indices, LabelError, SplitError, Values
from palpate.estimators.class_sets import (
    ClassCard,
    ClassCoverageCard,
    ClassOutputs,
    ClassScoreCard,
    Members,
    Outputs,
    class_parts,
    members_of,
)
from palpate.recordings import Split
from palpate.recordings.label_tables import label_kinds, rows_text, targets_from

MAX_CLASSES = 20  # more distinct values are a quantity, or names of rows


@dataclass(frozen=True, slots=True)
class ClassLabels:
    """Classes of some rows.

    Attributes:
        values: classes as labeled: numbers ascending, texts in alphabetic order.
        codes: index of each row's class ``[n]``.
    """

    column: str
    values: tuple[str, ...]
    names: tuple[str, ...]
    codes: Indices

    @property
    def one_hot(self) -> Float[np.ndarray, "n k"]:
        return np.eye(len(self.values))[self.codes]

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of these outputs, each a quantity and its unit as a target's is."""
        return tuple(f"{self.column}_{name}_ratio" for name in self.names)


@dataclass(frozen=True, slots=True)
class HeldOutClasses:
    """Class labels with held-out outputs and prediction sets.

    Attributes:
        outputs: for all classes ``[n k]``; NaN for rows not scored.
        members: for each column, classes in the sets of the scored rows ``[m k]``.
    """

    labels: tuple[ClassLabels, ...]
    outputs: ClassOutputs
    cards: tuple[ClassCard, ...]
    members: tuple[Bool[np.ndarray, "m _"], ...]

    @property
    def parts(self) -> list[Float[np.ndarray, "n _"]]:
        return [self.outputs[:, part] for part in class_parts([len(one.names) for one in self.labels])]

    def shortfalls(self, rows: Indices) -> Float[np.ndarray, " m"]:
        """By how much the true classes' outputs fall short of 1 in some rows, at most over the columns."""
        each = [1 - part[rows, one.codes[rows]] for one, part in zip(self.labels, self.parts, strict=True)]
        return np.max(each, axis=0)

    def with_answers(self, table: pd.DataFrame, rows: Indices) -> pd.DataFrame:
        """A table of the scored rows with ``estimate:COLUMN``, ``set:COLUMN`` and ``output:COLUMN=CLASS``."""
        more: dict[str, np.ndarray | list[str]] = {}
        for one, part, members in zip(self.labels, self.parts, self.members, strict=True):
            more[f"estimate:{one.column}"] = np.array(one.names)[np.argmax(part[rows], axis=1)]
            more[f"set:{one.column}"] = set_text(one.names, members)
            more |= {f"output:{one.column}={n}": v for n, v in zip(one.names, part[rows].T, strict=True)}
        return table.assign(**more)


MAX_EXACT = 2.0**53
SEPARATOR = "|"  # between the names in a set, in tables


def set_text(names: Sequence[str], members: Members) -> list[str]:
    """Return the names of the classes in each row's set, for a table."""
    return [SEPARATOR.join(np.array(names)[row]) for row in members]


def class_labels(
    table: pd.DataFrame, asked: Mapping[str, tuple[str, ...]], source: str, *, hint: str = ""
) -> tuple[ClassLabels, ...]:
    """Take class columns from a table of labels.

    Args:
        asked: for each column the names of its classes in order; none for the values.
        source: name of the table in messages.
        hint: alternative to offer where only one class is there.
    """
    return tuple(_class_labels(table, column, names, source, hint) for column, names in asked.items())


def _class_labels(
    table: pd.DataFrame, column: str, names: tuple[str, ...], source: str, hint: str
) -> ClassLabels:
    cells = _cells(table, column, source)
    found = pd.unique(cells)
    values = sorted(found.tolist(), key=_place)
    if len(values) > MAX_CLASSES:
        raise LabelError(
            f"{source}: {column!r} holds {len(values)} distinct values in {len(cells)} rows; classes are "
            f"{MAX_CLASSES} at most: calibrate a quantity as a target, or label what it shall be told as",
            code="many-classes",
        )
    if len(values) < 2:
        raise LabelError(
            f"{source}: {column!r} is {values[0]} in every row: one class alone can be told from nothing"
            f"{hint}; record the others too",
            code="one-class",
        )
    if alike := _written_alike(values):
        raise LabelError(
            f"{source}: {column!r} holds {alike[0]!r} and {alike[1]!r}, which look like one class written in "
            "two ways; write it in one way",
            code="class-spelling",
        )
    values, names = _in_order(values, names, f"{source}: {column!r}")
    if odd := [name for name in names or values if SEPARATOR in name]:
        raise LabelError(
            f"{source}: {column!r} holds {odd[0]!r}, and {SEPARATOR} stands between the classes of a set; "
            "name them, as in --classes grade=soft/hard",
            code="class-names",
        )
    codes = pd.Categorical(cells, categories=values).codes.astype(np.int64)
    return ClassLabels(column, tuple(values), names or tuple(values), codes)


def _in_order(values: list[str], names: tuple[str, ...], column: str) -> tuple[list[str], tuple[str, ...]]:
    """Values in the order of the outputs, and their names.

    Names given for texts order them, so that no class is called as another one is labeled.
    """
    if not names:
        return values, names
    if sorted(names) == sorted(values):
        return list(names), names
    if not all(_is_number_or_flag(value) for value in values):
        raise LabelError(
            f"{column} is labelled {', '.join(values)}, and texts are called as they are labelled: leave the "
            f"names out, or give these in the order wanted ({', '.join(names)} was asked)",
            code="class-names",
        )
    if len(names) != len(values):
        raise LabelError(
            f"{column}: {len(names)} names for the {len(values)} classes, which are {', '.join(values)}; "
            "name each, in this order",
            code="class-names",
        )
    return values, names


FLAGS = ("false", "true")


def _is_number_or_flag(value: str) -> bool:
    return value in FLAGS or _place(value)[0] < np.inf


MEANINGS = {"yes": "true", "no": "false", "1": "true", "0": "false"}


def _written_alike(values: Sequence[str]) -> tuple[str, str] | None:
    """Two values that differ in how they are written only; None where there are none."""
    folded = [value.strip().casefold() for value in values]
    if {"yes", "no", *FLAGS} & set(folded):
        folded = [MEANINGS.get(one, one) for one in folded]
    first: dict[str, str] = {}
    for value, one in zip(values, folded, strict=True):
        if one in first:
            return first[one], value
        first[one] = value
    return None


def known_codes(table: pd.DataFrame, column: str, values: Sequence[str], source: str) -> Indices:
    """Return the calibrated class of each row of another recording ``[n]``."""
    cells = _cells(table, column, source)
    if strangers := sorted(set(cells) - set(values), key=_place):
        count = int(np.isin(cells, strangers).sum())
        raise LabelError(
            f"{source}: {column!r} is {', '.join(strangers)} in {count} of {len(cells)} rows, which the "
            f"calibration does not know; it tells {', '.join(values)}. Leave these rows out, or calibrate on "
            "them too",
            code="unknown-class",
        )
    return np.asarray(pd.Categorical(cells, categories=list(values)).codes.astype(np.int64))


def _cells(table: pd.DataFrame, column: str, source: str) -> np.ndarray:
    """Texts of a column's cells, whole numbers without decimals ``[n]``."""
    if column not in table.columns:
        raise LabelError(
            f"{source} has no column {column!r} of classes; its label columns are "
            f"{', '.join(map(str, table.columns))}"
        )
    cells, kind = table[column], label_kinds(table[[column]])[column]
    gaps = np.flatnonzero((cells.isna() | (cells.astype(str) == "")).to_numpy())
    if gaps.size:
        raise LabelError(
            f"{source}: {column!r} names no class in {rows_text(gaps)}; fill these in, or remove the rows"
        )
    if kind != "number":
        return cells.astype(str).str.lower().to_numpy(str) if kind == "flag" else cells.to_numpy(str)
    numbers = cells.to_numpy(np.float64)
    if odd := [number for number in numbers if number != np.floor(number)]:
        raise LabelError(
            f"{source}: {column!r} holds {len(np.unique(numbers))} distinct values such as {odd[0]:g}: a "
            "quantity that runs on, and no class; calibrate it as a target (--targets), or number classes "
            "0, 1, 2",
            code="many-classes",
        )
    if np.abs(numbers).max(initial=0.0) > MAX_EXACT:
        raise LabelError(
            f"{source}: {column!r} holds {np.abs(numbers).max():.0f}; whole numbers beyond 2^53 cannot "
            "be told apart: write the classes as text"
        )
    return np.array([f"{number:.0f}" for number in numbers])


def _place(value: str) -> tuple[float, str]:
    """Key by which classes are sorted: numbers by their size, before texts."""
    try:
        return float(value), value
    except ValueError:
        return np.inf, value


def with_classes(values: Values, classes: Sequence[ClassLabels]) -> Float[np.ndarray, "n _"]:
    """Append the classes' outputs to columns of numbers ``[n t+k]``."""
    return np.column_stack([values, *(one.one_hot for one in classes)]) if classes else values


def target_values(
    table: pd.DataFrame, columns: Sequence[str], source: str, *, constant: bool = False
) -> Values:
    """Return targets from a table of labels ``[n t]``; no column where only classes are trained on."""
    return targets_from(table, columns, source, constant=constant) if columns else np.empty((len(table), 0))


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


def held_out_parts(
    labels: tuple[ClassLabels, ...],
    outputs: Float[np.ndarray, "n _"],
    groups: np.ndarray,
    plan: CalibrationPlan,
) -> tuple[Outputs, HeldOutClasses | None]:
    """Return the held-out outputs of the targets, and the class columns with sets and scores."""
    targets, classes = np.split(outputs, [plan.layout.outputs], axis=1)
    return targets, held_out_classes(labels, classes, groups, plan.coverage) if labels else None


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
