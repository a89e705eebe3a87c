"""Which rows train and which are held out, so that a score says something about new presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from pandas.api.types import is_bool_dtype, is_numeric_dtype

from palpate.core.errors import SplitError
from palpate.recordings.labels import rows_text

# Coarsest first: a split by an earlier one also holds apart everything that a later one would.
CONVENTIONAL_GROUPS: tuple[tuple[str, ...], ...] = (
    ("object",),
    ("specimen",),
    ("sensor",),
    ("location",),
    ("x_mm", "y_mm"),
    ("row", "col"),
    ("row", "column"),
    ("press",),
    ("cycle",),
    ("trial",),
)
_KINDS = "'auto', 'random', 'group:COLUMN[,COLUMN...]' or 'leave-one-out:COLUMN[,COLUMN...]'"


@dataclass(frozen=True, slots=True)
class Split:
    """Rows of a table parted into folds, each held out once.

    Attributes:
        kind: as a person would type it, e.g. ``group:location``.
        group_columns: the columns whose values together name a group; empty for a random split.
        groups: name of the group of each row ``[n]``; None for a random split.
        folds: row indices held out in each fold; disjoint, together all rows.
        reason: why this kind, in words.
    """

    kind: str
    group_columns: tuple[str, ...]
    groups: np.ndarray | None
    folds: tuple[np.ndarray, ...]
    reason: str

    def training_rows(self, k: int) -> np.ndarray:
        """The rows that fold `k` trains on: all but those it holds out, in order."""
        rows: np.ndarray = np.sort(np.concatenate([fold for i, fold in enumerate(self.folds) if i != k]))
        return rows


def split(table: pd.DataFrame, spec: str, *, folds: int = 5, seed: int = 0) -> Split:
    """Part the rows of a table of labels into folds.

    Args:
        table: the labels, one row a frame.
        spec: ``auto`` (by the coarsest conventional group that is there, else random), ``random``,
            ``group:COL[,COL...]`` or ``leave-one-out:COL[,COL...]``.
        folds: how many, 2 or more; leave-one-out has one for each group.
        seed: of the shuffle.

    Raises:
        SplitError: the specification is not one of these, names an unknown column or one with gaps, or the
            table has too few rows or groups for it.

    Example:
        >>> table = pd.DataFrame({"press": ["a", "a", "b", "b"], "depth_mm": [1.0, 2.0, 1.0, 2.0]})
        >>> chosen = split(table, "auto", folds=2)
        >>> chosen.kind, [fold.tolist() for fold in chosen.folds]
        ('group:press', [[0, 1], [2, 3]])
    """
    if spec == "auto":
        return _automatic(table, folds, seed)
    rng = np.random.default_rng(seed)
    kind, _, names = spec.partition(":")
    if spec == "random":
        _check_folds(folds)
        if folds > len(table):
            raise SplitError(
                f"{folds} folds of {len(table)} rows: fewer rows than folds; ask for fewer folds"
            )
        parts = np.array_split(rng.permutation(len(table)), folds)
        return Split(spec, (), None, tuple(np.sort(p) for p in parts), "random, as asked")
    if kind not in ("group", "leave-one-out") or not names:
        raise SplitError(f"split {spec!r} is not known; give {_KINDS}")
    columns = tuple(name.strip() for name in names.split(","))
    groups = group_names(table, columns)
    labels, inverse = np.unique(groups, return_inverse=True)
    if len(labels) < 2:
        raise SplitError(
            f"split {spec!r}: all rows are of one group ({labels[0]}); name another column, or 'random'"
        )
    if kind == "group":
        inverse = _fold_of_group(np.bincount(inverse), folds, spec, rng)[inverse]
    parts = [np.flatnonzero(inverse == k) for k in range(inverse.max() + 1)]
    return Split(
        f"{kind}:{','.join(columns)}", columns, groups, tuple(parts), f"by {' and '.join(columns)}, as asked"
    )


def conventional_groups(table: pd.DataFrame) -> list[tuple[str, ...]]:
    """The conventional group columns that a table has, coarsest first; `location` stands for coordinates."""
    found = [columns for columns in CONVENTIONAL_GROUPS if set(columns) <= set(table.columns)]
    return [c for c in found if len(c) == 1 or ("location",) not in found]


def group_names(table: pd.DataFrame, columns: Sequence[str]) -> np.ndarray:
    """Name the group of each row by its values in several columns together, as strings ``[n]``.

    Raises:
        SplitError: a column is unknown, or has gaps.
    """
    for name in columns:
        if name not in table.columns:
            known = ", ".join(str(c) for c in table.columns)
            raise SplitError(f"cannot split by {name!r}: there is no such column; there are {known}")
    names = [_cell_names(table[name], name) for name in columns]
    return np.array([", ".join(cells) for cells in zip(*names, strict=True)], dtype=str)


def _automatic(table: pd.DataFrame, folds: int, seed: int) -> Split:
    for columns in conventional_groups(table):
        groups = len(np.unique(group_names(table, columns)))
        if groups < 2:
            continue  # one object throughout cannot be held out; the next finer group can
        # Fewer groups than folds would be refused; holding out each in turn is the same thing, said
        # otherwise.
        kind = "group" if groups >= folds else "leave-one-out"
        chosen = split(table, f"{kind}:{','.join(columns)}", folds=folds, seed=seed)
        reason = f"{' and '.join(columns)} is the coarsest group with more than one member ({groups})"
        return Split(chosen.kind, columns, chosen.groups, chosen.folds, reason)
    chosen = split(table, "random", folds=folds, seed=seed)
    return Split(
        "random", (), None, chosen.folds, "there is no column that groups frames, so rows are shuffled"
    )


def _check_folds(folds: int) -> None:
    if folds < 2:
        raise SplitError(f"{folds} folds: a split needs at least 2, to train on one and hold out the other")


def _fold_of_group(sizes: np.ndarray, folds: int, spec: str, rng: np.random.Generator) -> np.ndarray:
    """Give each group a fold, the largest group first, each to the fold with the fewest rows so far."""
    _check_folds(folds)
    if len(sizes) < folds:
        raise SplitError(
            f"split {spec!r}: {len(sizes)} groups cannot fill {folds} folds; "
            f"ask for at most {len(sizes)} folds, or for {spec.replace('group', 'leave-one-out', 1)!r}"
        )
    shuffled = rng.permutation(len(sizes))
    fold_of, rows = np.empty(len(sizes), dtype=np.int64), np.zeros(folds, dtype=np.int64)
    for group in shuffled[np.argsort(-sizes[shuffled], kind="stable")]:
        fold_of[group] = np.argmin(rows)
        rows[fold_of[group]] += sizes[group]
    return fold_of


def _cell_names(column: pd.Series, name: str) -> list[str]:
    gaps = column.isna().to_numpy() | (column.astype(str) == "").to_numpy()
    if gaps.any():
        raise SplitError(
            f"cannot split by {name!r}: it is empty in {rows_text(np.flatnonzero(gaps))}; "
            "fill these in, or split by another column"
        )
    if is_numeric_dtype(column.dtype) and not is_bool_dtype(column.dtype):
        return [repr(int(v)) if float(v).is_integer() else repr(float(v)) for v in column]
    return [str(v) for v in column]
