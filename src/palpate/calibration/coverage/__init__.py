"""Coverage in parts: over a target's range, of several targets together, and where a range ends."""

from palpate.calibration.coverage.range_findings import card_findings, target_findings
from palpate.calibration.coverage.range_fit import fit_range_intervals
from palpate.calibration.coverage.range_limits import range_cards
from palpate.calibration.coverage.range_scores import failing, range_scores, range_sentences

__all__ = [
    "card_findings", "failing", "fit_range_intervals", "range_cards", "range_scores", "range_sentences",
    "target_findings",
]  # fmt: skip
