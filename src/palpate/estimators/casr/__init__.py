"""Compliance by touch: the force of a press, the contact's area, and its spread rate."""

from palpate.estimators.casr.force import (
    Loading,
    loading,
    moving_average,
    moving_average_response,
    rising,
    within,
    without_spikes,
)
from palpate.estimators.casr.spread import (
    Spread,
    area_m2,
    paper_spread,
    refuse_literal,
    spread,
    summed_slopes,
)

__all__ = [
    "Loading",
    "Spread",
    "area_m2",
    "loading",
    "moving_average",
    "moving_average_response",
    "paper_spread",
    "refuse_literal",
    "rising",
    "spread",
    "summed_slopes",
    "within",
    "without_spikes",
]
