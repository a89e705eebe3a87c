"""A straight line through points, with what a new point may be."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from palpate.core import Float, InputError, ndarray

Values = Float[ndarray, " n"]


@dataclass(frozen=True)
class Line:
    """y = slope x + start.

    Attributes:
        slope, start: of the line, in y's unit over x's and in y's.
        slope_low, slope_high: 95 % interval of the slope, if the points are independent.
        adjusted_r2: 1 less the residual variance over y's.
        n: points.
        mean_x: of the points, in x's unit.
        sxx: sum of squares of x around it.
        residual: standard deviation of y around the line, with n - 2 degrees of freedom.
    """

    slope: float
    start: float
    slope_low: float
    slope_high: float
    adjusted_r2: float
    n: int
    mean_x: float
    sxx: float
    residual: float

    def at(self, x: float, coverage: float = 0.9) -> tuple[float, float, float]:
        """The line at x, and the interval that holds a new point so often; infinite for two points."""
        y = self.slope * x + self.start
        if self.n < 3:
            return y, -np.inf, np.inf
        spread = self.residual * math.sqrt(1 + 1 / self.n + (x - self.mean_x) ** 2 / self.sxx)
        half = float(stats.t.ppf((1 + coverage) / 2, self.n - 2)) * spread
        return y, y - half, y + half


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
    fit, n = stats.linregress(x, y), len(x)
    sxx = float(np.sum((x - x.mean()) ** 2))
    half = float(stats.t.ppf(0.975, n - 2) * fit.stderr) if n > 2 else float("nan")
    adjusted = 1 - (1 - fit.rvalue**2) * (n - 1) / (n - 2) if n > 2 else float("nan")
    return Line(
        slope=float(fit.slope),
        start=float(fit.intercept),
        slope_low=float(fit.slope - half),
        slope_high=float(fit.slope + half),
        adjusted_r2=float(adjusted),
        n=n,
        mean_x=float(x.mean()),
        sxx=sxx,
        residual=float(fit.stderr) * math.sqrt(sxx),
    )
