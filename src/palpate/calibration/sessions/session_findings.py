"""What a calibration may promise of another day: its sessions, what speaks against them, and its words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from typing import Any

import numpy as np
import pandas as pd

from palpate.calibration.certificate import CalibrationResult, IntervalFit, run_card
from palpate.calibration.coverage.conformal import fit_intervals
from palpate.calibration.coverage.group_quantiles import is_distribution_free, rank_of_new_group
from palpate.calibration.sessions.session_intervals import (
    SessionSpread,
    few_sessions_factor,
    intervals_of_sessions,
)
from palpate.calibration.sessions.session_labels import (
    alike_sessions,
    label_findings,
    refuse_no_sessions,
    unlabelled_runs,
)
from palpate.core import InputError, SplitError, Values
from palpate.estimators.finding_cards import SessionErrorCard, SessionsCard
from palpate.estimators.intervals import Intervals
from palpate.estimators.target_layout import Outputs, TargetLayout
from palpate.recordings import PackedSet, Run, Split
from palpate.recordings.joined_runs import JoinedRun, sessions_of
from palpate.recordings.splits import SESSION, conventional_groups, group_names, within_session

HELD_OUT_WHOLE = (SESSION, "sensor", "copy")
"""Columns whose groups a new one of is asked for, when they are held out whole; the coarsest first."""

MAX_COPIES = 0.05
"""Share of a session's touched frames that may be another's to the last byte, as of a sensor that is dark at
a light touch; more are one recording under two names."""

MAX_ALTERED = 0.5
"""Share of the scored frames that are altered copies of another session's, from which it is no other."""

MAX_SHARE_OF_VARIANCE = 0.9
"""Share of a target's variance that lies between sessions, above which the session tells the target."""

NOT_YET_TESTED = (
    "Not yet tested on another day: all rows are of one session ({name}). Where that was measured "
    "elsewhere, 90 % intervals covered between 53 and 95 % of the next session, in most cases less than "
    "90 %. Record a second one and `palpate evaluate` on it."
)


@dataclass(frozen=True, slots=True)
class HeldOutSessions:
    """Sessions of the scored rows, where a split has held them out whole.

    Attributes:
        column: what tells them apart.
        of: name of each scored row's session ``[n]``.
        groups: label of each scored row's group within them ``[n]``.
    """

    column: str
    of: np.ndarray
    groups: np.ndarray

    @property
    def count(self) -> int:
        """How many there are."""
        return len(np.unique(self.of))


def held_out_sessions(table: pd.DataFrame, split: Split, scored: np.ndarray) -> HeldOutSessions | None:
    """Sessions that were held out whole and scored; None where fewer than two were.

    Args:
        table: labels of the rows learnt from.
        split: of these rows.
        scored: which were scored.
    """
    for column in HELD_OUT_WHOLE:
        if column not in split.group_columns or column not in table:
            continue
        names = group_names(table, (column,))
        fold = np.empty(len(table), np.int64)
        for k, rows in enumerate(split.folds):
            fold[rows] = k
        whole = all(len(np.unique(fold[names == name])) == 1 for name in np.unique(names))
        if whole and len(np.unique(names[scored])) > 1:
            return HeldOutSessions(column, names[scored], groups_within(table)[scored])
    return None


def finest_columns(table: pd.DataFrame) -> tuple[str, ...]:
    """The finest conventional columns without gaps that group rows, such as the press; none if none does."""
    finer = [columns for columns in conventional_groups(table) if columns[0] not in HELD_OUT_WHOLE]
    whole = [columns for columns in finer if not has_gaps(table, columns)]
    return within_session(table, whole[-1]) if whole else ()


def has_gaps(table: pd.DataFrame, columns: tuple[str, ...]) -> bool:
    """True if a cell of these columns is empty."""
    cells = table[list(columns)]
    return bool(cells.isna().to_numpy().any() or (cells.astype(str) == "").to_numpy().any())


def groups_within(table: pd.DataFrame) -> np.ndarray:
    """Number of each row's finest conventional group ``[n]``; each row its own where there is none."""
    columns = finest_columns(table)
    if not columns:
        return np.arange(len(table))
    return np.unique(group_names(table, columns), return_inverse=True)[1]


def presses_of(table: pd.DataFrame, split: Split) -> np.ndarray | None:
    """Number of what each row was recorded in at one go ``[n]``; None where no column says.

    A split's own groups tell it too, unless they are whole sessions, or blocks that only cut the order.

    Args:
        table: labels of the rows learnt from.
        split: of these rows.
    """
    named = [groups_within(table)] if finest_columns(table) else []
    fine = split.groups is not None and split.block_rows is None
    if fine and (not split.group_columns or set(split.group_columns) - set(HELD_OUT_WHOLE)):
        named.append(np.unique(np.asarray(split.groups), return_inverse=True)[1])
    if not named:
        return None
    return np.unique(np.column_stack(named), axis=0, return_inverse=True)[1].ravel()


