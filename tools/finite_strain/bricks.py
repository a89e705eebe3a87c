"""A block of 20-node bricks along three coordinates, at finite strain.

Bricks are serendipity elements with two points a direction, which keeps them from locking; the solid is that
of `neo_hookean`, here with its pressure at every point. Nodes lie on a grid of half cells, (i, j, k) with at
most one of them odd.

Reference: O. C. Zienkiewicz, R. L. Taylor and J. Z. Zhu, The Finite Element Method (2013), ch. 6,
doi:10.1016/C2009-0-24909-9.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from .revolved import InsideOutError

CORNERS = tuple(product((-1, 1), repeat=3))
AT = np.array(
    [*CORNERS, *(p for p in product((-1, 0, 1), repeat=3) if np.count_nonzero(np.array(p) == 0) == 1)]
)
"""The nodes of a brick in (-1 ... 1)^3."""
OUTSIDE = np.flatnonzero(AT[:, 2] == 1)

Motion = Float[ndarray, "nodes 3"]


def serendipity(x: Float[ndarray, "q 3"]) -> tuple[Float[ndarray, "q 20"], Float[ndarray, "q 20 3"]]:
    """Shape functions of the nodes `AT` at places in a brick, and their derivatives."""
    N, D = np.empty((len(x), 20)), np.empty((len(x), 20, 3))
    for a, at in enumerate(AT):
        linear = 1 + x * at  # of the directions in which the node is at an end
        flat = np.where(at == 0, 1 - x**2, linear)
        slope = np.where(at == 0, -2 * x, at)
        whole, parts = flat.prod(axis=1), _products_but_one(flat)
        if (at == 0).any():
            N[:, a], D[:, a] = whole / 4, parts * slope / 4
        else:
            less = (x * at).sum(axis=1) - 2
            N[:, a] = whole * less / 8
            D[:, a] = (parts * slope * less[:, None] + whole[:, None] * at) / 8
    return N, D


def _products_but_one(factors: Float[ndarray, "q 3"]) -> Float[ndarray, "q 3"]:
    return np.stack([np.delete(factors, i, axis=1).prod(axis=1) for i in range(3)], axis=1)


def gauss(points: int, directions: int) -> tuple[Float[ndarray, "q d"], Float[ndarray, " q"]]:
    """Places in (-1 ... 1)^d and their weights."""
    x, w = np.polynomial.legendre.leggauss(points)
    at = np.array(list(product(x, repeat=directions)))
    return at, np.array(list(product(w, repeat=directions))).prod(axis=1)


@dataclass(frozen=True)
class Bricks:
    """Bricks between knots along three coordinates.

    Attributes:
        place: from coordinates ``[n 3]`` to places [mm].
        youngs_modulus: of every cell, over the three coordinates [MPa].
        held: which of a node's three displacements are none, from its coordinates ``[n 3]``.
    """

    knots: tuple[ndarray, ndarray, ndarray]
    place: Callable[[Float[ndarray, "n 3"]], Float[ndarray, "n 3"]]
    youngs_modulus: Float[ndarray, "a b c"]
    poisson_ratio: float
    held: Callable[[Float[ndarray, "n 3"]], Bool[ndarray, "n 3"]]

    @cached_property
    def grid(self) -> Int[ndarray, "nodes 3"]:
        """(i, j, k) of the nodes, layer by layer."""
        shape = [2 * len(knots) - 1 for knots in self.knots]
        every = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
        return every[(every % 2).sum(axis=1) < 2]

    @cached_property
    def coordinates(self) -> Float[ndarray, "nodes 3"]:
        """Of the nodes."""
        halves = [np.interp(np.arange(2 * len(k) - 1) / 2, np.arange(len(k)), k) for k in self.knots]
        return np.stack([half[self.grid[:, i]] for i, half in enumerate(halves)], axis=1)

    @cached_property
    def places(self) -> Float[ndarray, "nodes 3"]:
        """Unloaded, of the nodes [mm]."""
        return self.place(self.coordinates)

    @cached_property
    def number(self) -> Int[ndarray, "i j k"]:
        """Of the node at (i, j, k), -1 where there is none."""
        number = np.full([2 * len(knots) - 1 for knots in self.knots], -1)
        number[tuple(self.grid.T)] = np.arange(len(self.grid))
        return number

    @cached_property
    def nodes_of(self) -> Int[ndarray, "cells 20"]:
        """Of every cell, along the last coordinate first."""
        shape = [len(knots) - 1 for knots in self.knots]
        cells = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 1, 3)
        return self.number[tuple(np.moveaxis(2 * cells + 1 + AT, -1, 0))]

    @cached_property
    def free(self) -> Int[ndarray, " n"]:
        """Degrees of freedom 3 node + direction that are not held."""
        return np.flatnonzero(~self.held(self.coordinates).ravel())

    @cached_property
    def _gradients(self) -> tuple[Float[ndarray, "cells q 20 3"], Float[ndarray, "cells q"]]:
        at, weight = gauss(2, 3)
        _, D = serendipity(at)
        jacobian = np.einsum("qad,cai->cqid", D, self.places[self.nodes_of])
        volume = np.linalg.det(jacobian)
        if not (volume > 0).all():
            raise InsideOutError
        return np.einsum("qad,cqdi->cqai", D, np.linalg.inv(jacobian)), volume * weight

    @cached_property
    def _moduli(self) -> tuple[Float[ndarray, "cells 1"], Float[ndarray, "cells 1"]]:
        nu = self.poisson_ratio
        mu = self.youngs_modulus.reshape(-1, 1) / (2 * (1 + nu))
        return mu, 2 * mu * nu / (1 - 2 * nu)

    def balance(self, u: Motion) -> tuple[Float[ndarray, "cells 60"], Float[ndarray, "cells 60 60"]]:
        """Forces of every cell on its nodes' displacements, and its stiffness."""
        (B, w), (mu, lame) = self._gradients, self._moduli
        F = np.eye(3) + np.swapaxes(u[self.nodes_of], 1, 2)[:, None] @ B
        J = np.linalg.det(F)
        if not (J > 0).all():
            raise InsideOutError
        h = B @ np.linalg.inv(F)  # F^-T grad N
        pJ = lame * (J - 1) * J
        force = ((w * mu)[..., None, None] * (B @ np.swapaxes(F, -1, -2))).sum(axis=1)
        force += ((w * (pJ - mu))[..., None, None] * h).sum(axis=1)
        cells, q = w.shape
        flat = h.reshape(cells, q, 60)
        turned = np.swapaxes(flat, 1, 2)
        stiffness = turned @ ((w * (pJ + lame * J**2))[..., None] * flat)
        crossed = (turned @ ((w * (mu - pJ))[..., None] * flat)).reshape(cells, 20, 3, 20, 3)
        stiffness += np.swapaxes(crossed, 2, 4).reshape(cells, 60, 60)
        G = np.moveaxis(B, 2, 1).reshape(cells, 20, q * 3)
        alike = G @ np.swapaxes(G * np.repeat(w * mu, 3, axis=1)[:, None], 1, 2)
        by_node = stiffness.reshape(cells, 20, 3, 20, 3)
        for i in range(3):
            by_node[:, :, i, :, i] += alike
        return force.reshape(cells, 60), stiffness

    @cached_property
    def dofs_of(self) -> Int[ndarray, "cells 60"]:
        """Degrees of freedom of every cell among the free ones, -1 of those held."""
        place = np.full(3 * len(self.grid), -1)
        place[self.free] = np.arange(len(self.free))
        return place[(3 * self.nodes_of[..., None] + np.arange(3)).reshape(-1, 60)]

    def assembled(self, force: Float[ndarray, "cells 60"]) -> Float[ndarray, " n"]:
        """Forces on the free degrees of freedom."""
        return np.bincount(self.dofs_of.ravel() + 1, force.ravel(), len(self.free) + 1)[1:]
