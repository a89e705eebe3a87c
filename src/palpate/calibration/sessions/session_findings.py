"""What a calibration promises of another day: its sessions, and what speaks against the promise.

Evaluations kept next to a card as ``evaluation-RUN.json``, RUN being the first digits of the run's hash; a
damaged one, or one of another card, is refused by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from palpate.calibration.calibration_job import HELD_OUT_WHOLE, CalibrationJob, groups_within, share_between
from palpate.calibration.certificate import CalibrationResult, intervals_by, run_card, scored_rows
from palpate.calibration.coverage.conformal import fit_intervals
from palpate.calibration.coverage.grouped_rates import is_distribution_free, rank_of_new_group
from palpate.calibration.sessions.interval_reset import (
    SessionSpread,
    few_sessions_factor,
    intervals_of_sessions,
)
from palpate.core import (
    CertificateError,
    Float,
    Indices,
    PathText,
    Values,
    new_file,
    storage_errors,
)
from palpate.core.parsing import parser
from palpate.estimators.card_ground import SealedCard, card_id, sealed_from
from palpate.estimators.certified import read_card
from palpate.estimators.class_sets import Outputs, TargetLayout
from palpate.estimators.findings import Finding, FindingCode, SessionErrorCard, SessionsCard, ValidScoreCard
from palpate.estimators.intervals import Intervals
from palpate.estimators.model_card import Card, ScoreCard
from palpate.recordings import Run, Split
from palpate.recordings.joined_runs import JoinedRun, sessions_of
from palpate.recordings.splits import SESSION, group_names
from palpate.version import __version__

MAX_ALTERED = 0.5  # ratio of scored frames that are altered copies of another session's
MAX_SHARE_OF_VARIANCE = 0.9  # ratio of a target's variance between sessions
MIN_ROWS = 10
MAX_STRETCHES = 3.0  # stretches over the number of sessions, above which sessions alternate
MAX_SPANS = 20.0  # ratio of a target's spans in two sessions, above which units may differ
MAX_NAMED = 3


@dataclass(frozen=True, slots=True)
class HeldOutSessions:
    """Sessions of the scored rows, where a split has held them out whole.

    Attributes:
        column: label column that names them.
        of, groups: session of each scored row, and its group within that ``[n]``.
    """

    column: str
    of: np.ndarray
    groups: np.ndarray

    @property
    def count(self) -> int:
        return len(np.unique(self.of))


def held_out_sessions(table: pd.DataFrame, split: Split, scored: Indices) -> HeldOutSessions | None:
    """Return the sessions that were held out whole and scored; None where fewer than two were."""
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


def held_out_intervals(
    job: CalibrationJob, outputs: Float[np.ndarray, "n _"], held_out: Outputs
) -> tuple[HeldOutSessions | None, Intervals]:
    """Return the sessions held out, and the intervals: for new sessions where such were held out.

    Args:
        outputs: held-out outputs of targets and classes ``[n o]``.
        held_out: those of the targets.
    """
    held = held_out_sessions(job.table, job.parts, scored_rows(outputs))
    fit = fit_intervals if held is None else partial(_for_sessions, held)
    return held, intervals_by(fit, held_out, job.data, job.plan)


def _for_sessions(
    held: HeldOutSessions,
    predicted: Outputs,
    true: Values,
    groups: np.ndarray,
    coverage: float,
    layout: TargetLayout | None = None,
) -> Intervals:
    return intervals_of_sessions(predicted, true, held.of, held.groups, coverage, layout)


def label_findings(
    table: pd.DataFrame, values: Values, columns: Sequence[str], in_recorded_order: bool = True
) -> list[Finding]:
    """Return findings on sessions by labels and targets.

    Args:
        table: labels of the training rows; `in_recorded_order` states whether in temporal order.
        values: targets ``[n t]``, named `columns`.
    """
    if SESSION not in table:
        return []
    sessions = group_names(table, (SESSION,))
    names, of, rows = np.unique(sessions, return_inverse=True, return_counts=True)
    if len(names) < 2:
        return []
    found = [
        Finding(code=FindingCode.SESSION_OF_FEW_ROWS, values={"session": str(name), "rows": int(count)})
        for name, count in zip(names, rows, strict=True)
        if count < MIN_ROWS
    ]
    times = int(np.sum(of[1:] != of[:-1]))
    if in_recorded_order and 1 + times > MAX_STRETCHES * len(names):
        found.append(
            Finding(code=FindingCode.SESSIONS_ALTERNATE, values={"sessions": len(names), "times": times})
        )
    for column, target in zip(columns, values.T, strict=True):
        spans = np.array([np.ptp(target[of == k]) for k in range(len(names))])
        if 0 < np.sum(spans == 0) < len(names):
            constant = ", ".join(map(str, names[spans == 0][:MAX_NAMED]))
            found.append(
                Finding(code=FindingCode.CONSTANT_IN_SESSION, target=column, values={"session": constant})
            )
        moving = (spans > 0) & (rows >= MIN_ROWS)
        least, most = spans[moving].min(initial=np.inf), spans[moving].max(initial=0.0)
        if moving.sum() > 1 and most > MAX_SPANS * least:
            first, second = (str(names[moving][k]) for k in np.argsort(spans[moving])[[0, -1]])
            ends = {"small": float(least), "large": float(most), "first": first, "second": second}
            found.append(Finding(code=FindingCode.UNIT_OF_SESSION, target=column, values=ends))
        if (share := share_between(target, sessions)) > MAX_SHARE_OF_VARIANCE:
            found.append(
                Finding(code=FindingCode.SESSION_TELLS_TARGET, target=column, values={"share": share})
            )
    return found


def unlabeled_runs(run: Run) -> list[Finding]:
    """Return a finding on runs whose session is their name, joined with runs that label it."""
    runs = run.runs if isinstance(run, JoinedRun) else ()
    bare = [one.path.name for one in runs if SESSION not in one.manifest.labels]
    if not bare or len(bare) == len(runs):
        return []
    return [Finding(code=FindingCode.RUNS_WITHOUT_SESSION, values={"runs": ", ".join(bare)})]


def sessions_card(
    run: Run,
    held: HeldOutSessions | None,
    errors: Mapping[str, tuple[np.ndarray, np.ndarray]],
    coverage: float,
    findings: tuple[Finding, ...] = (),
) -> SessionsCard:
    """Return the card's part on sessions.

    Args:
        held: sessions held out; None where none was.
        errors: per target column, signed errors of the scored rows and whether their intervals covered
            ``[n]``.
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


