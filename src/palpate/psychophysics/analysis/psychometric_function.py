"""Psychometric functions: the probability of an answer over the level of a stimulus.

    P(level) = guess + (1 - guess - lapse) F(F⁻¹(1/2) + (F⁻¹(3/4) - F⁻¹(1/2)) (x - threshold) / spread)

x is the level or its natural logarithm; F is a cumulative Gaussian, a logistic, or 1 - exp(-exp(z)) (Weibull
over logarithmic levels). `spread` is the just noticeable difference; over logarithmic levels exp(spread) - 1
is a Weber fraction.

Reference: F. A. Wichmann, N. J. Hill, Percept. Psychophys. 63 (2001) 1293, doi:10.3758/BF03194544.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from scipy import special

from palpate.core import InputError, RangeError, ndarray

LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)


class SigmoidShape(StrEnum):
    """Which sigmoid: cumulative Gaussian, logistic, or Weibull's, the last over logarithmic levels alone."""

    GAUSSIAN = "gaussian"
    LOGISTIC = "logistic"
    WEIBULL = "weibull"

    def rise(self, z: Any) -> ndarray:
        """F(z), from 0 to 1."""
        z = np.asarray(z, np.float64)
        if self is SigmoidShape.GAUSSIAN:
            return np.asarray(special.ndtr(z))
        if self is SigmoidShape.LOGISTIC:
            return np.asarray(special.expit(z))
        return np.asarray(-np.expm1(-np.exp(np.minimum(z, 50.0))))

    def slope(self, z: Any) -> ndarray:
        """dF/dz."""
        z = np.asarray(z, np.float64)
        if self is SigmoidShape.GAUSSIAN:
            return np.asarray(np.exp(-0.5 * z**2 - LOG_SQRT_2PI))
        if self is SigmoidShape.LOGISTIC:
            return np.asarray(special.expit(z) * special.expit(-z))
        z = np.minimum(z, 50.0)
        return np.asarray(np.exp(z - np.exp(z)))

    def inverse(self, share: Any) -> ndarray:
        """Place z at which F is a share."""
        share = np.asarray(share, np.float64)
        if self is SigmoidShape.GAUSSIAN:
            return np.asarray(special.ndtri(share))
        if self is SigmoidShape.LOGISTIC:
            return np.asarray(special.logit(share))
        return np.asarray(np.log(-np.log1p(-share)))

    @property
    def middle(self) -> float:
        """Place z at which F is 1/2."""
        return float(self.inverse(0.5))

    @property
    def reach(self) -> float:
        """How much further in z F is 3/4."""
        return float(self.inverse(0.75)) - self.middle


@dataclass(frozen=True, slots=True)
class PsychometricFunction:
    """Psychometric function; call it for the probability at levels.

    Attributes:
        threshold: level at which F is 1/2.
        spread: distance from there to F = 3/4 [unit of the level, or its natural logarithm].
        guess, lapse: probability far below, and 1 minus that far above.
    """

    shape: SigmoidShape
    threshold: float
    spread: float
    guess: float = 0.0
    lapse: float = 0.0
    logarithmic: bool = False

    def __post_init__(self) -> None:
        checked_rates(self.guess, self.lapse)
        if not self.spread > 0:
            raise RangeError(
                f"a spread of {self.spread:g}; above 0 is needed, in the level's unit", code="spread"
            )
        if self.shape is SigmoidShape.WEIBULL and not self.logarithmic:
            raise InputError("Weibull's function is one of logarithmic levels; ask for logarithmic=True")
        as_counted(np.array([self.threshold]), logarithmic=self.logarithmic)

    def __call__(self, level: Any) -> ndarray:
        """Probability of the answer at levels [the threshold's unit]."""
        x = as_counted(np.asarray(level, np.float64), logarithmic=self.logarithmic)
        t = math.log(self.threshold) if self.logarithmic else self.threshold
        z = self.shape.middle + self.shape.reach * (x - t) / self.spread
        return np.asarray(self.guess + (1 - self.guess - self.lapse) * self.shape.rise(z))


def checked_rates(guess: float, lapse: float) -> None:
    """Refuse rates of guesses and lapses that leave no rise."""
    if guess < 0 or lapse < 0 or guess + lapse >= 1:
        raise RangeError(
            f"guesses of {guess:g} and lapses of {lapse:g}; each is 0 or more, and together they are below 1",
            code="guess-and-lapse",
        )


def as_counted(levels: ndarray, *, logarithmic: bool) -> ndarray:
    """Levels as they count: themselves, or their natural logarithm."""
    if not np.isfinite(levels).all() or (logarithmic and (levels <= 0).any()):
        what = "above 0 and finite" if logarithmic else "finite"
        raise RangeError(
            f"levels from {np.min(levels):g} to {np.max(levels):g}; all have to be {what}", code="levels"
        )
    return np.asarray(np.log(levels)) if logarithmic else levels
