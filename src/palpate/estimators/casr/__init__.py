"""Compliance by touch: force of a press or a grasp, the contact's area and spread rate, the gel's bulge."""

from palpate.estimators.casr.force import (
    Loading,
    loading,
    moving_average,
    moving_average_response,
    rising,
    within,
    without_spikes,
)
from palpate.estimators.casr.grip import at_force, fresh, loading_slope
from palpate.estimators.casr.imprint import Lamps, Region, bulge
from palpate.estimators.casr.spread import (
    Spread,
    area_m2,
    paper_spread,
    refuse_literal,
    spread,
    summed_slopes,
)

__all__ = [
    "Lamps",
    "Loading",
    "Region",
    "Spread",
    "area_m2",
    "at_force",
    "bulge",
    "fresh",
    "loading",
    "loading_slope",
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
