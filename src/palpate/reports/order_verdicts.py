"""Verdict on the order of the rows: which scores say nothing, which do, and what is left to do."""

from __future__ import annotations

from palpate.core import rounded
from palpate.estimators.finding_cards import ConfoundFindingCard, OrderCard, SplitScoreCard, is_sorted
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
        t.column: _told(t, card.order) or _verdict(t, own, beside[0] if beside else None)
        for t in card.targets
        if t.column in own.meaningless
        or own.tells_by_order(t.column)  # cards of before named no blocks for it
    }


def order_sentences(card: Card) -> list[str]:
    """The verdicts with the names of their targets, to stand before any number."""
    names = {target.column: target.quantity.replace("_", " ") for target in card.targets}
    return [f"{names[column]}: {sentence}" for column, sentence in order_verdicts(card).items()]


SHORTER = "ask for shorter ones (--split blocks:ROWS)"
"""What to do about blocks that are too long."""
UNTIL = "; until then"
"""Between what mends an order for good, in a finding's remedy, and what helps meanwhile."""


def remaining_remedy(card: Card, finding: ConfoundFindingCard, elsewhere: bool = False) -> str:
    """What a finding asks for, less what has been done: blocks that were scored, another session.

    Args:
        card: of the calibration.
        finding: of its audit; only of an order can a part have been done.
        elsewhere: whether it was evaluated on another session.
    """
    for_good, until, _ = finding.remedy.partition(UNTIL)
    if finding.kind != "order" or not until:
        return finding.remedy
    if elsewhere or _tested_on_sessions(card):
        return f"{for_good}{UNTIL}, rely only on what was found on other sessions"
    if _has_blocks(card):
        return f"{for_good}{UNTIL}, `palpate evaluate` on another session says what is true of it"
    return finding.remedy


def _tested_on_sessions(card: Card) -> bool:
    """True where whole sessions were held out."""
    return card.sessions is not None and card.sessions.held_out > 1 and card.sessions.column == "session"


def _has_blocks(card: Card) -> bool:
    """True where blocks were held out, or were scored beside what was."""
    kinds = [card.split.kind, *(one.kind for one in (card.order.splits if card.order else ()))]
    return any(kind.partition(":")[0] == "blocks" for kind in kinds)


def _verdict(target: TargetCard, own: SplitScoreCard, beside: SplitScoreCard | None) -> str:
    mine, name = _scored(target, own), target.quantity.replace("_", " ")
    if own.kind != "random":
        return (
            f"{mine}: each block holds out a part of the range of {name} that was not trained on, so that "
            f"this measures extrapolation alone; {SHORTER}"
        )
    if beside is None:
        return f"{mine}: rows lie in order of {name}, so calibrate with --split blocks and read those"
    both = f"{mine}, {_scored(target, beside)}: rows lie in order of {name}"
    if target.column in beside.meaningless:
        return f"{both}, and each block holds out a part of its range; {SHORTER}"
    return f"{both}, so read the blocks"


def _scored(target: TargetCard, one: SplitScoreCard) -> str:
    by = "shuffled folds" if one.kind == "random" else "blocks"
    off = mean_error_half_width(target.score, target.score.n)
    return f"{by} {rounded(one.mae[target.column], off)} {target.unit}"


def _told(target: TargetCard, order: OrderCard) -> str:
    """Sentence on a target that the rows' order alone tells by every split; empty where one hides it."""
    column, name = target.column, target.quantity.replace("_", " ")
    if not all(one.tells_by_order(column) for one in order.splits):
        return ""
    scored = ", ".join(_scored(target, one) for one in order.splits)
    if len(order.splits) > 1:
        share = 100 * min(one.order_r2[column] for one in order.splits)
        return (
            f"{scored}: rows lie in order of {name}, which alone tells {share:.0f} % of it by either split: "
            "neither says what the images tell; only another session does (palpate evaluate)"
        )
    if order.splits[0].kind == "random" and not is_sorted(order.rank_correlation.get(column, 0.0)):
        return ""
    return (
        f"{scored}: rows lie in order of {name}, which alone tells most of it by shuffled folds and by "
        "blocks: neither says what the images tell; only another session does (palpate evaluate)"
    )
