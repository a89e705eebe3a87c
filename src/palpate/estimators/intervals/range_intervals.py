"""Intervals that keep their rate in every part of a range: by the truth, and by the estimate.

One width for all rows covers too seldom at the ends of a range, where estimates are drawn towards the
middle. Where it does, cells of the range have a band of their own for the scaled error
r = (truth - estimate) / spread,

    |r - centre| <= half

A truth y is kept where y lies in a cell of truths whose band holds (y - estimate) / spread, so that truths of
every cell are covered at the stated rate (label-conditional conformal prediction: V. Vovk, A. Gammerman and
G. Shafer, Algorithmic Learning in a Random World, 2005, ch. 4.5, doi:10.1007/b106715). The band of the
estimate's own cell does the same for cells of estimates (Mondrian conformal regression: H. Boström and U.
Johansson, Proc. Mach. Learn. Res. 128, 114 (2020)). The interval is the least one that holds these and the
one of one width. How the bands are found: `calibration.coverage.range_fit`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Float, Int

Row = Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class ErrorCells:
    """Bands of the scaled error, one in each cell of a range; the outermost cells have no end.

    Attributes:
        limits: between neighbouring cells, ascending ``[m]``, one fewer than cells, in the target's unit.
        centre, half: of each cell's band ``[k]``, in units of the spread; a half of 0 is no band.
    """

    limits: Float[np.ndarray, " m"]
    centre: Float[np.ndarray, " k"]
    half: Float[np.ndarray, " k"]

    def cells(self, values: Row) -> Int[np.ndarray, " n"]:
        """Number of each value's cell."""
        return np.searchsorted(self.limits, values, side="right")

    def of_estimates(self, estimate: Row, spread: Row) -> tuple[Row, Row]:
        """Ends of the band of each estimate's own cell; inf and -inf where it has none."""
        at = self.cells(estimate)
        middle, half = estimate + spread * self.centre[at], spread * self.half[at]
        some = half > 0
        return np.where(some, middle - half, np.inf), np.where(some, middle + half, -np.inf)

    def of_truths(self, estimate: Row, spread: Row) -> tuple[Row, Row]:
        """Least and greatest truth that its own cell's band keeps; inf and -inf where there is none."""
        middle, reach = estimate[:, None] + spread[:, None] * self.centre, spread[:, None] * self.half
        least, greatest = middle - reach, middle + reach
        least[:, 1:] = np.maximum(least[:, 1:], self.limits)
        greatest[:, :-1] = np.minimum(greatest[:, :-1], self.limits)
        kept = (least <= greatest) & (self.half > 0)
        return np.where(kept, least, np.inf).min(axis=1), np.where(kept, greatest, -np.inf).max(axis=1)


@dataclass(frozen=True, slots=True)
class RangeIntervals:
    """Intervals of one target that cover at their rate in every cell of its truths and of its estimates.

    Attributes:
        by_truth: bands in cells of the truth.
        by_estimate: bands in cells of the estimate.
    """

    by_truth: ErrorCells
    by_estimate: ErrorCells

    def ends(self, estimate: Row, spread: Row, half: Row) -> tuple[Row, Row]:
        """Ends of the interval around each estimate, low <= estimate <= high.

        Args:
            estimate: in the target's unit.
            spread: expected size of its error, in the same unit.
            half: half-width of the interval of one width.
        """
        low, high = estimate - half, estimate + half
        for least, greatest in (
            self.by_truth.of_truths(estimate, spread),
            self.by_estimate.of_estimates(estimate, spread),
        ):
            low, high = np.minimum(low, least), np.maximum(high, greatest)
        return low, high
