"""A deformed layer of triquadratic bricks, read where things are now and not where they were.

The layer's planes before loading make a regular grid, so that a place before loading tells its brick at once;
where a place now was before is found by Newton's method from the nearest of many known places.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

INVERSIONS = 12
FINER = 2  # known places to a node's spacing, each way

Points = Float[ndarray, "n 3"]


@dataclass(frozen=True)
class NodalField:
    """Values at the nodes of a grid of triquadratic bricks.

    Attributes:
        values: at the planes and halfway between them ``[x y z c]``.
    """

    knots: tuple[ndarray, ndarray, ndarray]
    values: Float[ndarray, "x y z c"]

    def at(self, X: Points) -> tuple[Float[ndarray, "n c"], Float[ndarray, "n c 3"]]:
        """Values and their slopes at places before loading."""
        first, shapes, slopes = zip(
            *(_along(k, x) for k, x in zip(self.knots, X.T, strict=True)), strict=True
        )
        value = np.zeros((len(X), self.values.shape[-1]))
        slope = np.zeros((*value.shape, 3))
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    node = self.values[first[0] + a, first[1] + b, first[2] + c]
                    N = [shapes[0][:, a], shapes[1][:, b], shapes[2][:, c]]
                    D = [slopes[0][:, a], slopes[1][:, b], slopes[2][:, c]]
                    value += (N[0] * N[1] * N[2])[:, None] * node
                    for i, w in enumerate((D[0] * N[1] * N[2], N[0] * D[1] * N[2], N[0] * N[1] * D[2])):
                        slope[..., i] += w[:, None] * node
        return value, slope


def _along(knots: ndarray, x: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """First node, shapes and slopes along one axis."""
    i = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    half = (knots[i + 1] - knots[i]) / 2
    t = (x - knots[i]) / half - 1.0
    shapes = np.stack([t * (t - 1) / 2, 1 - t * t, t * (t + 1) / 2], axis=1)
    return 2 * i, shapes, np.stack([t - 0.5, -2 * t, t + 0.5], axis=1) / half[:, None]


@dataclass(frozen=True)
class Now:
    """The layer as it is now: where its nodes are."""

    place: NodalField

    @cached_property
    def _ends(self) -> ndarray:
        return np.array([k[-1] for k in self.place.knots])

    def tops(self, x: ndarray, y: ndarray) -> Points:
        """Where the places of the top that are over (x, y) now were before."""
        return self._found(np.stack([x, y], axis=1), 2)

    def before(self, places: Points) -> Points:
        """Where places were before; those outside, the body's nearest by Newton's method."""
        return self._found(places, 3)

    def _found(self, places: ndarray, n: int) -> Points:
        known, X = self._known(n)
        X = X[cKDTree(known[:, :n]).query(places)[1]].copy()
        best, least = X.copy(), np.full(len(X), np.inf)
        for _ in range(INVERSIONS):
            now, slope = self.place.at(X)
            miss = places - now[:, :n]
            better = np.linalg.norm(miss, axis=1) < least
            best[better], least[better] = X[better], np.linalg.norm(miss, axis=1)[better]
            move = np.linalg.solve(slope[:, :n, :n] + 1e-12 * np.eye(n), miss[..., None])[..., 0]
            size = np.linalg.norm(move, axis=1, keepdims=True)
            X[:, :n] += move * np.minimum(1.0, 0.1 / np.maximum(size, 1e-12))
            X = np.clip(X, 0.0, self._ends)
        return best

    def _known(self, n: int) -> tuple[Points, Points]:
        axes = [
            np.unique(np.concatenate([np.linspace(a, b, 2 * FINER + 1) for a, b in pairwise(k)]))
            for k in self.place.knots
        ]
        axes[2] = axes[2] if n == 3 else np.zeros(1)
        X = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return self.place.at(X)[0], X
