"""Intervals of readings: from held-out errors, over the range of a target, for a vector as a whole."""

from palpate.estimators.intervals.error_intervals import (
    ErrorSpread,
    Intervals,
    design,
    intervals_of,
    layout_of,
    within,
)
from palpate.estimators.intervals.range_intervals import ErrorCells, RangeIntervals, Row
from palpate.estimators.intervals.vector_regions import (
    component_names,
    mahalanobis,
    vector_column,
    vector_reading,
)

__all__ = [
    "ErrorCells",
    "ErrorSpread",
    "Intervals",
    "RangeIntervals",
    "Row",
    "component_names",
    "design",
    "intervals_of",
    "layout_of",
    "mahalanobis",
    "vector_column",
    "vector_reading",
    "within",
]
