"""Intervals with the nominal coverage in every part of a range: by the truth, and by the estimate.

Cells of the range have their own band of the scaled error r = (truth - estimate) / spread, |r - centre| <=
half. A truth y is kept if the band of its cell of truths holds its error (label-conditional conformal
prediction: V. Vovk, A. Gammerman and G. Shafer, Algorithmic Learning in a Random World, 2005, ch. 4.5,
doi:10.1007/b106715). Cells of estimates are treated alike (Mondrian conformal regression: H. Boström and U.
Johansson, Proc. Mach. Learn. Res. 128, 114 (2020)). The interval is the smallest that holds these and the one
of constant width. See `range_fit`.
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
        limits: Ascending limits between cells, in the target's unit.
        centre, half: Band of each cell in units of the spread; a half of 0 is no band.
    """

    limits: Float[np.ndarray, " m"]
    centre: Float[np.ndarray, " k"]
    half: Float[np.ndarray, " k"]

    def cells(self, values: Row) -> Int[np.ndarray, " n"]:
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
    """Intervals with the nominal coverage in every cell of truths and of estimates."""

    by_truth: ErrorCells
    by_estimate: ErrorCells

    def ends(self, estimate: Row, spread: Row, half: Row) -> tuple[Row, Row]:
        """Return the ends of the interval around each estimate, low <= estimate <= high.

        Args:
            estimate: Estimate in the target's unit.
            spread: Expected error size.
            half: Half-width of the interval of constant width.
        """
        low, high = estimate - half, estimate + half
        for least, greatest in (
            self.by_truth.of_truths(estimate, spread),
            self.by_estimate.of_estimates(estimate, spread),
        ):
            low, high = np.minimum(low, least), np.maximum(high, greatest)
        return low, high