def recordings_of(table: pd.DataFrame) -> np.ndarray | None:
    """Name of the session, sensor and copy that each row is of ``[n]``; None where no column says."""
    columns = tuple(c for c in HELD_OUT_WHOLE if c in table and not has_gaps(table, (c,)))
    return group_names(table, columns) if columns else None


def interval_fit(held: HeldOutSessions | None) -> IntervalFit:
    """How intervals are made: for new sessions where such were held out, else as always."""
    return fit_intervals if held is None else partial(_for_sessions, held)


def _for_sessions(
    held: HeldOutSessions,
    predicted: Outputs,
    true: Values,
    groups: np.ndarray,
    coverage: float,
    layout: TargetLayout | None = None,
) -> Intervals:
    return intervals_of_sessions(predicted, true, held.of, held.groups, coverage, layout)


def check_sessions(
    table: pd.DataFrame,
    values: Values,
    columns: Sequence[str],
    split: Split,
    in_recorded_order: bool = True,
) -> tuple[str, ...]:
    """Findings on sessions that the labels alone show.

    Args:
        table: labels of the rows to learn from.
        values: the targets ``[n t]``.
        columns: their names.
        split: of the rows.
        in_recorded_order: whether rows lie in the order in which they were taken.

    Raises:
        SplitError: sessions are to be held out, and their labels cannot name sessions, or a target has one
            value in each: each would be asked for values that the others do not show.
    """
    if SESSION not in table:
        return ()
    sessions = group_names(table, (SESSION,))
    if len(np.unique(sessions)) < 2:
        return ()
    if SESSION in split.group_columns:
        refuse_no_sessions(table, columns)
    findings = label_findings(table, values, columns, in_recorded_order)
    for column, target in zip(columns, values.T, strict=True):
        share = share_between(target, sessions)
        if share > 1 - 1e-9 and SESSION in split.group_columns:
            raise SplitError(
                f"target {column!r} has one value in each session, so that the session is the target: held "
                "out, a session asks for a value that no other shows. Record each session over the whole "
                "range, or split within sessions (--split blocks), which tests no other day"
            )
        if share > MAX_SHARE_OF_VARIANCE:
            findings.append(
                f"{100 * share:.0f} % of the variance of {column} lies between sessions: what tells the "
                "session, such as light or mounting, tells the target; record each session over the whole "
                "range"
            )
    return tuple(findings)


def share_between(target: np.ndarray, sessions: np.ndarray) -> float:
    """Share of a target's variance ``[n]`` that lies between the sessions' means (eta squared)."""
    _, of = np.unique(sessions, return_inverse=True)
    means = np.bincount(of, weights=target) / np.bincount(of)
    variance = float(np.var(target))
    return float(np.var(means[of])) / variance if variance > 0 else 0.0


def refuse_copied_sessions(packed: PackedSet, columns: tuple[str, ...]) -> None:
    """Raise where one session stands under two names: its frames are another's, to the last byte.

    Args:
        packed: the rows to learn from, without those of the untouched sensor, which look alike everywhere.
        columns: of the split; nothing is asked where no session is held out.

    Raises:
        InputError: more frames of a session than by chance are another's.
    """
    if SESSION not in columns or SESSION not in packed.table:
        return
    sessions = group_names(packed.table, (SESSION,))
    seen: dict[bytes, set[str]] = {}
    digests = [_digest(packed, row) for row in range(len(packed))]
    for digest, session in zip(digests, sessions, strict=True):
        seen.setdefault(digest, set()).add(session)
    for session in np.unique(sessions):
        own = [digest for digest, of in zip(digests, sessions, strict=True) if of == session]
        for other in sorted(set(sessions) - {session}):
            copies = sum(other in seen[digest] for digest in own)
            if copies > MAX_COPIES * len(own) and copies > 1:
                raise InputError(
                    f"{copies} of {len(own)} frames of session {session} are frames of session {other}, "
                    f"to the last byte: that is one session under two names, which tests no other day. Give "
                    "it once, or under one name"
                )


def _digest(packed: PackedSet, row: int) -> bytes:
    return sha256(packed.read([row]).tobytes()).digest()


