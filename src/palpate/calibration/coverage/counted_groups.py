"""Groups of rows that rates are counted over, since rows of one press or block are not independent."""

from __future__ import annotations

import numpy as np
import pandas as pd

from palpate.estimators.model_card import Card
from palpate.recordings.label_tables import own_column
from palpate.recordings.splits import SESSION, within_session


def groups_in(table: pd.DataFrame, columns: tuple[str, ...]) -> np.ndarray:
    """Return a label of each row's group; each row its own where a column is missing."""
    columns = tuple(name for name in columns if name != SESSION or name in table or len(columns) == 1)
    if not columns or not set(columns) <= set(table):
        return np.arange(len(table))
    return table.groupby(list(columns), sort=False, dropna=False).ngroup().to_numpy()


PRESS_COLUMNS = ("press", "cycle", "trial")


def press_groups(table: pd.DataFrame) -> np.ndarray:
    """Return a label of each row's press within one group, as a session; each row its own without presses."""
    named = press_column(table)
    return np.arange(len(table)) if named is None else groups_in(table, within_session(table, (named,)))


def press_column(table: pd.DataFrame) -> str | None:
    """Return the column that names the press; None where there is none."""
    return next((column for column in PRESS_COLUMNS if column in table), None)


ROW, BLOCK = "row", "held-out block"


def counted_groups(card: Card, table: pd.DataFrame) -> tuple[np.ndarray, str]:
    """Return a label of each row's group, and the kind of group.

    Groups are by the columns that the calibration was split by, where the table has them; else by the press;
    each row is its own only where no press is named.
    """
    columns = tuple(c for c in card.split.columns if c != SESSION or c in table)
    if columns and set(columns) <= set(table):
        return groups_in(table, columns), "/".join(columns)
    return press_groups(table), press_column(table) or ROW


def held_out_groups(card: Card, table: pd.DataFrame) -> tuple[np.ndarray, str]:
    """Return groups of a calibration's own held-out rows, as `counted_groups`; blocks where blocks were held
    out.
    """
    length = card.split.block_rows
    if card.split.columns or card.interval_reset or length is None:
        return counted_groups(card, table)
    return _held_out_blocks(length, table), BLOCK


def _held_out_blocks(length: int, table: pd.DataFrame) -> np.ndarray:
    """Number of each row's block: a fold's stretches of rows without a gap, cut after each block's length."""
    rows, folds = (own_column(table, name).to_numpy(np.int64) for name in ("row", "held_out_in_fold"))
    sessions = groups_in(table, (SESSION,)) if SESSION in table else np.zeros(len(table), np.int64)
    order, place = np.argsort(rows), np.arange(len(table))
    begins = np.append(True, np.diff(rows[order]) > 1)[: len(table)]
    for part in (folds, sessions):
        begins[1:] |= np.diff(part[order]) != 0
    numbers = np.empty(len(table), np.int64)
    first = np.maximum.accumulate(np.where(begins, place, 0))
    numbers[order] = np.cumsum((place - first) % length == 0) - 1
    return numbers


def counted_text(count: int, by: str) -> str:
    """Return the number of groups in words.

    Example:
        >>> counted_text(9, "held-out block"), counted_text(16, "press"), counted_text(80, "row")
        ('9 held-out blocks', '16 groups of press', '80 rows, each its own group')
    """
    if by == ROW:
        return f"{count} rows, each its own group"
    return f"{count} {BLOCK}s" if by == BLOCK else f"{count} groups of {by}"
