"""Splits into rows that train and rows held out, so that a score says something about new presses.

A split of a user's is a function named ``module:function`` or by an entry point: of the table of labels, the
number of folds and the seed, it makes either a group's label for each row, or a `Split`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_bool_dtype, is_numeric_dtype

from palpate.core import PluginError, SplitError
from palpate.core.plugins import ERROR, OWN, PATH, PluginRegistry, plugin_calls
from palpate.recordings.label_tables import rows_text

SESSION = "session"
"""The label column that says what was recorded without re-mounting the sensor, such as a day's date."""

# Coarsest first: a split by an earlier one also holds apart everything that a later one would.
CONVENTIONAL_GROUPS: tuple[tuple[str, ...], ...] = (
    (SESSION,),
    ("object",),
    ("specimen",),
    ("sensor",),
    ("copy",),
    ("location",),
    ("x_mm", "y_mm"),
    ("row", "col"),
    ("row", "column"),
    ("press",),
    ("cycle",),
    ("trial",),
)
WITHIN_SESSION = ("press", "cycle", "trial")
"""Columns that count within a session: press 3 of one session is not press 3 of another."""

REGISTRY = PluginRegistry(
    "split", "palpate.splits", dict.fromkeys(("auto", "random", SESSION, "blocks"), OWN)
)
_BY_COLUMNS = ("group", "leave-one-out")
_KINDS = (
    "'auto', 'random', 'session', 'blocks', 'blocks:ROWS', 'group:COLUMN[,COLUMN...]', "
    "'leave-one-out:COLUMN[,COLUMN...]', or a function of yours as 'module:function'"
)
BLOCKS_A_FOLD = 20
"""Blocks that each fold holds out where their length is not given: short ones, so that each fold reaches over
the whole order, and long enough that most rows held out have no neighbour that was trained on."""


@dataclass(frozen=True, slots=True)
class Split:
    """Rows of a table divided into folds, each held out once.

    Attributes:
        kind: Specification, such as ``group:location``.
        group_columns: Columns that name a group; empty for a random split.
        groups: Group of each row ``[n]``; None for a random split.
        folds: Row indices held out in each fold; disjoint and complete.
        reason: Reason for this kind.
        block_rows: Block length of a split by blocks; None otherwise.
    """

    kind: str
    group_columns: tuple[str, ...]
    groups: np.ndarray | None
    folds: tuple[np.ndarray, ...]
    reason: str
    block_rows: int | None = None

    def training_rows(self, k: int) -> np.ndarray:
        """The rows that fold `k` trains on: all but those it holds out, in order."""
        rows: np.ndarray = np.sort(np.concatenate([fold for i, fold in enumerate(self.folds) if i != k]))
        return rows


def split(table: pd.DataFrame, spec: str, *, folds: int = 5, seed: int = 0) -> Split:
    """Divide the rows of a label table into folds.

    Args:
        spec: ``auto`` (coarsest conventional group, else random), ``random``, ``session``, ``blocks`` or
            ``blocks:ROWS`` (consecutive rows together), ``group:COL[,COL...]``,
            ``leave-one-out:COL[,COL...]``, or a plug-in (``module:function`` or an entry point of the group
            ``palpate.splits``).
        folds: Number of folds, at least 2; ignored by leave-one-out and session.

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
        shuffled = np.array_split(rng.permutation(len(table)), folds)
        return Split(spec, (), None, tuple(np.sort(p) for p in shuffled), "random, as asked")
    if spec == SESSION:
        return _by_session(table, rng)
    if kind == "blocks":
        check_split_text(spec)
        return _by_blocks(table, int(names) if names else None, folds, rng)
    if kind not in _BY_COLUMNS:
        return _plugged_in(table, spec, folds, seed)
    check_split_text(spec)
    columns = tuple(name.strip() for name in names.split(","))
    typed, columns = ",".join(columns), within_session(table, columns)
    groups = group_names(table, columns)
    parts = _parts(groups, spec, None if kind == "leave-one-out" else folds, rng)
    return Split(f"{kind}:{typed}", columns, groups, parts, f"by {' and '.join(columns)}, as asked")


def within_session(table: pd.DataFrame, columns: tuple[str, ...]) -> tuple[str, ...]:
    """Columns that name a group, with the session's before those that count anew in each session.

    Example:
        >>> within_session(pd.DataFrame({"session": ["a", "b"], "press": [1, 1]}), ("press",))
        ('session', 'press')
    """
    counted = columns[0] in WITHIN_SESSION and SESSION in table.columns and SESSION not in columns
    return (SESSION, *columns) if counted else columns


def _by_session(table: pd.DataFrame, rng: np.random.Generator) -> Split:
    if SESSION not in table.columns:
        raise SplitError(
            "split 'session': all rows are of one session, so that none can be held out; give the runs of "
            f"several days, or label the rows in a column {SESSION!r}",
            code="one-session",
        )
    groups = group_names(table, (SESSION,))
    if len(np.unique(groups)) < 2:
        raise SplitError(
            f"split 'session': all rows are of one session ({groups[0]}), so that none can be held out; give "
            "the runs of several days, or split otherwise",
            code="one-session",
        )
    parts = _parts(groups, SESSION, None, rng)
    return Split(SESSION, (SESSION,), groups, parts, "each session held out in turn, as asked")


def _by_blocks(table: pd.DataFrame, length: int | None, folds: int, rng: np.random.Generator) -> Split:
    """Blocks of consecutive rows, none across two sessions; of as many blocks as folds each fold has one."""
    _check_folds(folds)
    rows = length or max(2, round(len(table) / (BLOCKS_A_FOLD * folds)))
    block = _block_numbers(table, rows)
    count = int(block[-1]) + 1 if len(block) else 0
    if count < folds:
        raise SplitError(
            f"{folds} folds of {len(table)} rows in blocks of {rows}: {count} blocks cannot fill them; ask "
            "for shorter blocks or fewer folds",
            code="too-few-blocks",
        )
    # In an order drawn anew in each round, so that no plan that repeats itself keeps step with the folds.
    rounds = [rng.permutation(folds) for _ in range(-(-count // folds))]
    fold = np.concatenate(rounds)[:count][block]
    parts = tuple(np.flatnonzero(fold == k) for k in range(folds))
    kind = "blocks" if length is None else f"blocks:{length}"
    reason = f"blocks of {rows} consecutive rows dealt to {folds} folds in turn, as asked"
    return Split(kind, (), np.array([f"block {b}" for b in block]), parts, reason, rows)


def _block_numbers(table: pd.DataFrame, rows: int) -> np.ndarray:
    """Number of each row's block ``[n]``; a block ends after so many rows, or where the session does."""
    begins = np.zeros(len(table), dtype=bool)
    sessions = group_names(table, (SESSION,)) if SESSION in table.columns else np.zeros(len(table))
    changes = np.flatnonzero(np.append(True, sessions[1:] != sessions[:-1])[: len(table)])
    for first, end in zip(changes, [*changes[1:], len(table)], strict=True):
        begins[first:end:rows] = True
    return np.cumsum(begins) - 1