_ELSEWHERE = (
    "where that was measured elsewhere, 90 % intervals covered 53 to 95 % of the next session, mostly less "
    "than 90 %"
)


def _promise(column: str, names: tuple[str, ...], count: int, coverage: float, factor: float | None) -> str:
    rate, many = f"{100 * coverage:g} %", "copies" if column == "copy" else f"{column}s"
    untested = "Not yet tested on another day"
    if count < 2 and len(names) < 2:
        return (
            f"{untested}: all rows are of one session ({names[0] if names else 'not named'}); {_ELSEWHERE}. "
            "Record a second one and `palpate evaluate` on it."
        )
    if count < 2:
        return (
            f"{untested}: rows of each of {len(names)} sessions were trained on; {_ELSEWHERE}. Hold sessions "
            "out (--split session)."
        )
    tested = f"Tested on {count} {many}, each held out whole. The {rate} intervals are for a new {column}"
    if factor is not None:
        needed = next(n for n in range(2, 10_000) if is_distribution_free(n, coverage))
        return (
            f"{tested}, by a Gaussian model of how {many} differ, and {factor:.2f} times as wide as if many "
            f"were known. That is no guarantee; one without an assumption takes {needed} {many}."
        )
    return (
        f"{tested}, whatever the errors' distribution, if larger ones are rarer than smaller ones. The rate "
        f"is the mean over new {many}: a single one may be covered less often."
    )


def session_fields(result: CalibrationResult, held: HeldOutSessions | None, _: Path) -> dict[str, Any]:
    """Return the card's field on sessions of a new calibration."""
    job, scored, intervals = result.job, result.scored, result.intervals
    outputs, true = result.held_out[scored], result.data.values[scored]
    errors, inside = intervals.errors(outputs, true), intervals.hold(outputs, true)
    pairs = {column: (errors[:, j], inside[:, j]) for j, column in enumerate(job.plan.targets)}
    found = unlabeled_runs(job.run)
    found += label_findings(job.table, job.data.values, job.plan.targets, job.in_recorded_order)
    if result.audit is not None and job.sessions is not None and len(np.unique(job.sessions)) > 1:
        copies = result.audit.near_duplicates
        if copies >= MAX_ALTERED * len(scored):
            values: dict[str, int | float | str] = {"count": copies, "held": len(scored)}
            found.append(Finding(code=FindingCode.SESSIONS_COPIED, values=values))
    return {"sessions": sessions_card(job.run, held, pairs, job.plan.coverage, tuple(found))}


FORMAT = "palpate-evaluation/1"
PREFIX, SUFFIX = "evaluation-", ".json"
MAX_BYTES = 4_000_000
DIGITS = 12  # of a run's hash, in a file's name


