"""Evaluations kept next to a card as ``evaluation-RUN.json``, RUN being the first digits of the run's hash; a
damaged one, or one of another card, is refused by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from palpate.core import CertificateError, PathText, new_file, storage_errors
from palpate.core.parsing import parser
from palpate.estimators.card_ground import SealedCard, card_id, sealed_from
from palpate.estimators.certified import read_card
from palpate.estimators.finding_cards import ValidScoreCard
from palpate.estimators.model_card import Card, ScoreCard
from palpate.version import __version__

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
