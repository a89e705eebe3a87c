"""Compliance by touch: force of a press or a grasp, the contact's area and spread rate, the gel's bulge."""

from palpate.estimators.compliance.gel_curvature import ImprintRegion, Lamps, bulge
from palpate.estimators.compliance.press_force import (
    Loading,
    fresh,
    loading,
    loading_slope,
    moving_average,
    rising,
    within,
    without_spikes,
)
from palpate.estimators.compliance.spread_rate import (
    SpreadRate,
    area_m2,
    paper_spread,
    refuse_literal,
    spread,
    summed_slopes,
)

__all__ = [
    "ImprintRegion", "Lamps", "Loading", "SpreadRate", "area_m2", "bulge", "fresh", "loading",
    "loading_slope", "moving_average", "paper_spread", "refuse_literal",
    "rising", "spread", "summed_slopes", "within", "without_spikes",
]  # fmt: skip
