"""Sentences on a certificate: where in their range targets are not read as promised, and what mends it."""

from __future__ import annotations

from palpate.calibration.coverage.range_scores import range_sentences
from palpate.estimators.model_card import Card, TargetCard
from palpate.estimators.reading_rules import too_unsure
from palpate.estimators.target_layout import FULL_TURN

NEARLY_A_TURN = 350 / 360


def card_findings(card: Card) -> tuple[str, ...]:
    """What the reader of a certificate must know of its targets' ranges; empty where there is nothing."""
    return tuple(sentence for target in card.targets for sentence in target_findings(target, card.coverage))


def target_findings(target: TargetCard, coverage: float) -> tuple[str, ...]:
    """Sentences on one target, with its name.

    They name tenths of its range that cover too seldom, intervals as wide as the range, and a whole turn of
    angles that was learnt as a plain number.

    Args:
        target: its card.
        coverage: what its intervals promise.
    """
    name = target.quantity.replace("_", " ")
    tenths = () if target.over_range is None else target.over_range.tenths
    found = [f"{name}: {sentence}" for sentence in range_sentences(tenths, target.unit, coverage)]
    if why := too_unsure(target):
        found.append(f"{name} is not read: {why}")
    turn, span = FULL_TURN.get(target.unit), target.greatest - target.least
    if turn is not None and target.circular is None and span >= NEARLY_A_TURN * turn:
        found.append(
            f"{name} covers {span:.4g} {target.unit}, a whole turn, as a plain number: where the turn "
            f"closes, "
            f"readings are off by up to a turn; calibrate with --circular {target.column}"
        )
    return tuple(found)
