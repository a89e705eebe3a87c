"""Evaluations kept beside a card: one file each, which names the card and cannot be altered unnoticed.

They lie in the calibration's folder as ``evaluation-RUN.json``, RUN being the first digits of the run's hash.
The card is not touched. One that is damaged, or of another card, is refused by name.
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
DIGITS = 12
"""Of a run's hash, in a file's name."""


class EvaluationRecord(SealedCard):
    """Scores of a calibration on a run, as kept beside its card.

    Attributes:
        id: hash of everything else here.
        calibration: id of the card, which is a hash of all that it says.
        created_utc, software: when and by what it was made.
        run: ``run_id``, ``hash`` and ``frames`` of the run scored on.
        session: name of the run's session, or of its sessions.
        same_session: why this tests no other day: none than was learnt from, or labels outside what was
            calibrated; empty where it tests one.
        targets: scores of each target's column.
        frames_scored, frames_read: how many frames were scored, and could be read.
        frames_valid: how many tell some target, and have no reading of a target that they tell refused by
            guard or range rule.
        frames_untold: how many frames do not tell a target, by its column; all where it is not read.
        frames_all_valid: how many gave a valid reading of everything that the calibration reads.
        findings: sentences on each target's column whose intervals do not keep the promise here.
        instruments: a sentence on each target whose labels are by another instrument than the card's.
        valid_readings: scores of each target's valid readings alone.
        groups: how many groups (presses) these are of.
        reference: whether one image of the untouched sensor was given for all.
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
    """Keep the scores of `evaluate` beside the card that they are of.

    The same scores are kept once. Others of the same run, as with another reference, get a file of their own.

    Args:
        folder: the calibration.
        scores: what `evaluate` returned for it.
        reference: whether one image of the untouched sensor was given for all frames.

    Returns:
        The file that holds them.

    Raises:
        CertificateError: the scores are of another calibration, or a file that is there is damaged.
        StorageError: the disk is full or refuses.
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
    """Read and check one evaluation.

    Raises:
        CertificateError: it is damaged or altered, of another card, or another version of palpate has to
            read it.
    """
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
    """All evaluations beside a card, the earliest first.

    Raises:
        CertificateError: one is damaged, altered, or of another card; the message names it.
    """
    paths = sorted(Path(folder).glob(f"{PREFIX}*{SUFFIX}"))
    return in_order([read_evaluation(path, card) for path in paths])


def in_order(found: Sequence[EvaluationRecord]) -> tuple[EvaluationRecord, ...]:
    """Evaluations, the earliest first."""
    return tuple(sorted(found, key=lambda one: one.created_utc))
