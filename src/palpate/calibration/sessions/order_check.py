"""Shuffled folds beside short blocks of the order in which rows were taken.

Frames that follow one another share light, temperature and wear, and often, since robots move from place to
place, nearly the same label. Shuffled folds train on the neighbours of every row that they hold out; blocks
hold neighbours out together. Where the two disagree, the images of neighbours are alike for reasons other
than touch. Neither notices what changes more slowly than a block is long: that only another session does. Of
a label that itself changes so slowly, both are passed by an image that shows nothing but the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from palpate.calibration.sessions.session_findings import has_gaps
from palpate.core import SplitError, Values
from palpate.estimators.finding_cards import MAX_TOLD_BY_ORDER, OrderCard, SplitScoreCard, is_sorted
from palpate.estimators.intervals import Intervals
from palpate.recordings import Split, split
from palpate.recordings.splits import conventional_groups, group_names

MAX_GAP, MAX_GAPS = 0.01, 5.0
"""A split asks for values that it does not train on where the median distance from a held-out label to the
nearest trained one is more than this share of the range, and so many times what shuffled folds leave."""


def split_beside(table: pd.DataFrame, parts: Split, folds: int, seed: int) -> Split | None:
    """The other of shuffled folds and short blocks; None where rows come in groups or by another split.

    Args:
        table: labels of the rows learnt from.
        parts: the split that was asked for.
        folds: how many.
        seed: of the draws.
    """
    kind = parts.kind.partition(":")[0]
    if kind not in ("random", "blocks") or _is_grouped(table):
        return None
    try:
        return split(table, "blocks" if kind == "random" else "random", folds=folds, seed=seed)
    except SplitError:  # too few rows for it
        return None


def _is_grouped(table: pd.DataFrame) -> bool:
    for columns in conventional_groups(table):
        if not has_gaps(table, columns) and 1 < len(np.unique(group_names(table, columns))) < len(table):
            return True
    return False


@dataclass(frozen=True, slots=True)
class ScoredSplit:
    """A split, and the estimates of rows that it held out; NaN where a row was in no scored fold."""

    split: Split
    held_out: Values


def order_card(
    both: Sequence[ScoredSplit], values: Values, columns: Sequence[str], intervals: Intervals, left_out: str
) -> OrderCard:
    """The card's part on order.

    Args:
        both: the card's own split first, then the other where it was scored.
        values: the targets of all rows ``[n t]``.
        columns: their names.
        intervals: the card's, by which both splits' coverage is judged.
        left_out: why the other split was not scored; empty where it was.
    """
    scores = tuple(_scores(one, values, columns, intervals) for one in both)
    order = np.arange(len(values))
    correlation = {c: float(spearmanr(order, v).statistic) for c, v in zip(columns, values.T, strict=True)}
    return OrderCard(
        splits=scores,
        rank_correlation=correlation,
        text=" ".join(
            filter(None, [_text(scores, _stretched(both, values, columns), correlation), left_out])
        ),
    )


def told_by_order(values: np.ndarray, folds: Sequence[np.ndarray]) -> float:
    """Share of a target's variance told by the rows nearest in order among those that were trained on (R²).

    Args:
        values: the target of all rows ``[n]``, in the order in which they were taken.
        folds: rows held out in each.
    """
    every, told = np.arange(len(values)), np.empty(len(values))
    for fold in folds:
        others = np.setdiff1d(every, fold)
        told[fold] = np.interp(fold, others, values[others])
    variance = float(np.var(values))
    return 1 - float(np.mean((told - values) ** 2)) / variance if variance > 0 else 0.0


def label_gap(values: np.ndarray, folds: Sequence[np.ndarray]) -> float:
    """Median distance from a held-out label to the nearest trained one, as a share of the range."""
    gaps = []
    for fold in folds:
        others = np.sort(np.delete(values, fold))
        place = np.searchsorted(others, values[fold])
        near = [others[np.clip(place + step, 0, len(others) - 1)] for step in (-1, 0)]
        gaps.append(np.min(np.abs(np.stack(near) - values[fold]), axis=0))
    return float(np.median(np.concatenate(gaps))) / max(float(np.ptp(values)), np.finfo(float).tiny)


def _scores(one: ScoredSplit, values: Values, columns: Sequence[str], intervals: Intervals) -> SplitScoreCard:
    scored = np.flatnonzero(~np.isnan(one.held_out).any(axis=1))
    outputs, true = one.held_out[scored], values[scored]
    error, inside = np.abs(intervals.errors(outputs, true)), intervals.hold(outputs, true)
    told = [told_by_order(column, one.split.folds) for column in values.T]
    variance = true.var(axis=0)
    r2 = np.where(variance > 0, 1 - (error**2).mean(axis=0) / np.where(variance > 0, variance, 1.0), 0.0)
    meaningless = [
        share > MAX_TOLD_BY_ORDER or _is_stretched(one.split, v)
        for v, share in zip(values.T, told, strict=True)
    ]
    return SplitScoreCard(
        kind=one.split.kind,
        folds=len(one.split.folds),
        rows=len(scored),
        mae=_named(columns, error.mean(axis=0)),
        r2=_named(columns, r2),
        coverage=_named(columns, inside.mean(axis=0)),
        order_r2=_named(columns, told),
        meaningless=tuple(c for c, bad in zip(columns, meaningless, strict=True) if bad),
    )


def _stretched(both: Sequence[ScoredSplit], values: Values, columns: Sequence[str]) -> tuple[str, ...]:
    """Targets of which blocks hold out a part of the range that is not trained on."""
    return tuple(
        column
        for one in both
        for column, value in zip(columns, values.T, strict=True)
        if _is_stretched(one.split, value)
    )


def _is_stretched(parts: Split, values: np.ndarray) -> bool:
    """True for blocks so long that they only extrapolate."""
    if parts.groups is None:
        return False
    count = len(parts.folds)
    shuffled = np.array_split(np.random.default_rng(0).permutation(len(values)), count)
    gap = label_gap(values, parts.folds)
    return gap > MAX_GAP and gap > MAX_GAPS * label_gap(values, shuffled)


def _named(columns: Sequence[str], numbers: Sequence[float] | np.ndarray) -> dict[str, float]:
    return {name: float(number) for name, number in zip(columns, numbers, strict=True)}


def _text(scores: Sequence[SplitScoreCard], stretched: Sequence[str], correlation: dict[str, float]) -> str:
    """What the splits say of each other, in words."""
    said = []
    for one in scores:
        told = [name for name in one.meaningless if one.tells_by_order(name)]
        if told:
            said.append((_shuffled_text if one.kind == "random" else _told_text)(scores, told, correlation))
    if stretched:
        said.append(_stretched_text(stretched))
    return " ".join(said) or (
        "No target follows the order of the rows: shuffled folds and blocks may be compared."
    )


def _shuffled_text(
    scores: Sequence[SplitScoreCard], told: Sequence[str], correlation: dict[str, float]
) -> str:
    shuffled = next(one for one in scores if one.kind == "random")
    beside = [one for one in scores if one is not shuffled]
    share = min(shuffled.order_r2[name] for name in told)
    sorted_by = min(abs(correlation[name]) for name in told)
    said = (
        f"Of {', '.join(told)} shuffled folds are meaningless if the rows were taken in this order: the rows "
        f"just before and after a held-out one, which were trained on, tell {100 * share:.0f} % of its "
        f"variance (rank correlation with the order {sorted_by:.2f}), so that an image which shows only the "
        "time would pass."
    )
    hidden = [
        name
        for name in told
        if not (any(one.tells_by_order(name) for one in beside) if beside else is_sorted(correlation[name]))
    ]
    if hidden:
        of = "" if len(hidden) == len(told) else f" of {', '.join(hidden)}"
        blocks = f"Read the blocks{of}" if beside else f"Calibrate{of} with blocks (--split blocks)"
        said += (
            f" {blocks}, which hold such neighbours out (mean absolute errors: {_errors(scores, hidden)}). "
            "What drifts more slowly than a block passes those too: where both agree, only another session "
            "tells."
        )
    if not beside and len(hidden) < len(told):
        said += " Blocks would not tell either of what is sorted: only another session does."
    return said


def _told_text(scores: Sequence[SplitScoreCard], told: Sequence[str], _: dict[str, float]) -> str:
    blocks = next(one for one in scores if one.kind != "random")
    share = min(blocks.order_r2[name] for name in told)
    return (
        f"Of {', '.join(told)} blocks are meaningless, too: the rows nearest in order beyond a block's ends "
        f"tell {100 * share:.0f} % of its variance without any picture (mean absolute errors: "
        f"{_errors(scores, told)}). Neither split tells; only another session does."
    )


def _errors(scores: Sequence[SplitScoreCard], names: Sequence[str]) -> str:
    return "; ".join(
        f"{name} {' and '.join(f'{one.mae[name]:.3g} by {one.kind}' for one in scores)}" for name in names
    )


def _stretched_text(names: Sequence[str]) -> str:
    return (
        f"Of {', '.join(names)} blocks this long are meaningless: each holds out a part of the range that "
        "was not trained on, so that they measure extrapolation alone. Ask for shorter ones "
        "(--split blocks:ROWS)."
    )
