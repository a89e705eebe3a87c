"""The reference instrument's uncertainty in the interval of a reading, and out of it again.

What stays the same from row to row, such as the scale of a force sensor, is in no held-out error: estimates
follow the labels. Its standard uncertainty u is independent of the model's errors, so that both add in
quadrature (JCGM 100:2008, GUM, eq. 10), on each side of the estimate,

    side = sqrt(side_model² + (k u)²)

with k of the normal distribution at the interval's coverage. A region of several quantities together takes k
of the chi distribution with as many degrees of freedom, which is larger (`joint_reach`). What varies from row
to row, such as resolution, is in the held-out errors already and is not counted twice.
"""

from __future__ import annotations

from statistics import NormalDist
from typing import TypeVar

import numpy as np

from palpate.estimators.model_card import TargetCard

Place = TypeVar("Place", float, np.ndarray)


def reference_half_width(standard_uncertainty: float, coverage: float) -> float:
    """Half-width k u of the interval that a standard uncertainty alone gives.

    Example:
        >>> round(reference_half_width(0.02, 0.9), 4)
        0.0329
    """
    return standard_uncertainty * NormalDist().inv_cdf((1 + coverage) / 2)


def with_reference(target: TargetCard, value: Place, low: Place, high: Place) -> tuple[Place, Place]:
    """Ends of an interval for the true quantity, from those for what its instrument shows.

    Args:
        target: its card.
        value, low, high: estimates and the ends of the model's intervals, in the target's unit.
    """
    if target.measured_by is None or target.measured_by.half_width == 0:
        return low, high
    half = target.measured_by.half_width
    return value - np.hypot(value - low, half), value + np.hypot(high - value, half)


def without_reference(target: TargetCard, value: Place, low: Place, high: Place) -> tuple[Place, Place]:
    """Ends for what the instrument shows, by which labels are scored: `with_reference` undone."""
    if target.measured_by is None or target.measured_by.half_width == 0:
        return low, high
    half = target.measured_by.half_width
    below, above = (np.sqrt(np.maximum(side**2 - half**2, 0)) for side in (value - low, high - value))
    return value - below, value + above