def sessions_card(
    run: Run,
    held: HeldOutSessions | None,
    errors: Mapping[str, tuple[np.ndarray, np.ndarray]],
    coverage: float,
    findings: tuple[str, ...] = (),
) -> SessionsCard:
    """The card's part on sessions.

    Args:
        run: what was learnt from.
        held: the sessions held out; None where none was.
        errors: of each target's column, signed errors of the scored rows ``[n]`` and whether their
            intervals held the truth ``[n]``.
        coverage: of the intervals.
        findings: what stands against the promise.
    """
    column = held.column if held is not None else SESSION
    names = np.unique(held.of) if held is not None else np.unique(sessions_of(run))
    count = 0 if held is None else held.count
    free = count > 1 and is_distribution_free(count, coverage)
    factor = None if free or count < 2 else few_sessions_factor(count, coverage)
    text = _promise(column, tuple(map(str, names)), count, coverage, factor)
    one_day = column != SESSION and len(np.unique(sessions_of(run))) < 2
    same_day = "All rows are of one session: not yet tested on another day." if one_day else ""
    return SessionsCard(
        column=column,
        names=tuple(str(name) for name in names),
        runs=tuple(run_card(one) for one in run.runs) if isinstance(run, JoinedRun) else (),
        held_out=count,
        rule="one session" if count < 2 else "distribution-free" if free else "parametric",
        rank=rank_of_new_group(count, coverage) if free else None,
        factor=factor,
        errors={} if held is None else {c: _error_card(held, *pair) for c, pair in errors.items()},
        findings=findings,
        text=" ".join(filter(None, [text, same_day])),
    )


def _error_card(held: HeldOutSessions, errors: np.ndarray, inside: np.ndarray) -> SessionErrorCard:
    spread = SessionSpread.of(errors, held.of)
    least = min(float(inside[held.of == name].mean()) for name in np.unique(held.of))
    return SessionErrorCard(between=spread.between, within=spread.within, coverage_least=least)


def _promise(column: str, names: tuple[str, ...], count: int, coverage: float, factor: float | None) -> str:
    """What the intervals promise of a new session, in words."""
    rate, what, many = f"{100 * coverage:g} %", column, "copies" if column == "copy" else f"{column}s"
    if count < 2 and len(names) < 2:
        return NOT_YET_TESTED.format(name=names[0] if names else "not named")
    if count < 2:
        return (
            f"Not yet tested on another day: rows of each of {len(names)} sessions were trained on when "
            "others of the same were held out, so that the intervals are for rows of these sessions, and "
            "may cover less on another (elsewhere between 53 and 95 % where 90 % was promised, in most cases "
            "less than 90 %). Hold sessions out (--split session)."
        )
    if factor is not None:
        return (
            f"Tested on {count} {many}, each held out whole. The {rate} intervals are for a new {what}, "
            f"by a Gaussian model of how {many} differ: {factor:.2f} times as wide as if many were known, "
            f"since {count} say little of the next. That is no guarantee; one without an assumption takes "
            f"{_sessions_needed(coverage)} {many}."
        )
    rank = rank_of_new_group(count, coverage)
    return (
        f"Tested on {count} {many}, each held out whole. The {rate} intervals are for a new {what}, "
        "whatever the errors' distribution, if larger ones are rarer than smaller ones: the expected score "
        f"of rank {rank} among one from each of {count}. The rate is the mean over new {many}: a single one "
        "may be covered less often."
    )


def _sessions_needed(coverage: float) -> int:
    count = 2
    while not is_distribution_free(count, coverage):
        count += 1
    return count


def session_fields(result: CalibrationResult, held: HeldOutSessions | None) -> dict[str, Any]:
    """Fields of a card that say what sessions were learnt from."""
    scored, plan, table, intervals = (
        result.scored,
        result.plan,
        result.learning.packed.table,
        result.intervals,
    )
    outputs, true = result.held_out[scored], result.data.values[scored]
    errors, inside = intervals.errors(outputs, true), intervals.hold(outputs, true)
    pairs = {column: (errors[:, j], inside[:, j]) for j, column in enumerate(plan.targets)}
    findings = (
        *_copied(result),
        *_alike(result, table),
        *unlabelled_runs(result.run),
        *check_sessions(
            table, result.data.values, plan.targets, result.split, result.run.manifest.order == "recorded"
        ),
    )
    return {"sessions": sessions_card(result.run, held, pairs, plan.coverage, findings)}


def _copied(result: CalibrationResult) -> list[str]:
    """A sentence where most frames of held-out sessions are altered copies of others'."""
    copies, scored = result.audit.near_duplicates, len(result.scored)
    if SESSION not in result.split.group_columns or copies < MAX_ALTERED * scored:
        return []
    text = (
        f"{copies} of {scored} frames look the same as frames of another session, within camera noise or but "
        "for a shift or light: that is one session under two names, which tests no other day; give it once"
    )
    return [text]


def _alike(result: CalibrationResult, table: pd.DataFrame) -> list[str]:
    """Sentences on sessions whose frames cannot be told apart; none where there is one session."""
    if SESSION not in table or SESSION not in result.split.group_columns:
        return []
    sessions = group_names(table, (SESSION,))
    if len(np.unique(sessions)) < 2:
        return []
    pictures = result.learning.thumbnails()[result.learning.rows]
    return alike_sessions(pictures, sessions, groups_within(table))
