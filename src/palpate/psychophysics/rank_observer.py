"""Gaussian observer that ranks stimuli or names the softer of two.

Percepts are positions plus independent unit-variance noise; a pair d apart is correct with Phi(d / sqrt 2).
The probability of rank j is an integral of a Poisson binomial law,

    M_ij = E_x [ P(exactly j - 1 of the others lie below x) ],   x ~ N(place_i, 1),

by Gauss-Hermite quadrature. Lapses (random rankings) and reversals (order reversed) can be mixed in.

Reference: L. L. Thurstone, Psychol. Rev. 34 (1927) 273, doi:10.1037/h0070288.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from palpate.core import Float, InputError, Int, RangeError, ndarray

NODES_OF_PERCEPT = 80
MATRIX_ERROR = 1e-6  # of an element, for stimuli up to 4 standard deviations apart; tested

RankMatrix = Float[ndarray, "m m"]


@dataclass(frozen=True)
class RankObserver:
    """Observer of stimuli at `places` (least soft first, in noise SD) with rates of lapses and reversals."""

    places: tuple[float, ...]
    lapse: float = 0.0
    reversal: float = 0.0

    def __post_init__(self) -> None:
        if len(self.places) < 2:
            raise InputError(
                f"{len(self.places)} places; an observer ranks two stimuli or more", code="too-few-stimuli"
            )
        if not np.isfinite(self.places).all():
            raise RangeError("a place that is not finite; places are in standard deviations of the noise")
        if min(self.lapse, self.reversal) < 0 or self.lapse + self.reversal > 1:
            raise RangeError(
                f"lapses of {self.lapse:g} and reversals of {self.reversal:g}; each is 0 or more, and "
                "together they are 1 at most",
                code="lapse-and-reversal",
            )

    @classmethod
    def evenly(
        cls, sensitivity: float, stimuli: int = 5, lapse: float = 0.0, reversal: float = 0.0
    ) -> RankObserver:
        """Return an observer of equidistant stimuli, `sensitivity` (d') apart."""
        return cls(tuple(sensitivity * i for i in range(stimuli)), lapse, reversal)

    def rank_matrix(self) -> RankMatrix:
        """Probability of each rank (column) for each stimulus (row), to `MATRIX_ERROR`."""
        return mixed_matrix(gaussian_matrix(self.places), self.lapse, self.reversal)

    def total_accuracy(self) -> float:
        """Expected share of right places in rankings."""
        return float(np.trace(self.rank_matrix()) / len(self.places))

    def pair_accuracy(self, one: int, other: int) -> float:
        """Probability of naming the softer of two stimuli, by their numbers from 0."""
        low, high = sorted((one, other))
        p = float(special.ndtr((self.places[high] - self.places[low]) / math.sqrt(2)))
        return (1 - self.lapse - self.reversal) * p + self.reversal * (1 - p) + self.lapse / 2

    def drawn_places(self, rankings: int, rng: np.random.Generator) -> Int[ndarray, "n m"]:
        """Places given to the stimuli in so many simulated rankings, from 0."""
        m = len(self.places)
        percept = np.array(self.places) + rng.standard_normal((rankings, m))
        u = rng.random((rankings, 1))
        percept = np.where(u < self.reversal, -percept, percept)
        percept = np.where(u >= 1 - self.lapse, rng.standard_normal((rankings, m)), percept)
        return np.argsort(np.argsort(percept, axis=1), axis=1)


def gaussian_matrix(places: Sequence[float] | ndarray) -> Float[ndarray, "*sets m m"]:
    """Rank matrix of Gaussian percepts, without faults; of many rows of places at once, one each."""
    at = np.asarray(places, np.float64)
    m = at.shape[-1]
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES_OF_PERCEPT)
    below = special.ndtr(
        at[..., None, None] + nodes[:, None] - at[..., None, None, :]
    )  # stimulus, node, other
    count = np.zeros((*at.shape, m, len(nodes)))
    count[..., 0, :] = 1.0
    for k in range(m):
        p = below[..., k].copy()
        p[..., k, :] = 0.0  # a stimulus is none of its others
        p = p[..., None, :]
        count[..., 1:, :] = count[..., 1:, :] * (1 - p) + count[..., :-1, :] * p
        count[..., :1, :] *= 1 - p
    return np.asarray(count @ (weights / weights.sum()))


def mixed_matrix(
    matrix: Float[ndarray, "*sets m m"], lapse: float | ndarray, reversal: float | ndarray
) -> Float[ndarray, "*sets m m"]:
    """A rank matrix with lapses and reversals mixed in."""
    return (1 - lapse - reversal) * matrix + reversal * matrix[..., ::-1] + lapse / matrix.shape[-1]