def _parts(
    groups: np.ndarray, spec: str, folds: int | None, rng: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Rows of each fold, whole groups together; without `folds`, each group is one."""
    labels, inverse = np.unique(groups, return_inverse=True)
    if len(labels) < 2:
        raise SplitError(
            f"split {spec!r}: all rows are of one group ({labels[0]}); name another column, or 'random'"
        )
    if folds is not None:
        inverse = _fold_of_group(np.bincount(inverse), folds, spec, rng)[inverse]
    return tuple(np.flatnonzero(inverse == k) for k in range(inverse.max() + 1))


def check_split_text(spec: str) -> None:
    """Refuse what is no split, before there is a table to part."""
    kind, colon, names = spec.partition(":")
    if kind in _BY_COLUMNS and any(name.strip() for name in names.split(",")):
        return
    if kind == SESSION and colon:
        raise SplitError(f"split {spec!r}: 'session' alone holds out each value of the column 'session'")
    if kind == "blocks" and colon:
        if not (names.isascii() and names.isdigit() and int(names) > 0):
            raise SplitError(f"split {spec!r}: a block has 1 row or more, as in 'blocks:20'")
        return
    if spec in REGISTRY.built_in:
        REGISTRY.path_of(spec)  # refuses a package that takes the name
        return
    if (not colon and spec not in REGISTRY.names()) or kind in _BY_COLUMNS:
        raise SplitError(f"split {spec!r} is not known; give {_KINDS}")
    _function(spec)


def _function(spec: str) -> Any:
    if ":" in spec and not PATH.fullmatch(spec):
        raise SplitError(f"split {spec!r} is not known; give {_KINDS}")
    return REGISTRY.find(spec)


def _plugged_in(table: pd.DataFrame, spec: str, folds: int, seed: int) -> Split:
    """Split by a function of the user's, called twice, so that chance without a seed shows."""
    check_split_text(spec)
    function = _function(spec)
    first, second = (_split_by(function, table, spec, folds, seed) for _ in range(2))
    if len(first.folds) != len(second.folds) or not all(map(np.array_equal, first.folds, second.folds)):
        raise PluginError(f"split {spec}: the same table and seed give other folds; draw from the seed alone")
    check_split(first, len(table))
    return first


def _split_by(function: Any, table: pd.DataFrame, spec: str, folds: int, seed: int) -> Split:
    with plugin_calls(f"split {spec} failed on {len(table)} rows ({ERROR})", ()):
        answer = function(table.copy(), folds=folds, seed=seed)
    must = f"the label of each row's group, [{len(table)}], all of one kind, or a Split"
    with plugin_calls(f"split {spec} must give {must} ({ERROR})"):  # of ragged lists, or labels without order
        if isinstance(answer, Split):
            return _normalised(answer, spec, len(table))
        groups = _labels(answer, spec, len(table)).astype(str)
    return Split(spec, (), groups, _parts(groups, spec, folds, np.random.default_rng(seed)), f"by {spec}")


def _normalised(answer: Split, spec: str, rows: int) -> Split:
    """A plug-in's `Split`, its fields of the kinds that they shall be."""
    folds = answer.folds if isinstance(answer.folds, tuple | list) else ()
    parts = tuple(np.asarray(fold) for fold in folds if np.ndim(fold) == 1)
    if not folds or len(parts) < len(folds) or any(part.dtype.kind not in "iu" for part in parts):
        raise PluginError(f"split {spec}: its folds are a tuple of arrays of whole row numbers, one a fold")
    columns = answer.group_columns
    if not (isinstance(columns, tuple) and all(isinstance(one, str) for one in (*columns, answer.reason))):
        raise PluginError(
            f"split {spec}: its group_columns are a tuple of texts, not {columns!r}, and its reason a text, "
            f"not {answer.reason!r}"
        )
    groups = None if answer.groups is None else _labels(answer.groups, spec, rows)
    np.unique([] if groups is None else groups)  # raises where the groups cannot be told apart
    return replace(answer, kind=spec, folds=parts, groups=groups)


def _labels(answer: Any, spec: str, rows: int) -> np.ndarray:
    """A label of each row's group ``[n]``, none of them missing."""
    labels = np.asarray(answer)
    if labels.shape != (rows,):
        raise PluginError(
            f"split {spec} gave {type(answer).__name__} of shape {list(labels.shape)} for {rows} rows; "
            f"it gives the label of each row's group, [{rows}], or a Split"
        )
    missing = np.flatnonzero(pd.isna(np.array([*answer], object)))
    if len(missing):
        raise PluginError(f"split {spec} gave no label in {rows_text(missing)}; it gives one for each row")
    return labels


def check_split(parts: Split, rows: int) -> None:
    """Check that a split holds out every row once and no group in parts."""
    held_rows = np.concatenate(parts.folds) if parts.folds else np.empty(0, np.int64)
    if len(parts.folds) < 2 or not all(len(fold) for fold in parts.folds):
        raise PluginError(
            f"split {parts.kind} has {len(parts.folds)} folds; there are two or more, none empty"
        )
    if not np.array_equal(np.sort(held_rows), np.arange(rows)):
        raise PluginError(f"split {parts.kind}: its folds hold out each of the {rows} rows once")
    if parts.groups is None:
        return
    if np.shape(parts.groups) != (rows,):
        raise PluginError(f"split {parts.kind}: groups of shape {np.shape(parts.groups)}; one for each row")
    for fold in parts.folds:
        rest = np.setdiff1d(np.arange(rows), fold)
        both = np.intersect1d(parts.groups[fold], parts.groups[rest])
        if both.size:
            raise PluginError(f"split {parts.kind}: group {both[0]} stands on both sides of a fold")


def conventional_groups(table: pd.DataFrame) -> list[tuple[str, ...]]:
    """The conventional group columns that a table has, coarsest first; `location` stands for coordinates."""
    groups = [columns for columns in CONVENTIONAL_GROUPS if set(columns) <= set(table.columns)]
    return [c for c in groups if len(c) == 1 or ("location",) not in groups]


def group_names(table: pd.DataFrame, columns: Sequence[str]) -> np.ndarray:
    """Name the group of each row by its values in several columns together, as strings ``[n]``."""
    for name in columns:
        if name not in table.columns:
            known = ", ".join(str(c) for c in table.columns)
            raise SplitError(f"cannot split by {name!r}: there is no such column; there are {known}")
    names = [_cell_names(table[name], name) for name in columns]
    return np.array([", ".join(cells) for cells in zip(*names, strict=True)], dtype=str)


def _automatic(table: pd.DataFrame, folds: int, seed: int) -> Split:
    for columns in conventional_groups(table):
        groups = len(np.unique(group_names(table, within_session(table, columns))))
        if groups < 2:
            continue  # one object throughout cannot be held out; the next finer group can
        # Fewer groups than folds would be refused; holding out each in turn is the same thing, said
        # otherwise.
        kind = "group" if groups >= folds else "leave-one-out"
        chosen = split(table, f"{kind}:{','.join(columns)}", folds=folds, seed=seed)
        reason = f"{' and '.join(columns)} is the coarsest group with more than one member ({groups})"
        return Split(chosen.kind, chosen.group_columns, chosen.groups, chosen.folds, reason)
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
        kind, _, columns = spec.partition(":")
        instead = f", or for 'leave-one-out:{columns}'" if kind == "group" else ""
        raise SplitError(
            f"split {spec!r}: {len(sizes)} groups cannot fill {folds} folds; "
            f"ask for at most {len(sizes)} folds{instead}",
            code="few-groups",
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
