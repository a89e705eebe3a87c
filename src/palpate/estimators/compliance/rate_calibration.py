"""Calibration of the spread rate dA/dF, and of the area at one force, from areas against known values.

Areas of one press have correlated errors, so slopes of left-out trials are compared with true ones directly:
log of the true rate is a polynomial in log of the rate by areas. Its scatter, growing along the line, and the
error of predicting each reference from the others give the interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from palpate.core import Float, InputError, Int, ndarray
from palpate.estimators.compliance.stiffness_curve import student_quantile

MAX_DEGREE = 2
MAX_GROWTH = 1.5  # e-folds of the spread for each standard deviation of the references' rates
MAX_Z = 2.0  # standard deviations from the references' middle: farther the spread grows no more
MARGIN = 0.25  # of the logarithmic span of the references, by which an interval may reach beyond them
RECTANGULAR = np.sqrt(3.0)  # of a bound over the standard deviation of what lies anywhere within it

Values = Float[ndarray, " _"]


@dataclass(frozen=True)
class RateFit:
    """Log of the true rate as a polynomial of the standardized log rate by areas.

    Attributes:
        middle, scale: Standardization of the log rate by areas.
        coefficients: Polynomial coefficients, the constant first.
        covariance: Covariance of the coefficients in units of the squared spread.
        spread: Standard deviation of one trial at the middle.
        freedom: Trials less coefficients.
        between: RMS error of predicting references from the others, used as a bound.
        growth: Slope of log spread along the standardized rate.
        means: Mean true rate of each reference; None in earlier calibrations.
    """

    middle: float
    scale: float
    coefficients: Float[ndarray, " c"]
    covariance: Float[ndarray, "c c"]
    spread: float
    freedom: int
    between: float
    growth: float = 0.0
    means: Float[ndarray, " k"] | None = None

    @property
    def known(self) -> tuple[float, float] | None:
        """Range of valid intervals: the references and `MARGIN` of their span."""
        if self.means is None:
            return None
        low, high = np.log([self.means.min(), self.means.max()])
        beyond = MARGIN * (high - low)
        return float(np.exp(low - beyond)), float(np.exp(high + beyond))

    def of(self, rates_m2_n: Float[ndarray, " t"], coverage: float = 0.9) -> tuple[float, float, float]:
        """Return the true rate with its interval from trials' rates by areas on one specimen [m^2/N]."""
        z = (float(np.mean(np.log(rates_m2_n))) - self.middle) / self.scale
        powers = z ** np.arange(len(self.coefficients))
        log_rate = float(powers @ self.coefficients)
        own = self.spread * np.exp(self.growth * float(np.clip(z, -MAX_Z, MAX_Z)))
        spread = own * np.sqrt(1 / len(rates_m2_n) + powers @ self.covariance @ powers)
        half = float(student_quantile(coverage, self.freedom) * np.hypot(spread, self.between / RECTANGULAR))
        return float(np.exp(log_rate)), float(np.exp(log_rate - half)), float(np.exp(log_rate + half))


def fit_rate(by_areas: Sequence[float], true: Sequence[float], reference: Sequence[int]) -> RateFit:
    """Fit to trials of three or more references.

    Args:
        by_areas: Rate of each trial from areas fitted without it [m^2/N].
        true: True rate [m^2/N].
        reference: Index of each trial's reference.
    """
    x, y = np.asarray(by_areas, np.float64), np.asarray(true, np.float64)
    kinds = len(set(reference))
    if kinds < 3 or len(x) < kinds + 3:
        raise InputError(f"{len(x)} trials of {kinds} references with a known rate; six of three are needed")
    if not ((x > 0).all() and (y > 0).all()):
        raise InputError("a contact that shrinks as the force grows; look at the areas in the tables")
    x, y, which = np.log(x), np.log(y), np.asarray(reference)
    means = np.array([np.exp(y[which == kind].mean()) for kind in sorted(set(reference))])
    middle, scale = float(x.mean()), float(x.std() + 1e-12)
    z = (x - middle) / scale
    fit, covariance = _solved(z, y, min(MAX_DEGREE, kinds - 2))
    freedom = len(x) - len(fit) - 1  # one more for the growth
    off = y - _powers(z, len(fit)) @ fit
    growth = _growth(z, off)
    spread = float(np.sqrt(np.sum((off * np.exp(-growth * z)) ** 2) / freedom))
    return RateFit(middle, scale, fit, covariance, spread, freedom, _between(z, y, which), growth, means)


def _growth(z: Values, off: Values) -> float:
    """Maximum likelihood growth of log spread along z for Gaussian errors of zero mean."""
    if not off.any():
        return 0.0
    found = minimize_scalar(
        lambda b: np.log(np.mean((off * np.exp(-b * z)) ** 2)),
        bounds=(-MAX_GROWTH, MAX_GROWTH),
        method="bounded",
    )
    return float(found.x)


def _between(z: Values, y: Values, which: Int[ndarray, " t"]) -> float:
    """RMS error of log rate when the other references predict each one between them."""
    kinds = sorted(set(which), key=lambda kind: float(z[which == kind].mean()))
    off = []
    for kind in kinds[1:-1]:
        own = which == kind
        fit, _ = _solved(z[~own], y[~own], min(MAX_DEGREE, len(kinds) - 2))
        off.append(float(np.mean(_powers(z[own], len(fit)) @ fit - y[own])))
    return float(np.sqrt(np.mean(np.square(off))))


def _solved(z: Values, y: Values, degree: int) -> tuple[Values, Float[ndarray, "c c"]]:
    X = _powers(z, degree + 1)
    fit, *_ = np.linalg.lstsq(X, y, rcond=None)
    return fit, np.linalg.inv(X.T @ X)


def _powers(z: Values, count: int) -> Float[ndarray, "t c"]:
    return np.vander(z, count, increasing=True)
