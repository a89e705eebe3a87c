"""Half-widths of intervals, as a calibration has set them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core.shapes import Float, Values

LEAST, MOST = 0.2, 5.0
"""The spread is held between these multiples of the typical error: a quadratic fitted inside the
calibrated range must not run away outside it."""


def design(scaled: Values) -> Float[np.ndarray, "n k"]:
    """Terms of a quadratic in the scaled values: 1, each value, each product of two."""
    n, t = scaled.shape
    first, second = np.triu_indices(t)
    return np.concatenate([np.ones((n, 1)), scaled, scaled[:, first] * scaled[:, second]], axis=1)


@dataclass(frozen=True, slots=True)
class Spread:
    """Expected size of an estimate's error: log spread is a quadratic in the estimated values.

    Attributes:
        centre, scale: of the estimates, ``[t]`` each.
        typical: mean absolute held-out error ``[t]``.
        coefficients: of the quadratic of log(spread / typical), ``[t k]``, see `design`.
    """

    centre: Float[np.ndarray, " t"]
    scale: Float[np.ndarray, " t"]
    typical: Float[np.ndarray, " t"]
    coefficients: Float[np.ndarray, "t k"]

    def at(self, values: Values) -> Values:
        """The spread at these estimates ``[n t]``, in the targets' units."""
        scaled = np.clip((values - self.centre) / self.scale, -3.0, 3.0)
        ratio = np.exp(np.clip(design(scaled) @ self.coefficients.T, np.log(LEAST), np.log(MOST)))
        return self.typical * ratio


@dataclass(frozen=True, slots=True)
class Intervals:
    """half-width = quantile · spread.

    Attributes:
        spread: how the size of the error varies with the estimate.
        quantile: conformal quantile of the scaled held-out errors ``[t]``.
        coverage: how often the intervals hold the truth.
    """

    spread: Spread
    quantile: Float[np.ndarray, " t"]
    coverage: float

    def half_widths(self, values: Values) -> Values:
        """Half-width of the interval around each estimate ``[n t]``."""
        return self.quantile * self.spread.at(values)
