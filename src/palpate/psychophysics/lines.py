"""A straight line through points, with what a new point may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import statsmodels.api as sm
from numpy import ndarray

from palpate.core.errors import InputError
from palpate.core.shapes import Float

Values = Float[ndarray, " n"]


@dataclass(frozen=True)
class Line:
    """y = slope x + start.

    Attributes:
        slope, start: of the line, in y's unit over x's and in y's.
        slope_low, slope_high: 95 % interval of the slope, if the points are independent.
        adjusted_r2: 1 less the residual variance over y's.
        n: points.
    """

    slope: float
    start: float
    slope_low: float
    slope_high: float
    adjusted_r2: float
    n: int
    _fit: object

    def at(self, x: float, coverage: float = 0.9) -> tuple[float, float, float]:
        """The line at x, and the interval that holds a new point so often; infinite for two points."""
        if self.n < 3:
            return self.slope * x + self.start, -np.inf, np.inf
        told = self._fit.get_prediction([[1.0, x]]).summary_frame(alpha=1 - coverage)  # type: ignore[attr-defined]
        return (
            float(told["mean"].iloc[0]),
            float(told["obs_ci_lower"].iloc[0]),
            float(told["obs_ci_upper"].iloc[0]),
        )


def fit_line(x: Values, y: Values) -> Line:
    """Least squares.

    Raises:
        InputError: fewer than two points, all at one x, or one that is not finite.
    """
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if x.shape != y.shape or x.ndim != 1 or len(x) < 2 or np.ptp(x) == 0:
        raise InputError(f"a line needs two points or more at different x; got {len(x)} and {len(y)} values")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("a line is through finite points; leave out those that are not")
    fit = sm.OLS(y, np.stack([np.ones_like(x), x], axis=1)).fit()
    low, high = fit.conf_int()[1] if len(x) > 2 else (np.nan, np.nan)
    adjusted = float(fit.rsquared_adj) if len(x) > 2 else float("nan")
    return Line(float(fit.params[1]), float(fit.params[0]), float(low), float(high), adjusted, len(x), fit)
