"""Comparisons placed for the greatest expected information on a psychometric function.

    P(x) = l/2 + (1 - l) Φ((x - m) / s)

over a grid of (m, s, l), uniform at first; the next comparison minimizes the expected entropy.

References: Kontsevich and Tyler, Vision Res. 39 (1999) 2729, doi:10.1016/S0042-6989(98)00285-5; Watson, J.
Vision 17(3):10 (2017), doi:10.1167/17.3.10.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, xlogy

from palpate.core import Float, InputError, ndarray

EQUALITIES, SPREADS = 21, 16  # grid points of m and s
LAPSES = (0.0, 0.02, 0.06)
DIGITS = 9  # entropies are compared to so many [nat], so that rounding decides nothing


@dataclass(frozen=True, slots=True)
class Placement:
    """Posterior of a participant over a flat grid of m, s, and l, for presentable softness
    differences `x`.
    """

    x: Float[ndarray, " k"]
    equality: Float[ndarray, " n"]
    spread: Float[ndarray, " n"]
    lapse: Float[ndarray, " n"]
    weight: Float[ndarray, " n"]

    @classmethod
    def of_differences(cls, x: Sequence[float]) -> Placement:
        """Return the uniform start: m spans half the range of `x`; s a quarter of the least to twice the
        range.
        """
        differences = np.asarray(x, float)
        if len(differences) < 2 or not np.all(differences):
            raise InputError("two comparisons or more are needed, each of another level than the standard")
        span = float(np.ptp(np.append(differences, 0.0)))
        least = float(np.abs(differences).min())
        grid = np.meshgrid(
            np.linspace(-span / 4, span / 4, EQUALITIES), np.geomspace(least / 4, 2 * span, SPREADS), LAPSES,
            indexing="ij",
        )  # fmt: skip
        equality, spread, lapse = (one.ravel() for one in grid)
        return cls(differences, equality, spread, lapse, np.full(len(lapse), 1 / len(lapse)))

    def chance(self) -> Float[ndarray, "k n"]:
        """Chance of "softer" at each difference, by each grid point."""
        core = ndtr((self.x[:, None] - self.equality) / self.spread)
        return self.lapse / 2 + (1 - self.lapse) * core

    def expected_entropy(self) -> Float[ndarray, " k"]:
        """Expected entropy of the grid after an answer at each difference [nat]."""
        yes = self.chance()
        total = np.zeros(len(self.x))
        for chance in (yes, 1 - yes):
            joint = chance * self.weight
            marginal = joint.sum(1)
            total += xlogy(marginal, marginal) - xlogy(joint, joint).sum(1)
        return total

    @property
    def next(self) -> int:
        """Index of the difference to present; of equals the first."""
        return int(np.argmin(np.round(self.expected_entropy(), DIGITS)))

    def after(self, index: int, softer: bool) -> Placement:
        """What is known after an answer at a difference."""
        chance = self.chance()[index]
        weight = self.weight * (chance if softer else 1 - chance)
        return Placement(self.x, self.equality, self.spread, self.lapse, weight / weight.sum())

    @property
    def mean(self) -> tuple[float, float]:
        """Posterior mean of m, and of s by its logarithm [unit of the level]."""
        m = float(self.weight @ self.equality)
        return m, float(np.exp(self.weight @ np.log(self.spread)))
