"""A polynomial of the pose through the places of pins: what of a tap its pose tells smoothly."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from palpate.core import Float, ndarray

RIDGE = 1e-6  # of the taps: only keeps what no tap tells at 0
TAPS_EACH = 3  # for each monomial, for a degree to be told
ROUNDS = 3  # of filling missing pins by the polynomial itself


@dataclass(frozen=True)
class PosePolynomial:
    """Places of pins over a pose.

    Attributes:
        middle, spread: of the poses ``[q]``.
        degree: of the polynomial.
        weights: by monomial and coordinate ``[m p 2]``.
    """

    middle: Float[ndarray, " q"]
    spread: Float[ndarray, " q"]
    degree: int
    weights: Float[ndarray, "m p 2"]

    @classmethod
    def fitted(
        cls, poses: Float[ndarray, "t q"], places: Float[ndarray, "t p 2"], degree: int
    ) -> PosePolynomial:
        """Least squares over taps; a pin that a tap misses (NaN) does not count in it."""
        middle, spread = poses.mean(axis=0), poses.std(axis=0)
        X = monomials((poses - middle) / spread, degree)
        flat = places.reshape(len(places), -1)
        missing = np.isnan(flat)
        flat = np.where(missing, np.nanmedian(flat, axis=0), flat)
        solve = np.linalg.solve(X.T @ X + RIDGE * len(X) * np.eye(X.shape[1]), X.T)
        for _ in range(ROUNDS):
            W = solve @ flat
            flat = np.where(missing, X @ W, flat)
        return cls(middle, spread, degree, (solve @ flat).reshape(-1, *places.shape[1:]))

    def at(self, poses: Float[ndarray, "t q"]) -> Float[ndarray, "t p 2"]:
        """Places at other poses."""
        X = monomials((poses - self.middle) / self.spread, self.degree)
        return np.tensordot(X, self.weights, 1)


def told_by(poses: Float[ndarray, "t q"], degree: int) -> int:
    """The degree, or as high a one as so many taps tell."""
    while degree > 1 and len(poses) < TAPS_EACH * monomials(poses[:1], degree).shape[1]:
        degree -= 1
    return degree


def monomials(at: Float[ndarray, "n q"], degree: int) -> Float[ndarray, "n m"]:
    """All products of up to `degree` of the columns, the constant first."""
    columns = [np.ones(len(at))]
    for d in range(1, degree + 1):
        for which in combinations_with_replacement(range(at.shape[1]), d):
            columns.append(np.prod(at[:, which], axis=1))
    return np.stack(columns, axis=1)
