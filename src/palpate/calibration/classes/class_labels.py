"""Label columns of classes or counts, and the outputs that a model learns of them.

Each class is an output, 1 in its rows and 0 in others; its least squares estimate is the class probability
(C. M. Bishop, Pattern Recognition and Machine Learning, Springer 2006, section 4.1.3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from palpate.core import Bool, Float, Indices, LabelError, Values
from palpate.estimators.class_sets import ClassCard, ClassOutputs, Members, class_parts
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
