"""Polynomial of the pose through the pin positions."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from palpate.core import Float, ndarray

RIDGE = 1e-6  # relative ridge, which keeps undetermined weights at 0
TAPS_EACH = 3  # minimum taps per monomial
ROUNDS = 3  # rounds of imputing missing pins


@dataclass(frozen=True)
class PosePolynomial:
    """Pin positions over a pose, with weights by monomial and coordinate."""

    middle: Float[ndarray, " q"]
    spread: Float[ndarray, " q"]
    degree: int
    weights: Float[ndarray, "m p 2"]

    @classmethod
    def fitted(
        cls, poses: Float[ndarray, "t q"], places: Float[ndarray, "t p 2"], degree: int
    ) -> PosePolynomial:
        """Fit by least squares over taps; missing pins are NaN."""
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
        X = monomials((poses - self.middle) / self.spread, self.degree)
        return np.tensordot(X, self.weights, 1)


def told_by(poses: Float[ndarray, "t q"], degree: int) -> int:
    """Return the degree, reduced to what the number of taps determines."""
    while degree > 1 and len(poses) < TAPS_EACH * monomials(poses[:1], degree).shape[1]:
        degree -= 1
    return degree


def monomials(at: Float[ndarray, "n q"], degree: int) -> Float[ndarray, "n m"]:
    """Return all products of up to `degree` of the columns, the constant first."""
    columns = [np.ones(len(at))]
    for d in range(1, degree + 1):
        for which in combinations_with_replacement(range(at.shape[1]), d):
            columns.append(np.prod(at[:, which], axis=1))
    return np.stack(columns, axis=1)
