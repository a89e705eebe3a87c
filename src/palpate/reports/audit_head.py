"""Head of what the audits found: whether they failed, and of which targets."""

from __future__ import annotations

from palpate.estimators.intervals import layout_of
from palpate.estimators.model_card import Card, TargetCard


def audit_head(card: Card) -> str:
    """What the findings of a card come to, and of which targets."""
    if card.split.clean and not (card.confounds and card.confounds.failed):
        return "The audit warns"
    named = [t.quantity.replace("_", " ") for t in card.targets if not_relied_on(card, t)]
    if len(named) in (0, len(card.targets)):
        return "The audit failed: do not rely on these scores"
    return f"The audit failed: do not rely on the scores of {', '.join(named)}"


def not_relied_on(card: Card, target: TargetCard) -> bool:
    """True where an audit failed over a target, or over all."""
    j, layout = card.columns.index(target.column), layout_of(card)
    own = {target.column, *layout.names(card.columns)[layout.outputs_of(j)], ""}
    found = card.confounds.findings if card.confounds else ()
    return not card.split.clean or any(f.severity == "fails" and f.target in own for f in found)
