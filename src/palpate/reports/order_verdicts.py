"""Verdict on the order of the rows: of which targets the card's score says nothing, and which one does."""

from __future__ import annotations

from palpate.core import rounded
from palpate.estimators.finding_cards import SplitScoreCard
from palpate.estimators.model_card import Card, TargetCard
from palpate.reports.score_intervals import mean_error_half_width


def order_verdicts(card: Card) -> dict[str, str]:
    """A sentence on each target whose score by the card's own split says nothing of new rows.

    Returns:
        By the target's column, without its name; empty where shuffled folds and blocks may be compared.
    """
    if card.order is None or not card.order.splits:
        return {}
    own, *beside = card.order.splits
    return {
        t.column: _verdict(t, own, beside[0] if beside else None)
        for t in card.targets
        if t.column in own.meaningless
    }


def order_sentences(card: Card) -> list[str]:
    """The verdicts with the names of their targets, to stand before any number."""
    names = {target.column: target.quantity.replace("_", " ") for target in card.targets}
    return [f"{names[column]}: {sentence}" for column, sentence in order_verdicts(card).items()]


def _verdict(target: TargetCard, own: SplitScoreCard, beside: SplitScoreCard | None) -> str:
    mine, name = _scored(target, own), target.quantity.replace("_", " ")
    if own.kind != "random":
        return (
            f"{mine}: each block holds out a part of the range of {name} that was not trained on, so that "
            "this measures extrapolation alone; ask for shorter ones (--split blocks)"
        )
    if beside is None:
        return f"{mine}: rows lie in order of {name}, so calibrate with --split blocks and read those"
    both = f"{mine}, {_scored(target, beside)}: rows lie in order of {name}"
    if target.column in beside.meaningless:
        return f"{both}, and each block holds out a part of its range; ask for shorter ones (--split blocks)"
    return f"{both}, so read the blocks"


def _scored(target: TargetCard, one: SplitScoreCard) -> str:
    by = "shuffled folds" if one.kind == "random" else "blocks"
    off = mean_error_half_width(target.score, target.score.n)
    return f"{by} {rounded(one.mae[target.column], off)} {target.unit}"
