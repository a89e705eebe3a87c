"""Uncertainty of the reference instrument in the interval of a reading.

Systematic errors such as a force sensor's scale are in no held-out error. They add in quadrature (JCGM
100:2008, GUM, eq. 10) on each side of the estimate, side = sqrt(side_model² + (k u)²), with k of the normal
distribution at the interval's coverage, or of the chi distribution for a joint region (`joint_reach`).
"""

from __future__ import annotations

from statistics import NormalDist
from typing import TypeVar

import numpy as np

from palpate.estimators.model_card import TargetCard

Place = TypeVar("Place", float, np.ndarray)


def reference_half_width(standard_uncertainty: float, coverage: float) -> float:
    """Return the half-width k u of the interval from a standard uncertainty alone.

    Example:
        >>> round(reference_half_width(0.02, 0.9), 4)
        0.0329
    """
    return standard_uncertainty * NormalDist().inv_cdf((1 + coverage) / 2)


def with_reference(target: TargetCard, value: Place, low: Place, high: Place) -> tuple[Place, Place]:
    """Return the ends of the interval for the true quantity, from those for the instrument's value."""
    if target.measured_by is None or target.measured_by.half_width == 0:
        return low, high
    half = target.measured_by.half_width
    return value - np.hypot(value - low, half), value + np.hypot(high - value, half)


def without_reference(target: TargetCard, value: Place, low: Place, high: Place) -> tuple[Place, Place]:
    """Return the ends of the interval for the instrument's value: the inverse of `with_reference`."""
    if target.measured_by is None or target.measured_by.half_width == 0:
        return low, high
    half = target.measured_by.half_width
    below, above = (np.sqrt(np.maximum(side**2 - half**2, 0)) for side in (value - low, high - value))
    return value - below, value + above