class EvaluationRecord(SealedCard):
    """Scores of a calibration on a run.

    Attributes:
        id: hash of everything else here.
        calibration: id of the card.
        run: ``run_id``, ``hash``, and ``frames`` of the scored run.
        session: name of the run's sessions.
        same_session: why this tests no other day; empty where it does.
        targets: scores by target column.
        frames_valid: frames with some identifiable target and no refused reading of one.
        frames_untold: frames whose interval is as wide as the range, by column.
        frames_all_valid: frames with a valid reading of everything that the calibration reads.
        findings: sentences on columns whose intervals do not keep the promise.
        instruments: sentences on targets whose labels are by another instrument than the card's.
        groups: number of groups (presses).
        reference: one no-contact image was given for all.
    """

    format: Literal["palpate-evaluation/1"]
    calibration: str
    created_utc: str
    software: str
    run: dict[str, str | int]
    session: tuple[str, ...]
    same_session: str
    targets: dict[str, ScoreCard]
    frames_scored: int
    frames_read: int
    frames_valid: int
    groups: int
    reference: bool
    frames_untold: dict[str, int]
    frames_all_valid: int
    findings: dict[str, tuple[str, ...]]
    instruments: dict[str, str]
    valid_readings: dict[str, ValidScoreCard]

    def findings_of(self, column: str) -> tuple[str, ...]:
        """Sentences on a target whose intervals do not keep the promise here, with its name."""
        return self.findings.get(column, ())

    @property
    def of_another_session(self) -> bool:
        """True if it is of a session that the calibration has not learnt from."""
        return not self.same_session

    def same_as(self, other: EvaluationRecord) -> bool:
        """True if both are the same scores of the same run, whenever they were made."""
        when = {"id", "created_utc", "software"}
        return self.model_dump(exclude=when) == other.model_dump(exclude=when)


def keep_evaluation(folder: PathText, scores: dict[str, Any], *, reference: bool = False) -> Path:
    """Keep the scores of `evaluate` next to their card, and return the file; equal scores are kept once.

    Args:
        reference: one no-contact image was given for all frames.
    """
    folder = Path(folder)
    card = read_card(folder)
    if scores["calibration"] != card.id:
        raise CertificateError(
            f"these scores are of calibration {scores['calibration']}, and {folder} holds {card.id}; keep "
            f"them with the calibration they are of",
            code="other-calibration",
        )
    record = _sealed(scores, reference)
    stem = f"{PREFIX}{str(record.run['hash'])[:DIGITS]}"
    path, number = folder / f"{stem}{SUFFIX}", 1
    while path.exists() or path.is_symlink():
        if read_evaluation(path, card).same_as(record):
            return path
        number += 1
        path = folder / f"{stem}-{number}{SUFFIX}"
    with new_file(path) as file_path:
        file_path.write_text(record.model_dump_json(indent=1) + "\n", encoding="utf-8")
    return path


def _sealed(scores: dict[str, Any], reference: bool) -> EvaluationRecord:
    names = ("calibration", "run", "session", "same_session", "targets", "groups", "valid_readings")
    counts = ("frames_scored", "frames_read", "frames_valid", "frames_untold", "frames_all_valid")
    record = EvaluationRecord(
        format=FORMAT,
        id="",
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        software=f"palpate {__version__}",
        reference=reference,
        findings=scores["findings_of"],
        instruments=scores["instruments"],
        **{name: scores[name] for name in (*names, *counts)},
    )
    return record.model_copy(update={"id": card_id(record.model_dump(mode="json"))})


@parser("evaluation record", CertificateError)
def read_evaluation(path: Path, card: Card) -> EvaluationRecord:
    """Read and check one evaluation."""
    remedy = "move it away, and evaluate again"
    if path.is_symlink() or not path.is_file() or path.stat().st_size > MAX_BYTES:
        raise CertificateError(f"{path} is no evaluation that palpate wrote; {remedy}")
    with storage_errors(path):
        text = path.read_bytes()
    record = sealed_from(EvaluationRecord, text, path, FORMAT, "an evaluation", remedy)
    if record.calibration != card.id:
        raise CertificateError(
            f"{path} is of calibration {record.calibration}, and not of {card.id}, whose folder it lies in; "
            "move it to its own",
            code="other-calibration",
        )
    return record


def read_evaluations(folder: PathText, card: Card) -> tuple[EvaluationRecord, ...]:
    """Read all evaluations next to a card, the earliest first."""
    paths = sorted(Path(folder).glob(f"{PREFIX}*{SUFFIX}"))
    return in_order([read_evaluation(path, card) for path in paths])


def in_order(found: Sequence[EvaluationRecord]) -> tuple[EvaluationRecord, ...]:
    """Return evaluations, the earliest first."""
    return tuple(sorted(found, key=lambda one: one.created_utc))
