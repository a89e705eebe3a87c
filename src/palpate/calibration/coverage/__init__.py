"""Coverage in parts: over a target's range, of several targets together, and where a range ends."""

from palpate.calibration.coverage.conformal import fit_range_intervals
from palpate.calibration.coverage.range_scores import (
    card_findings,
    range_cards,
    range_scores,
    target_findings,
)

__all__ = ["card_findings", "fit_range_intervals", "range_cards", "range_scores", "target_findings"]
